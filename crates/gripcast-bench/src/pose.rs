//! `gripcast-bench pose`: accuracy and time of the gripper pose in the object's frame.
//!
//! ```text
//! gripcast-bench pose --motion-px 3 --json
//! ```
//!
//! Renders a board with 14 markers of 30 mm and a gripper with two tags at 0.4–0.8 m, with
//! realistic blur, shading and noise; detects, refines, solves, and compares with the ground truth.
//! `ms` is CPU time of one thread from grey image to pose. All compiled-in detectors get the same
//! images.
//!
//! Exit codes: 0 measured · 2 usage.

use gripcast::cli::Context;
use gripcast::cli::bench::Report;
use gripcast::cli::working::interruptible;
use gripcast_base::error::Result;
use serde_json::{Map, Value, json};

use crate::pose_scenes::{PoseFigures, PoseScenes};

/// Minimum for a usable 95th percentile.
const MIN_IMAGES: u64 = 20;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    /// Number of images, each of a random scene
    #[arg(long, value_name = "N", default_value_t = 40,
        value_parser = clap::value_parser!(u64).range(MIN_IMAGES..=100_000))]
    images: u64,
    /// Image width; the height is 9/16 of it
    #[arg(long, value_name = "PX", default_value_t = 1280,
        value_parser = clap::value_parser!(u32).range(320..=7680))]
    width: u32,
    /// Motion blur
    #[arg(long, value_name = "PX", default_value_t = 0.0, value_parser = pixels)]
    motion_px: f64,
    /// Standard deviation of the lens blur
    #[arg(long, value_name = "PX", default_value_t = 0.7, value_parser = pixels)]
    blur_px: f64,
    /// Standard deviation of the noise, grey levels
    #[arg(long, value_name = "LEVELS", default_value_t = 3.0, value_parser = pixels)]
    noise: f64,
    /// Random seed of scenes and noise
    #[arg(long, value_name = "SEED", default_value_t = 1)]
    seed: u64,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

fn pixels(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|value| (0.0..=50.0).contains(value))
        .ok_or_else(|| "must be a number from 0 to 50".to_owned())
}

/// Runs the benchmark.
pub(crate) fn run(context: &Context, args: &Args) -> Result<()> {
    let scenes = PoseScenes {
        images: args.images,
        seed: args.seed,
        width: args.width,
        motion_px: args.motion_px,
        psf_px: args.blur_px,
        noise: args.noise,
    };
    let measured = interruptible(context, "measuring poses", move |progress| {
        scenes.measure(|done| progress.count(done as usize, scenes.images as usize))
    })??;
    let mut detectors = measured.iter();
    let default = detectors.next();
    let params = json!({
        "blur_px": scenes.psf_px,
        "detector": default.map(|(name, _)| name),
        "motion_px": scenes.motion_px,
        "noise": scenes.noise,
        "images": scenes.images,
        "seed": scenes.seed,
        "size": [scenes.width, scenes.width * 9 / 16],
        "threads": 1,
    });
    let figures = json!(default.map(|(_, figures)| figures));
    let others = detectors.map(|(name, figures)| ((*name).to_owned(), json!(figures)));
    let baselines: Map<String, Value> = others.collect();
    Report {
        baselines,
        ..Report::new("pose", params, figures, table(&measured))
    }
    .print(args.json)
}

fn table(measured: &[(&'static str, PoseFigures)]) -> String {
    let mut lines = Vec::new();
    for (name, figures) in measured {
        lines.push(format!(
            "{name}: {:.1} % of markers detected, {} false, {:.0} % of images solved",
            100.0 * figures.detected,
            figures.false_ids,
            100.0 * figures.solved
        ));
        lines.push("                      median      95 %".to_owned());
        let mut row = |what: &str, median: f64, p95: f64| {
            lines.push(format!("  {what:<16} {median:>9.3} {p95:>9.3}"));
        };
        row("pose, mm", figures.median_mm, figures.p95_mm);
        row("pose, degrees", figures.median_deg, figures.p95_deg);
        row("corners, px", figures.corner_px, figures.corner_p95_px);
        lines.push(format!(
            "  {:.1} ms per image, detection {:.1} ms; normalised squared error {:.2}",
            figures.ms, figures.detect_ms, figures.normalised_error
        ));
    }
    lines.join("\n")
}
