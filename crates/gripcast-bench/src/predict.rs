//! `gripcast bench predict`, with `--peer onnxruntime` the same file through PyPI's onnxruntime on
//! one thread.

use gripcast::cli::Context;
use gripcast::cli::bench_predict;
use gripcast_base::error::Result;
use serde_json::json;

use crate::peer::Peer;

const ONNXRUNTIME: Peer = Peer {
    name: "onnxruntime",
    packages: "onnxruntime numpy",
    script: include_str!("../peers/onnxruntime_predict.py"),
};

/// Arguments.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    bench: bench_predict::Args,
    /// Measure PyPI's onnxruntime as well
    #[arg(long, value_parser = [ONNXRUNTIME.name])]
    peer: Option<String>,
}

/// Runs the bench.
pub(crate) fn run(context: &Context, args: &Args) -> Result<()> {
    let (mut report, model) = args.bench.measure()?;
    if args.peer.is_some()
        && let Some(mut peer) = ONNXRUNTIME.measure(context, args.bench.runs, &model)?
    {
        let ours = report.figures["engine_ms_median"].as_f64();
        let theirs = |key: &str| peer[key].as_f64().unwrap_or(f64::NAN);
        let [min, median] = ["engine_ms_min", "engine_ms_median"].map(theirs);
        report.text += &bench_predict::row("onnxruntime", min, median);
        peer["engine_ratio"] = json!(ours.unwrap_or(f64::NAN) / median);
        report.peers.insert("onnxruntime".to_owned(), peer);
    }
    report.print(args.bench.json)
}
