//! `gripcast bench predict`: how long one prediction takes on this machine.
//!
//! Loads the model, turns 320×240 pictures into tensors and predicts, on one thread; prints minimum
//! and median in ms. `--peer onnxruntime` runs the same file through PyPI's onnxruntime in
//! `python3`, on one thread, in the same run.

use serde_json::{Map, Value, json};

use super::{Context, print, python_peer};
use crate::note;
use gripcast_base::error::{Error, Result};
use gripcast_nn::predict::{Model, PredictFigures, SHIPPED, measure, model_bytes};

/// Runs below this give no usable median.
const LEAST_RUNS: u64 = 30;
const PEER_SCRIPT: &str = include_str!("../../benches/peers/onnxruntime_predict.py");

/// Arguments.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// ONNX file, `gripcast-vt`, the built-in classifier, or `baseline-contact`, a heuristic
    #[arg(long, value_name = "MODEL", default_value = SHIPPED)]
    model: String,
    /// Predictions to measure
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u64).range(LEAST_RUNS..))]
    runs: u64,
    /// Another engine to measure beside ours
    #[arg(long, value_enum)]
    peer: Option<Peer>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Peer {
    /// PyPI's onnxruntime, through `python3`
    Onnxruntime,
}

/// Runs the bench.
pub(crate) fn run(context: &Context, args: &Args) -> Result<()> {
    let bytes = model_bytes(&args.model)?;
    let at_model = |error: Error| error.at(&args.model);
    let model = Model::from_bytes(&bytes).map_err(at_model)?;
    let figures = measure(&bytes, args.runs as usize).map_err(at_model)?;
    let mut peers = Map::new();
    if let Some(Peer::Onnxruntime) = args.peer {
        match python_peer::measure("onnxruntime", PEER_SCRIPT, args.runs, &bytes)? {
            Some(mut peer) => {
                let theirs = peer["engine_ms_median"].as_f64().unwrap_or(f64::NAN);
                peer["engine_ratio"] = json!(figures.engine_ms_median / theirs);
                peers.insert("onnxruntime".to_owned(), peer);
            }
            None => {
                if !context.quiet {
                    note!(
                        "gripcast: onnxruntime is absent, so it was not measured\n  → pip install \
                         onnxruntime numpy"
                    );
                }
            }
        }
    }
    if args.json {
        let report = json!({
            "figures": figures,
            "name": "predict",
            "params": {
                "model": model.contract().name,
                "model_sha256": model.sha256(),
                "runs": args.runs,
                "threads": 1,
            },
            "peers": peers,
        });
        return print(&format!("{report:#}"));
    }
    print(&table(&figures, &peers))
}

fn table(figures: &PredictFigures, peers: &Map<String, Value>) -> String {
    let mut lines = vec!["ms                  min   median".to_owned()];
    let mut row = |name: &str, min: f64, median: f64| {
        lines.push(format!("{name:<14} {min:>8.3} {median:>8.3}"));
    };
    row("engine", figures.engine_ms_min, figures.engine_ms_median);
    row(
        "preprocess",
        figures.preprocess_ms_min,
        figures.preprocess_ms_median,
    );
    row("load", figures.load_ms_min, figures.load_ms_median);
    for (name, peer) in peers {
        let ms = |key: &str| peer[key].as_f64().unwrap_or(f64::NAN);
        row(name, ms("engine_ms_min"), ms("engine_ms_median"));
    }
    lines.join("\n")
}
