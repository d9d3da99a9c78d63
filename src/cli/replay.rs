//! `gripcast replay`: compares simulated with real outcomes, grasp by grasp.
//!
//! ```text
//! gripcast replay demo --quick --out R              built-in demo with simulated reality
//! gripcast replay DATASET --objects OBJECTS --out R
//! gripcast replay DATASET --objects OBJECTS --engine fem --friction 0.4 --stop-force-n 20,40
//! gripcast replay DATASET --objects OBJECTS --force measured
//! gripcast replay DATASET --objects OBJECTS --pose-samples 10 --compare OLD/report.json
//! ```
//!
//! Every annotated, labelled grasp is simulated with every engine, friction and force. `OUT` gets
//! `report.json`, `report.html` and a file per finished case, so that an interrupted replay is
//! resumed. Object files, scores and the report: `docs/how-to/replay.md`.
//!
//! Exit codes: 0 all grasps replayed · 1 none replayed · 2 usage · 3 some grasps or cases were
//! left out · 75 stopped by SIGTERM, rerun to resume · 130 interrupted; finished cases are kept.

use std::path::PathBuf;
use std::sync::Arc;

use jiff::Timestamp;

use super::flags::{JobsFlag, above_zero, engine, gel_resolution, preset};
use super::replay_report::{finish, text, write_report};
use super::working::{Progress, resumable};
use super::{Context, create_folder, print, print_json};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::Root;
use gripcast_dataset::Dataset;
use gripcast_replay::{
    CaseStore, DemoProgress, DemoSettings, DemoStage, DemoWatch, EngineSweep, Reality, Recording,
    ReplayInput, ReplayProgress, ReplaySettings, Report, build_demo, compare, load_objects, page,
    read_report, replay,
};
use gripcast_sim::fem::GelResolution;
use gripcast_sim::grasp::{GraspSettings, Preset};
use gripcast_sim::rigid::{RigidEngine, RigidSettings};
use gripcast_sim::{EngineKind, FemEngine};
use gripcast_tactile::SensorProfile;

/// Samples per pixel of the images in the report.
const VIEW_SPP: u32 = 24;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(args_conflicts_with_subcommands = true)]
pub(crate) struct Args {
    #[command(subcommand)]
    demo: Option<Sub>,
    /// Folder of the dataset
    dataset: Option<PathBuf>,
    /// Folder with OBJECT.toml for each object of the dataset
    #[arg(long, value_name = "DIR")]
    objects: Option<PathBuf>,
    /// Replay only these objects
    #[arg(long, value_name = "NAME", value_delimiter = ',')]
    only: Vec<String>,
    #[command(flatten)]
    sweep: SweepFlags,
}

#[derive(Clone, Debug, clap::Subcommand)]
enum Sub {
    /// Build and replay a small dataset with simulated reality
    Demo(Box<DemoArgs>),
}

#[derive(Clone, Debug, clap::Args)]
struct DemoArgs {
    /// Use 20 grasps instead of 100, coarser meshes and fewer settings
    #[arg(long)]
    quick: bool,
    /// Folder with data/egad_eval/{B1,B4,C2,C4}.obj, grasped beside a built-in shape [default:
    /// $GRIPCAST_SHARED, else built-in shapes only]
    #[arg(long, value_name = "DIR", conflicts_with = "quick")]
    shared: Option<PathBuf>,
    #[command(flatten)]
    sweep: SweepFlags,
}

