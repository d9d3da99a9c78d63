//! `gripcast bench live`, with `--peer opencv` PyPI's OpenCV decoding one of the same frames.

use gripcast::cli::{Context, bench_live};
use gripcast::daemon::live_load::{decode_ms, gel_frame};
use gripcast_base::error::Result;
use serde_json::json;

use crate::peer::Peer;

/// Decodings that are measured, ours and the peer's.
const RUNS: u64 = 30;
const OPENCV: Peer = Peer {
    name: "opencv",
    packages: "opencv-python-headless",
    script: include_str!("../peers/opencv_decode.py"),
};

/// Arguments.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    bench: bench_live::Args,
    /// Measure PyPI's opencv-python-headless as well
    #[arg(long, value_parser = [OPENCV.name])]
    peer: Option<String>,
}

/// Runs the bench.
pub(crate) fn run(context: &Context, args: &Args) -> Result<()> {
    let mut report = args.bench.measure(context)?;
    if args.peer.is_some() {
        let frame = gel_frame(args.bench.quality)?;
        if let Some(mut peer) = OPENCV.measure(context, RUNS, &frame.data)? {
            let ours = decode_ms(&frame, RUNS)?;
            let theirs = peer["decode_ms_median"].as_f64().unwrap_or(f64::NAN);
            peer["our_decode_ms_median"] = json!(ours);
            peer["decode_ratio"] = json!(ours / theirs);
            report.text += &format!("\nopencv: {peer}");
            report.peers.insert("opencv".to_owned(), peer);
        }
    }
    report.print(args.bench.json)
}
