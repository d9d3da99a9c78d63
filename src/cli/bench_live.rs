//! `gripcast bench live`: benchmarks the live path with frames from memory.
//!
//! Two 3280×2464 MJPG streams at 25 fps and 1280×720 YUYV and Z16 streams at 30 fps go through
//! capture, decoding, a prediction and a verdict in the lift per tactile frame. The tactile frames are synthetic; their
//! size depends on `--quality`.

use serde_json::json;

use super::Context;
use super::bench::Report;
use crate::daemon::live_load::{LoadParams, run_load};
use crate::note;
use gripcast_base::error::Result;
use gripcast_nn::predict::{Model, SHIPPED};

/// Arguments.
// Flattened into the arguments of gripcast-bench.
#[derive(Clone, Debug, clap::Args)]
#[group(skip)]
pub struct Args {
    /// Measuring time, s
    #[arg(long, value_name = "S", default_value_t = 20,
        value_parser = clap::value_parser!(u64).range(1..=3600))]
    seconds: u64,
    /// JPEG quality of the synthetic tactile frames
    #[arg(long, value_name = "PERCENT", default_value_t = 75,
        value_parser = clap::value_parser!(u8).range(1..=100))]
    pub quality: u8,
    /// ONNX file, gripcast-vt (built-in classifier) or baseline-contact (built-in heuristic)
    #[arg(long, value_name = "MODEL", default_value = SHIPPED)]
    model: String,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

impl Args {
    /// Runs the benchmark.
    ///
    /// # Errors
    /// If the model, a thread or a decoder fails.
    pub fn measure(&self, context: &Context) -> Result<Report> {
        let Self {
            seconds, quality, ..
        } = *self;
        let model = Model::by_name(&self.model)?;
        let name = model.contract().name.clone();
        if !context.quiet {
            note!("generating full-size frames, then measuring for {seconds} s");
        }
        let figures = run_load(model, LoadParams { seconds, quality })?;
        let lift = match figures.lift_verdicts_per_s > 0.0 {
            true => format!(
                "verdicts in the lift {:.1}/s, {:.0} % with depth  frame to verdict {:.1} ms (p99)",
                figures.lift_verdicts_per_s,
                100.0 * figures.lift_verdicts_with_depth,
                figures.lift_latency_p99_ms,
            ),
            false => "verdicts in the lift: the model gives none".to_owned(),
        };
        let text = format!(
            "frames {}  dropped {}  tactile frames not decoded {}\n\
             predictions {:.1}/s  frame to prediction {:.1} ms (median) {:.1} ms (p99)\n\
             {lift}\n\
             gel judged in {:.1} ms, shear in {:.1} ms (median)  {:.2} cores  {:.0} MB peak  gel frames of {:.0} kB",
            figures.received,
            figures.lost,
            figures.not_decoded,
            figures.predictions_per_s,
            figures.latency_p50_ms,
            figures.latency_p99_ms,
            figures.gel_judge_p50_ms,
            figures.shear_p50_ms,
            figures.cores,
            figures.rss_mb,
            figures.gel_frame_kb,
        );
        let params = json!({"model": name, "seconds": seconds, "quality": quality});
        Ok(Report::new("live", params, json!(figures), text))
    }
}