#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Replay settings")]
struct SweepFlags {
    /// Output directory of the report and the cases
    #[arg(long, value_name = "DIR", default_value = "replay")]
    out: PathBuf,
    /// Simulation engines, comma-separated
    #[arg(long, value_name = "ENGINE", value_delimiter = ',', default_values = ["fem", "rigid"],
        value_parser = engine())]
    engine: Vec<EngineKind>,
    /// Friction coefficients of the FEM engine, comma-separated [default: 0.2,0.4,0.8]
    #[arg(long, value_name = "MU", value_delimiter = ',', value_parser = above_zero)]
    friction: Vec<f64>,
    /// Stopping forces of the FEM engine, comma-separated [default: 20,40,80]
    #[arg(long, value_name = "NEWTON", value_delimiter = ',', value_parser = above_zero)]
    stop_force_n: Vec<f64>,
    /// Friction coefficients of the rigid engine, comma-separated [default: 0.1,0.25,0.4]
    #[arg(long, value_name = "MU", value_delimiter = ',', value_parser = above_zero)]
    rigid_friction: Vec<f64>,
    /// Closing forces of the rigid engine, comma-separated [default: 5,10,20]
    #[arg(long, value_name = "NEWTON", value_delimiter = ',', value_parser = above_zero)]
    rigid_force_n: Vec<f64>,
    /// Forces of the engines: those of a list, of which the best is searched, or the one that was
    /// measured on each grasp
    #[arg(long, value_enum, value_name = "SOURCE", default_value_t = Forces::Search)]
    force: Forces,
    /// Gel parameters of the FEM engine
    #[arg(long, value_name = "PRESET", default_value = "paper", value_parser = preset())]
    preset: Preset,
    /// Gel mesh [default: default; coarse for demo --quick]
    #[arg(long, value_name = "MESH", value_parser = gel_resolution())]
    gel: Option<GelResolution>,
    /// Iteration limit per case
    #[arg(long, value_name = "N", default_value_t = 50_000,
        value_parser = clap::value_parser!(u64).range(1..))]
    max_iterations: u64,
    /// Voxels of the convex decomposition along the longest side of an object
    #[arg(long, value_name = "N", default_value_t = RigidSettings::default().decomposition.resolution,
        value_parser = clap::value_parser!(u32).range(8..=512))]
    resolution: u32,
    /// Poses to sample from each grasp's covariance at the best setting
    #[arg(long, value_name = "N", default_value_t = 0)]
    pose_samples: usize,
    /// Sensor profile of the simulated tactile images [default: gelsight-mini]
    #[arg(long, value_name = "FILE")]
    sensor: Option<String>,
    /// Omit images from the report
    #[arg(long)]
    no_images: bool,
    /// Compare with an earlier report.json
    #[arg(long, value_name = "FILE")]
    compare: Option<PathBuf>,
    /// Random seed of pose samples, images and the demo
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    jobs: JobsFlag,
    /// Only print what would be replayed
    #[arg(long)]
    dry_run: bool,
    /// Print the report as JSON, without images and curves
    #[arg(long)]
    json: bool,
}

/// Where the forces of a replay come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Forces {
    /// `--stop-force-n` and `--rigid-force-n`
    Search,
    /// The normal force that is stored with each grasp
    Measured,
}

/// Recorded grasps to replay.
struct Source {
    dataset: PathBuf,
    objects: PathBuf,
    only: Vec<String>,
    reality: Option<Reality>,
}

enum Origin {
    Demo(Box<DemoArgs>),
    Recorded(Source),
}

/// Runs the command.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    let command = command();
    let (sweep, origin) = match args.demo {
        Some(Sub::Demo(demo)) => {
            let sweep = demo.sweep.clone().for_demo(demo.quick);
            (sweep, Origin::Demo(demo))
        }
        None => {
            let sweep = args.sweep.clone();
            (sweep, Origin::Recorded(args.source()?))
        }
    };
    let json = sweep.json;
    let report = resumable(context, "replaying", move |progress| {
        let source = match origin {
            Origin::Demo(demo) => demo.build(&sweep, progress)?,
            Origin::Recorded(source) => source,
        };
        replayed(&source, &sweep, command, progress)
    })??;
    let Some((report, out)) = report else {
        return Ok(());
    };
    if json {
        print_json(&report.without_media())?;
    } else {
        print(&text(&report, &out))?;
    }
    finish(&report)
}

