//! `gripcast bench predict` with onnxruntime on one thread as a baseline.

use gripcast::cli::Context;
use gripcast::cli::bench_predict;
use gripcast_base::error::Result;
use serde_json::json;

use crate::baseline::Baseline;

const ONNXRUNTIME: Baseline = Baseline {
    name: "onnxruntime",
    packages: "onnxruntime numpy",
    script: include_str!("../peers/onnxruntime_predict.py"),
};

/// Arguments.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    bench: bench_predict::Args,
    /// Baseline to compare against (PyPI)
    #[arg(long, value_parser = [ONNXRUNTIME.name])]
    baseline: Option<String>,
}

/// Runs the benchmark.
pub(crate) fn run(context: &Context, args: &Args) -> Result<()> {
    let (mut report, model) = args.bench.measure()?;
    if args.baseline.is_some()
        && let Some(mut baseline) = ONNXRUNTIME.measure(context, args.bench.runs, &model)?
    {
        let ours = report.figures["engine_ms_median"].as_f64();
        let theirs = |key: &str| baseline[key].as_f64().unwrap_or(f64::NAN);
        let [min, median] = ["engine_ms_min", "engine_ms_median"].map(theirs);
        report.text += &bench_predict::row("onnxruntime", min, median);
        baseline["engine_ratio"] = json!(ours.unwrap_or(f64::NAN) / median);
        report.baselines.insert("onnxruntime".to_owned(), baseline);
    }
    report.print(args.bench.json)
}
