//! `gripcast bench live` with OpenCV as a baseline for decoding.

use gripcast::cli::{Context, bench_live};
use gripcast::daemon::live_load::{decode_ms, gel_frame};
use gripcast_base::error::Result;
use serde_json::json;

use crate::baseline::Baseline;

/// Number of decodings.
const RUNS: u64 = 30;
const OPENCV: Baseline = Baseline {
    name: "opencv",
    packages: "opencv-python-headless",
    script: include_str!("../peers/opencv_decode.py"),
};

/// Arguments.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    bench: bench_live::Args,
    /// Baseline to compare against (PyPI: opencv-python-headless)
    #[arg(long, value_parser = [OPENCV.name])]
    baseline: Option<String>,
}

/// Runs the benchmark.
pub(crate) fn run(context: &Context, args: &Args) -> Result<()> {
    let mut report = args.bench.measure(context)?;
    if args.baseline.is_some() {
        let frame = gel_frame(args.bench.quality)?;
        if let Some(mut baseline) = OPENCV.measure(context, RUNS, &frame.data)? {
            let ours = decode_ms(&frame, RUNS)?;
            let theirs = baseline["decode_ms_median"].as_f64().unwrap_or(f64::NAN);
            baseline["our_decode_ms_median"] = json!(ours);
            baseline["decode_ratio"] = json!(ours / theirs);
            report.text += &format!("\nopencv: {baseline}");
            report.baselines.insert("opencv".to_owned(), baseline);
        }
    }
    report.print(args.bench.json)
}