impl Args {
    fn source(self) -> Result<Source> {
        let Some(dataset) = self.dataset else {
            return Err(Error::usage("no dataset given")
                .remedy("use gripcast replay DATASET --objects DIR, or gripcast replay demo"));
        };
        let Some(objects) = self.objects else {
            return Err(Error::usage("`--objects` is missing")
                .remedy("name a folder with OBJECT.toml for each object (docs/how-to/replay.md)"));
        };
        Ok(Source {
            dataset,
            objects,
            only: self.only,
            reality: None,
        })
    }
}

impl DemoArgs {
    fn build(&self, sweep: &SweepFlags, progress: &Progress) -> Result<Source> {
        let settings = DemoSettings {
            seed: sweep.seed,
            quick: self.quick,
            shared: self
                .shared
                .clone()
                .or_else(|| std::env::var_os("GRIPCAST_SHARED").map(PathBuf::from)),
            jobs: sweep.jobs.count(),
        };
        let watch = DemoWatch {
            on_progress: &|at: DemoProgress| {
                progress.stage(match at.stage {
                    DemoStage::Screening => "drawing grasps",
                    DemoStage::Simulating => "simulating reality",
                    DemoStage::Recording => "recording reality",
                });
                progress.count(at.done, at.total);
            },
            cancel: None,
        };
        let data = build_demo(&settings, &sweep.out, &watch)?;
        Ok(Source {
            dataset: data.dataset,
            objects: data.objects,
            only: Vec::new(),
            reality: Some(Reality::Simulated {
                description: data.description,
            }),
        })
    }
}

impl SweepFlags {
    fn for_demo(mut self, quick: bool) -> Self {
        if quick {
            if self.friction.is_empty() {
                self.friction = vec![0.4];
            }
            self.gel = self.gel.or(Some(GelResolution::Coarse));
        }
        self
    }

    fn settings(&self) -> Result<ReplaySettings> {
        let has_list = !(self.stop_force_n.is_empty() && self.rigid_force_n.is_empty());
        if self.force == Forces::Measured && has_list {
            let what = "`--force measured` cannot be combined with a list of forces";
            return Err(Error::usage(what).remedy("omit --stop-force-n and --rigid-force-n"));
        }
        let unique = |values: &[f64], default: [f64; 3]| {
            let mut unique: Vec<f64> = Vec::new();
            for value in if values.is_empty() { &default } else { values } {
                if !unique.contains(value) {
                    unique.push(*value);
                }
            }
            unique
        };
        let mut fem = GraspSettings::new(self.preset);
        fem.resolution = self.gel.unwrap_or(GelResolution::Default);
        fem.solver.max_grasp_iterations = self.max_iterations;
        let mut rigid = RigidSettings::default();
        rigid.decomposition.resolution = self.resolution;
        create_folder(&self.out)?;
        let mut engines = Vec::new();
        if self.engine.contains(&EngineKind::Fem) {
            engines.push(EngineSweep {
                engine: Arc::new(FemEngine { settings: fem }),
                frictions: unique(&self.friction, [0.2, 0.4, 0.8]),
                forces_n: unique(&self.stop_force_n, [20.0, 40.0, 80.0]),
            });
        }
        if self.engine.contains(&EngineKind::Rigid) {
            let cache = Root::new(&self.out).top().join("convex-pieces");
            engines.push(EngineSweep {
                engine: Arc::new(RigidEngine::new(rigid).with_cache(cache)?),
                frictions: unique(&self.rigid_friction, [0.1, 0.25, 0.4]),
                forces_n: unique(&self.rigid_force_n, [5.0, 10.0, 20.0]),
            });
        }
        let sensor = match &self.sensor {
            Some(name) => SensorProfile::named_or_load(name)?,
            None => SensorProfile::gelsight_mini()?,
        };
        Ok(ReplaySettings {
            engines,
            seed: self.seed,
            jobs: self.jobs.count(),
            pose_samples: self.pose_samples,
            measured_forces: self.force == Forces::Measured,
            sensor,
            view_spp: (!self.no_images).then_some(VIEW_SPP),
        })
    }
}

