//! `gripcast render film`: simulated grasps for the virtual rig.
//!
//! ```text
//! gripcast sim grasp --object builtin:mug --width 0.08 --trace mug.bin
//! gripcast render film --trace mug.bin --seed 3 --out films
//! ```
//!
//! Writes `NAME.trace.bin`, `NAME.colour.jpg`, `NAME.depth.png`, `NAME.outside.jpg` and
//! `NAME.sheet.toml` for every trace; NAME is that of the trace file. A rig file whose virtual cameras have `path = "films"`
//! plays them. Simulate with `--width` as wide as the hand opens: the film begins there.
//!
//! Exit codes: 0 made · 1 nothing could be made · 2 usage · 3 some of several traces could not be
//! made into films · 130 interrupted.

use std::path::{Path, PathBuf};
use std::time::Instant;

use serde::Serialize;

use super::render_out::Report;
use super::render_source::SimulatedGrasp;
use super::render_visual::{finish, size};
use super::working::{Progress, interruptible};
use super::{Context, create_folder, print, print_json};
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
    /// Folder of the films
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Material of an object that has none of its own [default: drawn from the seed]
    #[arg(long, value_name = "NAME", value_parser = finish)]
    finish: Option<Finish>,
    /// Seed of light, ground, camera and colours
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Paths for each pixel of a colour image
    #[arg(long, value_name = "N", default_value_t = 64,
        value_parser = clap::value_parser!(u32).range(1..=1 << 20))]
    samples: u32,
    /// Columns and rows of the colour images
    #[arg(long, value_name = "WxH", default_value = "480x360", value_parser = size)]
    size: [usize; 2],
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// A film that was written.
#[derive(Debug, Serialize)]
struct Written {
    name: String,
    files: Vec<PathBuf>,
    bytes: usize,
    wall_s: f64,
}

/// Runs the verb.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    create_folder(&args.out)?;
    let json = args.json;
    let report = interruptible(context, "filming", move |progress| {
        Report::of_traces(&args.trace, progress, |trace| {
            film(&args, trace, progress).map(|written| vec![written])
        })
    })??;
    if json {
        print_json(&report)?;
    } else {
        let line = |w: &Written| {
            let kilobytes = w.bytes / 1000;
            format!("{}: {kilobytes} kB in {:.1} s", w.name, w.wall_s)
        };
        let lines: Vec<_> = report.images.iter().map(line).collect();
        print(&lines.join("\n"))?;
    }
    report.finish()
}

fn film(args: &Args, trace: &Path, progress: &Progress) -> Result<Written> {
    let began = Instant::now();
    let grasp = SimulatedGrasp::read(trace, None)?;
    let model = grasp.object.model(args.finish, args.seed, progress)?;
    let [width, height] = args.size;
    let settings = ClipSettings {
        colour: args.size,
        depth: [width * 2 / 3, height * 2 / 3].map(|side| side.max(1)),
        samples: args.samples,
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
    // The trace comes last: a folder has a film only once it is whole.
    for (file, bytes) in files.named(&name).iter().rev() {
        let path = args.out.join(file);
        save(&path, bytes)?;
        written.bytes += bytes.len();
        written.files.push(path);
    }
    written.wall_s = began.elapsed().as_secs_f64();
    Ok(written)
}
