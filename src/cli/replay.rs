//! `gripcast replay`: do the simulators end as reality did, grasp by grasp?
//!
//! ```text
//! gripcast replay demo --quick --out R              built-in, reality simulated: a first look
//! gripcast replay DATASET --objects OBJECTS --out R
//! gripcast replay DATASET --objects OBJECTS --engine fem --friction 0.4 --stop-force-n 20,40
//! gripcast replay DATASET --objects OBJECTS --pose-samples 10 --compare OLD/report.json
//! ```
//!
//! Every annotated, labelled grasp is simulated with every engine, friction and force. `OUT` gets
//! `report.json`, `report.html`, and a file for every finished case: a replay that was stopped
//! goes on where it was. Object files, scores and the report: `docs/replay.md`.
//!
//! Exit codes: 0 all grasps were replayed · 1 nothing could be replayed · 2 usage · 3 some grasps
//! or cases were left out, each with its reason · 75 stopped by SIGTERM, run it again ·
//! 130 interrupted; what is finished is kept.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use jiff::Timestamp;

use super::replay_report::{finish, text, write_report};
use super::sim_grasp::{GelName, PresetName, above_zero};
use super::working::{Progress, resumable};
use super::{Context, create_folder, print, print_json};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{ObjectName, Root};
use gripcast_dataset::Dataset;
use gripcast_replay::{
    CaseStore, DemoProgress, DemoSettings, DemoStage, DemoWatch, EngineSweep, Reality, Recording,
    ReplayInput, ReplayObject, ReplayProgress, ReplaySettings, Report, build_demo, compare,
    load_objects, page, read_report, replay,
};
use gripcast_sim::grasp::GraspSettings;
use gripcast_sim::rigid::{RigidEngine, RigidSettings};
use gripcast_sim::{EngineKind, FemEngine};
use gripcast_tactile::SensorProfile;

/// Paths for each pixel of a view in the report.
const VIEW_SAMPLES: u32 = 24;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(args_conflicts_with_subcommands = true, allow_negative_numbers = true)]
pub(crate) struct Args {
    #[command(subcommand)]
    demo: Option<Sub>,
    /// Directory of the dataset
    dataset: Option<PathBuf>,
    /// Folder of object files: OBJECT.toml for each object of the dataset
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
    /// Build a small dataset whose reality is simulated, and replay it
    Demo(Box<DemoArgs>),
}

#[derive(Clone, Debug, clap::Args)]
#[command(allow_negative_numbers = true)]
struct DemoArgs {
    /// 20 grasps instead of 100, on coarser meshes and with fewer settings
    #[arg(long)]
    quick: bool,
    /// Folder with data/egad_eval/{B1,B4,C2,C4}.obj, to grasp these and a built-in shape
    /// [default: $GRIPCAST_SHARED, else built-in shapes]
    #[arg(long, value_name = "DIR", conflicts_with = "quick")]
    shared: Option<PathBuf>,
    #[command(flatten)]
    sweep: SweepFlags,
}

