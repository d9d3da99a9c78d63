//! `gripcast bench live`: the complete live path from memory.
//!
//! Two 3280×2464 MJPG streams at 25/s, 1280×720 YUYV and Z16 at 30/s go through capture, decoding
//! and a prediction at every tactile frame. The gel frames are synthesised: no original frame of
//! full size could be had, and their size depends on `--quality`.

use serde_json::json;

use super::{Context, print};
use crate::app::daemon::live_load::{LoadParams, drive};
use crate::error::Result;
use crate::predict::Model;

/// Arguments.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Length of the measurement
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..=3600))]
    seconds: u64,
    /// JPEG quality of the synthesised gel frames
    #[arg(long, default_value_t = 75, value_parser = clap::value_parser!(u8).range(1..=100))]
    quality: u8,
    /// ONNX model [default: the built-in contact heuristic]
    #[arg(long, value_name = "FILE")]
    model: Option<std::path::PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// Runs the bench.
pub(crate) fn run(context: &Context, args: &Args) -> Result<()> {
    let model = match &args.model {
        Some(path) => Model::load(path)?,
        None => Model::baseline()?,
    };
    let name = model.contract().name.clone();
    if !context.quiet {
        eprintln!(
            "synthesising full-size frames, then measuring for {} s",
            args.seconds
        );
    }
    let params = LoadParams {
        seconds: args.seconds,
        quality: args.quality,
    };
    let figures = drive(model, params)?;
    if args.json {
        let report = json!({
            "name": "live",
            "params": {"model": name, "seconds": args.seconds, "quality": args.quality},
            "figures": figures,
            "peers": {},
        });
        return print(&format!("{report:#}"));
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
