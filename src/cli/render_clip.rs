//! `gripcast render clip`: clips of simulated grasps for the virtual rig.
//!
//! ```text
//! gripcast sim grasp --object builtin:mug --width 0.08 --trace mug.bin
//! gripcast render clip --trace mug.bin --seed 3 --out clips
//! ```
//!
//! Writes `NAME.trace.bin`, `NAME.colour.jpg`, `NAME.depth.png`, `NAME.external.jpg` and
//! `NAME.sheet.toml` for every trace, where NAME is the name of the trace file. A rig file whose
//! virtual cameras have `path = "clips"` plays them. Simulate with `--width` equal to the opening
//! of the hand, where the clip starts.
//!
//! Exit codes: 0 rendered · 1 nothing rendered · 2 usage · 3 some of several traces failed ·
//! 130 interrupted.

use std::path::{Path, PathBuf};
use std::time::Instant;

use serde::Serialize;

use super::flags::image_size;
use super::render_out::Report;
use super::render_source::SimulatedGrasp;
use super::working::{Progress, interruptible};
use super::{Context, create_folder};
use gripcast_base::error::Result;
use gripcast_base::files::save;
use gripcast_sim::grasp::TraceFile;
use gripcast_virtual_rig::{ClipSettings, record_clip};
use gripcast_visual::Finish;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    /// Traces of simulated grasps
    #[arg(long, value_name = "FILE", num_args = 1.., required = true)]
    trace: Vec<PathBuf>,
    /// Output directory
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Size of the colour images, px
    #[arg(long, value_name = "WxH", default_value = "480x360", value_parser = image_size)]
    size: [usize; 2],
    /// Samples per pixel of a colour image
    #[arg(long, value_name = "N", default_value_t = 64,
        value_parser = clap::value_parser!(u32).range(1..=1 << 20))]
    spp: u32,
    /// Material of an object without its own [default: drawn from the seed]
    #[arg(long, value_name = "NAME")]
    finish: Option<Finish>,
    /// Random seed of light, ground, camera and colours
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    seed: u64,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// A written clip.
#[derive(Debug, Serialize)]
struct Written {
    name: String,
    files: Vec<PathBuf>,
    bytes: usize,
    wall_s: f64,
}

/// Runs the command.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    create_folder(&args.out)?;
    let json = args.json;
    let report = interruptible(context, "rendering clips", move |progress| {
        Report::of_traces(&args.trace, progress, |trace| {
            Ok(vec![render_clip(&args, trace, progress)?])
        })
    })??;
    report.conclude(json, |w: &Written| {
        format!("{}: {} kB in {:.1} s", w.name, w.bytes / 1000, w.wall_s)
    })
}

fn render_clip(args: &Args, trace: &Path, progress: &Progress) -> Result<Written> {
    let began = Instant::now();
    let grasp = SimulatedGrasp::read(trace, None)?;
    let model = grasp.object.model(args.finish, args.seed, progress)?;
    let [width, height] = args.size;
    let settings = ClipSettings {
        colour: args.size,
        depth: [width * 2 / 3, height * 2 / 3].map(|side| side.max(1)),
        samples: args.spp,
        seed: args.seed,
        ..ClipSettings::default()
    };
    let stem = trace.file_stem().unwrap_or_default();
    let name = stem.to_string_lossy().replace(".trace", "");
    let file = TraceFile {
        header: grasp.header,
        trace: grasp.trace,
    };
    let label = name.clone();
    let mesh = &grasp.mesh;
    let files = record_clip(&file, mesh, &model, &settings, &|done, all| {
        progress.line(format!("{label}: image {} of {all}", done + 1));
    })?;
    let mut written = Written {
        name: name.clone(),
        files: Vec::new(),
        bytes: 0,
        wall_s: 0.0,
    };
    // The trace is written last: only complete clips have one.
    for (file, bytes) in files.named(&name).iter().rev() {
        let path = args.out.join(file);
        save(&path, bytes)?;
        written.bytes += bytes.len();
        written.files.push(path);
    }
    written.wall_s = began.elapsed().as_secs_f64();
    Ok(written)
}