#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "How it is replayed")]
struct SweepFlags {
    /// Engines
    #[arg(long, value_enum, value_delimiter = ',', default_values = ["fem", "rigid"])]
    engine: Vec<EngineName>,
    /// Friction coefficients of the finite elements [default: 0.2,0.4,0.8]
    #[arg(long, value_name = "MU", value_delimiter = ',', value_parser = above_zero)]
    friction: Vec<f64>,
    /// Stopping forces of the finite elements [default: 20,40,80]
    #[arg(long, value_name = "N", value_delimiter = ',', value_parser = above_zero)]
    stop_force_n: Vec<f64>,
    /// Friction coefficients of the rigid bodies [default: 0.1,0.25,0.4]
    #[arg(long, value_name = "MU", value_delimiter = ',', value_parser = above_zero)]
    rigid_friction: Vec<f64>,
    /// Closing forces of the rigid bodies [default: 5,10,20]
    #[arg(long, value_name = "N", value_delimiter = ',', value_parser = above_zero)]
    rigid_force_n: Vec<f64>,
    /// Set of parameters of the finite elements
    #[arg(long, value_enum, default_value_t = PresetName::Paper)]
    preset: PresetName,
    /// Mesh of the gels [default: default; coarse for demo --quick]
    #[arg(long, value_enum)]
    gel: Option<GelName>,
    /// Iterations after which a case is given up
    #[arg(long, value_name = "N", default_value_t = 50_000,
        value_parser = clap::value_parser!(u64).range(1..))]
    max_iterations: u64,
    /// Voxels of the convex decomposition along the longest side of an object
    #[arg(long, value_name = "N", default_value_t = RigidSettings::default().decomposition.resolution,
        value_parser = clap::value_parser!(u32).range(8..=512))]
    resolution: u32,
    /// Poses to draw from each grasp's covariance, at the chosen setting
    #[arg(long, value_name = "K", default_value_t = 0)]
    pose_samples: usize,
    /// Cases at a time; the results do not depend on it [default: all cores]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=256))]
    jobs: Option<u16>,
    /// Seed of drawn poses, images and the demo
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Sensor profile of the simulated tactile images [default: the GelSight Mini's]
    #[arg(long, value_name = "FILE")]
    sensor: Option<PathBuf>,
    /// Leave the images out of the report
    #[arg(long)]
    no_images: bool,
    /// Folder of report and cases
    #[arg(long, value_name = "DIR", default_value = "replay")]
    out: PathBuf,
    /// Earlier report.json: say what changed
    #[arg(long, value_name = "FILE")]
    compare: Option<PathBuf>,
    /// Simulate nothing, only say what would be replayed
    #[arg(long)]
    dry_run: bool,
    /// Print the report as JSON, without images and curves
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum EngineName {
    /// Finite-element gels, incremental potential contact
    Fem,
    /// Rigid fingers and convex pieces
    Rigid,
}

impl From<EngineName> for EngineKind {
    fn from(name: EngineName) -> Self {
        match name {
            EngineName::Fem => Self::Fem,
            EngineName::Rigid => Self::Rigid,
        }
    }
}

/// What is to be replayed, and what is said of it.
struct Source {
    dataset: PathBuf,
    objects: PathBuf,
    only: Vec<String>,
    reality: Option<Reality>,
}

/// Where the grasps come from.
enum Origin {
    Demo(Box<DemoArgs>),
    Recorded(Source),
}

/// Runs the verb.
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
        let missing =
            |what: &str, remedy: &str| Err(Error::usage(what.to_owned()).remedy(remedy.to_owned()));
        let Some(dataset) = self.dataset else {
            return missing(
                "name the dataset to replay",
                "gripcast replay DATASET --objects DIR, or gripcast replay demo",
            );
        };
        let Some(objects) = self.objects else {
            return missing(
                "`--objects` is missing: what was grasped?",
                "name a folder with OBJECT.toml for each object (docs/replay.md)",
            );
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
            jobs: sweep.jobs(),
        };
        let watch = DemoWatch {
            on_progress: &|at: DemoProgress| {
                progress.stage(match at.stage {
                    DemoStage::Screening => "drawing grasps",
                    DemoStage::Simulating => "simulating reality",
                    DemoStage::Recording => "recording reality",
                });
                progress.at(at.done as u64, at.total as u64);
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
    fn jobs(&self) -> usize {
        self.jobs
            .map_or_else(gripcast_base::workers::cores, usize::from)
    }

    fn for_demo(self, quick: bool) -> Self {
        let fewer = |given: Vec<f64>, quick_set: &[f64]| {
            if given.is_empty() && quick {
                quick_set.to_vec()
            } else {
                given
            }
        };
        Self {
            friction: fewer(self.friction, &[0.4]),
            gel: self.gel.or(quick.then_some(GelName::Coarse)),
            ..self
        }
    }

    fn settings(&self) -> Result<ReplaySettings> {
        let given = |values: &[f64], default: [f64; 3]| {
            let mut different: Vec<f64> = Vec::new();
            for value in if values.is_empty() { &default } else { values } {
                if !different.contains(value) {
                    different.push(*value);
                }
            }
            different
        };
        let mut fem = GraspSettings::new(self.preset.into());
        fem.resolution = self.gel.unwrap_or(GelName::Default).into();
        fem.solver.max_grasp_iterations = self.max_iterations;
        let mut rigid = RigidSettings::default();
        rigid.decomposition.resolution = self.resolution;
        create_folder(&self.out)?;
        let pieces = Root::new(&self.out).top().join("convex-pieces");
        let mut engines = Vec::new();
        for kind in EngineKind::ALL {
            if !self
                .engine
                .iter()
                .any(|name| EngineKind::from(*name) == kind)
            {
                continue;
            }
            engines.push(match kind {
                EngineKind::Fem => EngineSweep {
                    engine: Arc::new(FemEngine { settings: fem }),
                    frictions: given(&self.friction, [0.2, 0.4, 0.8]),
                    forces_n: given(&self.stop_force_n, [20.0, 40.0, 80.0]),
                },
                EngineKind::Rigid => EngineSweep {
                    engine: Arc::new(RigidEngine::new(rigid).with_cache(pieces.clone())?),
                    frictions: given(&self.rigid_friction, [0.1, 0.25, 0.4]),
                    forces_n: given(&self.rigid_force_n, [5.0, 10.0, 20.0]),
                },
            });
        }
        let sensor = match &self.sensor {
            Some(path) => SensorProfile::load(path)?,
            None => SensorProfile::gelsight_mini()?,
        };
        Ok(ReplaySettings {
            engines,
            seed: self.seed,
            jobs: self.jobs(),
            pose_samples: self.pose_samples,
            sensor,
            view_spp: (!self.no_images).then_some(VIEW_SAMPLES),
        })
    }
}

/// Replays and writes the report; none for a dry run.
fn replayed(
    source: &Source,
    sweep: &SweepFlags,
    command: String,
    progress: &Progress,
) -> Result<Option<(Report, PathBuf)>> {
    let old = sweep.compare.as_deref().map(read_report).transpose()?;
    let settings = sweep.settings()?;
    let dataset = Dataset::open(&source.dataset)?;
    let objects = load_objects(&source.objects)?;
    for warning in warnings(&objects) {
        progress.line(warning);
    }
    let only = (!source.only.is_empty()).then_some(source.only.as_slice());
    let recording = Recording::read(&dataset, &objects, only)?;
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
    let mut report = replay(&input, &settings, &store, &|at| told(progress, at))?;
    if let (Some(old), Some(path)) = (&old, &sweep.compare) {
        report.changes = Some(compare(old, &report, path));
    }
    write_report(&report, &page(&report)?, &sweep.out)?;
    Ok(Some((report, sweep.out.clone())))
}

fn warnings(objects: &BTreeMap<ObjectName, Result<ReplayObject>>) -> Vec<String> {
    let usable = objects.values().filter_map(|object| object.as_ref().ok());
    usable
        .flat_map(|object| {
            let named = |warning: &String| format!("{}: {warning}", object.name);
            object.warnings.iter().map(named).collect::<Vec<_>>()
        })
        .collect()
}

/// Frames of a virtual rig are no reality.
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

fn told(progress: &Progress, at: ReplayProgress) {
    let (stage, done, all) = match at {
        ReplayProgress::Cases(at) => ("replaying", at.done, at.total),
        ReplayProgress::Poses(at) => ("replaying drawn poses", at.done, at.total),
        ReplayProgress::Images { done, total } => ("drawing images", done, total),
        ReplayProgress::Note(line) => return progress.line(line),
    };
    progress.stage(stage);
    progress.at(done as u64, all as u64);
}

/// The command line of this process, quoted for a shell.
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