/// Replays and writes the report; returns none for a dry run.
fn replayed(
    source: &Source,
    sweep: &SweepFlags,
    command: String,
    progress: &Progress,
) -> Result<Option<(Report, PathBuf)>> {
    let old = sweep.compare.as_deref().map(read_report).transpose()?;
    let mut settings = sweep.settings()?;
    let dataset = Dataset::open(&source.dataset)?;
    let objects = load_objects(&source.objects)?;
    for object in objects.values().flatten() {
        for warning in &object.warnings {
            progress.line(format!("{}: {warning}", object.name));
        }
    }
    let only = (!source.only.is_empty()).then_some(source.only.as_slice());
    let mut recording = Recording::read(&dataset, &objects, only)?;
    if settings.measured_forces {
        let (with_force, median_n) = recording.with_measured_forces()?;
        recording = with_force;
        for engine in &mut settings.engines {
            engine.forces_n = vec![median_n];
        }
        let uncalibrated = recording.uncalibrated();
        if uncalibrated > 0 {
            progress.line(format!(
                "{uncalibrated} of {} measured forces are not calibrated with weights; run \
                 `gripcast calibrate force` before you trust their newtons",
                recording.grasps.len()
            ));
        }
    }
    for left_out in &recording.left_out {
        progress.line(format!("{}: {}", left_out.grasp, left_out.reason));
    }
    if sweep.dry_run {
        let cases: usize = settings
            .engines
            .iter()
            .map(|e| e.frictions.len() * e.forces_n.len() * recording.grasps.len())
            .sum();
        print(&format!(
            "{} of {} grasps can be replayed: {cases} cases",
            recording.grasps.len(),
            recording.total
        ))?;
        return Ok(None);
    }
    let store = CaseStore::new(Root::new(&sweep.out).top().join("cases"));
    let input = ReplayInput {
        dataset: &dataset,
        recording: &recording,
        objects: &objects,
        reality: source
            .reality
            .clone()
            .unwrap_or_else(|| reality(&recording)),
        command,
        written_at: Timestamp::now().to_string(),
    };
    let mut report = replay(&input, &settings, &store, &|at| show(progress, at))?;
    if let (Some(old), Some(path)) = (&old, &sweep.compare) {
        report.changes = Some(compare(old, &report, path));
    }
    write_report(&report, &page(&report)?, &sweep.out)?;
    Ok(Some((report, sweep.out.clone())))
}

/// Returns the origin of the outcomes: grasps with a ground truth come from a virtual rig.
fn reality(recording: &Recording) -> Reality {
    let simulated = recording.grasps.iter().any(|g| g.record.truth.is_some());
    if simulated {
        Reality::Simulated {
            description: "the grasps were recorded on a virtual rig".to_owned(),
        }
    } else {
        Reality::Real
    }
}

fn show(progress: &Progress, at: ReplayProgress) {
    let (stage, done, all) = match at {
        ReplayProgress::Cases(at) => ("replaying", at.done, at.total),
        ReplayProgress::Poses(at) => ("replaying sampled poses", at.done, at.total),
        ReplayProgress::Images { done, total: all } => ("drawing images", done, all),
        ReplayProgress::Note(line) => return progress.line(line),
    };
    progress.stage(stage);
    progress.count(done, all);
}

/// Returns the command line of this process, quoted for a shell.
fn command() -> String {
    let quoted = |argument: String| {
        let plain = |c: char| c.is_ascii_alphanumeric() || "-_./,:=+@%".contains(c);
        if !argument.is_empty() && argument.chars().all(plain) {
            argument
        } else {
            format!("'{}'", argument.replace('\'', r"'\''"))
        }
    };
    let rest = std::env::args_os().skip(1);
    let rest = rest.map(|argument| quoted(argument.to_string_lossy().into_owned()));
    std::iter::once("gripcast".to_owned())
        .chain(rest)
        .collect::<Vec<_>>()
        .join(" ")
}
