//! `gripcast-bench tracking`: time of the shear trackers for both fingers, on one core.
//!
//! Two gels of 320×240 pixels, once with gel markers as on a GelSight Mini and once without, are
//! pressed and move back and forth.

use gripcast::cli::Context;
use gripcast::cli::bench::Report;
use gripcast_base::error::Result;
use gripcast_imaging::{GelContact, gel_image};
use gripcast_shear::{ExpectedMarkers, ShearTracker};
use image::RgbImage;
use serde_json::{Map, Value, json};

use crate::timing::{Timing, timed};

/// Different frames of each gel, which repeat.
const FRAMES: usize = 12;
/// Pitch of the gel markers, px.
const PITCH: f32 = 44.0;
/// Radius of the gel markers, px.
const RADIUS: f32 = 9.0;
/// Scale of the images, m/px.
const M_PER_PX: f64 = 3.0e-5;

/// Arguments.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Number of measured pairs of frames
    #[arg(long, value_name = "N", default_value_t = 300, value_parser = clap::value_parser!(u32).range(1..))]
    runs: u32,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// Runs the benchmark.
pub(crate) fn run(_context: &Context, args: &Args) -> Result<()> {
    let mut text = "both fingers             min ms   median ms".to_owned();
    let mut figures = Map::new();
    for (name, has_markers) in [("markers", true), ("texture", false)] {
        let frames: Vec<RgbImage> = (0..FRAMES).map(|i| gel(i, has_markers)).collect();
        let initial = gel(0, has_markers);
        let start = || ShearTracker::new(&initial, M_PER_PX, ExpectedMarkers::Unknown);
        let mut fingers = [start()?, start()?];
        let mut next = 0;
        let update = timed(args.runs as usize, || {
            // From 0 to the last frame and back.
            let phase = next % (2 * FRAMES - 2);
            let frame = &frames[phase.min(2 * FRAMES - 2 - phase)];
            next += 1;
            fingers.each_mut().map(|finger| finger.update(frame))
        });
        let first = timed(5, start);
        for (figure, Timing { min, median }) in [("update", update), ("start", first)] {
            text += &format!(
                "\n{:<20}{min:>11.3}{median:>12.3}",
                format!("{name} {figure}")
            );
            figures.insert(
                format!("{name}_{figure}_ms"),
                json!({"min": min, "median": median}),
            );
        }
    }
    let params = json!({"runs": args.runs, "size": [320, 240]});
    Report::new("tracking", params, Value::Object(figures), text).print(args.json)
}

/// A gel, pressed more in later frames, with gel markers that move by 2 px per frame.
fn gel(frame: usize, has_markers: bool) -> RgbImage {
    let shift = 2.0 * frame as f32;
    let contact = GelContact {
        centre_x: 0.5 + shift / 320.0,
        centre_y: 0.5,
        radius: 0.25,
        strength: (frame as f32 / 3.0).min(1.0),
    };
    let mut image = gel_image(320, 240, frame as u64, contact);
    if has_markers {
        for (x, y, pixel) in image.enumerate_pixels_mut() {
            let offset = |at: f32| (at + 0.5 * PITCH).rem_euclid(PITCH) - 0.5 * PITCH;
            let distance = offset(x as f32 - 22.0 - shift).hypot(offset(y as f32 - 20.0));
            let darkness = 0.66 * ((RADIUS + 2.0 - distance) / 4.0).clamp(0.0, 1.0);
            pixel.0 = pixel
                .0
                .map(|level| (f32::from(level) * (1.0 - darkness)) as u8);
        }
    }
    image
}
