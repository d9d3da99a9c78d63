//! `gripcast bench predict`: how long one prediction takes on this machine.
//!
//! Loads the model, turns 320×240 pictures into tensors and predicts, on one thread; prints minimum
//! and median in ms. `--peer onnxruntime` runs the same file through PyPI's onnxruntime in
//! `python3`, on one thread, in the same run.

use std::io::Write as _;
use std::path::PathBuf;
use std::process::{Command, Stdio};

use serde_json::{Map, Value, json};

use super::{Context, print};
use crate::error::{Error, ErrorKind, Result};
use crate::predict::{Model, PredictFigures, baseline, measure, onnx};

/// Runs below this give no usable median.
const LEAST_RUNS: u64 = 30;
/// Exit code of the peer's script when onnxruntime cannot be imported.
const PEER_ABSENT: i32 = 3;
const PEER_SCRIPT: &str = include_str!("../../../benches/peers/onnxruntime_predict.py");

/// Arguments.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// ONNX file [default: the built-in contact-strength heuristic]
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
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
    let bytes = match &args.model {
        Some(path) => onnx::read(path)?,
        None => baseline::onnx_bytes()?,
    };
    let at_model = |error: Error| match &args.model {
        Some(path) => error.at(path.display()),
        None => error,
    };
    let model = Model::from_bytes(&bytes).map_err(at_model)?;
    let figures = measure(&bytes, args.runs as usize).map_err(at_model)?;
    let mut peers = Map::new();
    if let Some(Peer::Onnxruntime) = args.peer {
        match onnxruntime(&bytes, args.runs)? {
            Some(mut peer) => {
                let theirs = peer["engine_ms_median"].as_f64().unwrap_or(f64::NAN);
                peer["engine_ratio"] = json!(figures.engine_ms_median / theirs);
                peers.insert("onnxruntime".to_owned(), peer);
            }
            None => {
                if !context.quiet {
                    eprintln!(
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

/// Figures of onnxruntime on the same bytes; `None` when Python or onnxruntime is absent.
fn onnxruntime(model: &[u8], runs: u64) -> Result<Option<Value>> {
    let failed = |what: &str| Error::new(ErrorKind::Internal, format!("onnxruntime bench: {what}"));
    let runs = runs.to_string();
    let spawned = Command::new("python3")
        .args(["-c", PEER_SCRIPT, "-", "--runs", &runs])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn();
    let mut python = match spawned {
        Ok(python) => python,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(Error::io("cannot start python3", error)),
    };
    if let Some(mut stdin) = python.stdin.take() {
        // A peer that is absent ends without reading; its exit code says so.
        let _ = stdin.write_all(model);
    }
    let output = python
        .wait_with_output()
        .map_err(|e| Error::io("cannot read from python3", e))?;
    match output.status.code() {
        Some(0) => serde_json::from_slice(&output.stdout)
            .map(Some)
            .map_err(|cause| failed("its answer is no JSON").because(cause)),
        Some(PEER_ABSENT) => Ok(None),
        _ => Err(failed("python3 failed, see its message above")),
    }
}
