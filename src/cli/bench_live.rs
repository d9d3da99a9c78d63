//! `gripcast bench live`: the complete live path from memory.
//!
//! Two 3280×2464 MJPG streams at 25/s, 1280×720 YUYV and Z16 at 30/s go through capture, decoding
//! and a prediction at every tactile frame. The gel frames are synthesised: no original frame of
//! full size could be had, and their size depends on `--quality`.

use serde_json::{Map, json};

use super::{Context, print, python_peer};
use crate::daemon::live_load::{LoadParams, decode_ms, drive, gel_frame};
use crate::note;
use gripcast_base::error::Result;
use gripcast_nn::predict::{Model, SHIPPED};

/// Arguments.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Length of the measurement
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..=3600))]
    seconds: u64,
    /// JPEG quality of the synthesised gel frames
    #[arg(long, default_value_t = 75, value_parser = clap::value_parser!(u8).range(1..=100))]
    quality: u8,
    /// ONNX file, `gripcast-vt`, the built-in classifier, or `baseline-contact`, a heuristic
    #[arg(long, value_name = "MODEL", default_value = SHIPPED)]
    model: String,
    /// Another decoder to measure beside ours, on one of the same frames
    #[arg(long, value_enum)]
    peer: Option<Peer>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Peer {
    /// PyPI's opencv-python-headless, through `python3`
    Opencv,
}

const PEER_SCRIPT: &str = include_str!("../../benches/peers/opencv_decode.py");
/// Decodings that are measured, ours and the peer's.
const PEER_RUNS: u64 = 30;

/// Runs the bench.
pub(crate) fn run(context: &Context, args: &Args) -> Result<()> {
    let model = Model::named(&args.model)?;
    let name = model.contract().name.clone();
    if !context.quiet {
        note!(
            "synthesising full-size frames, then measuring for {} s",
            args.seconds
        );
    }
    let params = LoadParams {
        seconds: args.seconds,
        quality: args.quality,
    };
    let figures = drive(model, params)?;
    let mut peers = Map::new();
    if let Some(Peer::Opencv) = args.peer {
        let frame = gel_frame(args.quality)?;
        match python_peer::measure("opencv", PEER_SCRIPT, PEER_RUNS, &frame.data)? {
            Some(mut peer) => {
                let ours = decode_ms(&frame, PEER_RUNS)?;
                let theirs = peer["decode_ms_median"].as_f64().unwrap_or(f64::NAN);
                peer["our_decode_ms_median"] = json!(ours);
                peer["decode_ratio"] = json!(ours / theirs);
                peers.insert("opencv".to_owned(), peer);
            }
            None if !context.quiet => note!(
                "gripcast: OpenCV is absent, so it was not measured\n  → pip install \
                 opencv-python-headless"
            ),
            None => {}
        }
    }
    if args.json {
        let report = json!({
            "name": "live",
            "params": {"model": name, "seconds": args.seconds, "quality": args.quality},
            "figures": figures,
            "peers": peers,
        });
        return print(&format!("{report:#}"));
    }
    for (name, peer) in &peers {
        print(&format!("{name}: {peer}"))?;
    }
    print(&format!(
        "frames {}  lost by us {}  tactile frames not decoded {}\n\
         predictions {:.1}/s  frame to prediction {:.1} ms (median) {:.1} ms (p99)\n\
         {:.2} cores  {:.0} MB peak  gel frames of {:.0} kB",
        figures.received,
        figures.lost,
        figures.not_decoded,
        figures.predictions_per_s,
        figures.latency_p50_ms,
        figures.latency_p99_ms,
        figures.cores,
        figures.rss_mb,
        figures.gel_frame_kb,
    ))
}
