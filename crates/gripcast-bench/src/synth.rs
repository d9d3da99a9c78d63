//! `gripcast-bench synth`: simulated and rendered grasps per hour.
//!
//! ```text
//! gripcast-bench synth --json                        coarse and default gels
//! gripcast-bench synth --gel coarse --compare fine   agreement of the labels
//! ```
//!
//! The same procedural objects and grasps with each gel mesh, simulated, rendered and stored as by
//! `gripcast synth run`. Exit codes: 0 measured · 1 failed · 2 usage · 4 labels agree on less than
//! 95 %, or more than 1 % of the simulations failed · 130 interrupted.

use std::path::Path;
use std::time::Instant;

use gripcast::cli::Context;
use gripcast::cli::bench::Report;
use gripcast::cli::working::{Progress, interruptible};
use gripcast::daemon::live_load::peak_rss_mb;
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::workers::cores;
use gripcast_sim::fem::GelResolution;
use gripcast_sim::grasp::{GraspSettings, Preset};
use gripcast_sim::{Engine, FemEngine};
use gripcast_synth::plan::{
    FrictionFrom, MIN_FRICTION_FRACTION, Plan, PlanPreset, PlanSettings, Shard, family_drafts,
    make_plan,
};
use gripcast_synth::properties::MassMap;
use gripcast_synth::{
    CpuSeconds, ImageSelection, ResultStore, RunSettings, run as run_plan, simulate_labels,
};
use serde::Serialize;
use serde_json::{Map, Value, json};

/// Minimum fraction of agreeing labels.
const MIN_AGREEMENT: f64 = 0.95;
/// Maximum fraction of failed simulations.
const MAX_FAILURES: f64 = 0.01;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    /// Number of objects
    #[arg(long, value_name = "N", default_value_t = 18)]
    objects: usize,
    /// Grasps per object, each at 10 and 40 N
    #[arg(long, value_name = "N", default_value_t = 1)]
    grasps: usize,
    /// Gel meshes, comma-separated
    #[arg(long, value_parser = GelResolution::from_name, value_delimiter = ',',
        default_values = ["coarse", "default"])]
    gel: Vec<GelResolution>,
    /// Gel mesh to compare the labels with
    #[arg(long, value_parser = GelResolution::from_name)]
    compare: Option<GelResolution>,
    /// Random seed of the plan
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    seed: u64,
    /// Number of parallel simulations [default: all cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256))]
    jobs: Option<u16>,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// Figures of a gel mesh.
#[derive(Clone, Debug, Serialize)]
struct Figures {
    /// Simulated and rendered grasps per hour of wall time.
    grasps_per_hour: f64,
    simulations: usize,
    stable: usize,
    slip: usize,
    failed: usize,
    /// Mean CPU time of the stages of a simulation.
    cpu_s: CpuSeconds,
    rss_mb: f64,
    /// Fraction of the labelled simulations with the label of the other mesh.
    #[serde(skip_serializing_if = "Option::is_none")]
    label_agreement: Option<f64>,
}

/// Runs the benchmark.
pub(crate) fn run(context: &Context, args: &Args) -> Result<()> {
    let own = args.clone();
    let found = interruptible(context, "simulating", move |progress| {
        measure(&own, progress)
    })??;
    report(args, &found).print(args.json)?;
    let failed = |f: &Figures| f.failed as f64 > MAX_FAILURES * f.simulations as f64;
    let differs = |f: &Figures| {
        f.label_agreement
            .is_some_and(|fraction| fraction < MIN_AGREEMENT)
    };
    if found.iter().any(|(_, f)| failed(f) || differs(f)) {
        return Err(Error::new(
            ErrorKind::Check,
            "labels agree on less than 95 %, or more than 1 % of the simulations failed",
        ));
    }
    Ok(())
}

fn measure(args: &Args, progress: &Progress) -> Result<Vec<(GelResolution, Figures)>> {
    let folder = tempfile::tempdir().map_err(|e| Error::io("cannot create a folder", e))?;
    let mut found = Vec::new();
    let mut reference = None;
    for gel in &args.gel {
        let engine = engine(*gel);
        let jobs = args.jobs();
        let drafts = family_drafts(args.objects, args.seed, jobs, &|_| ())?;
        let made = make_plan(
            &plan_settings(args.seed, args.grasps, jobs),
            drafts.into(),
            &engine,
            None,
            &|_| (),
        )?;
        let plan_folder = folder.path().join(gel.name());
        made.write(&plan_folder)?;
        let plan = made.plan;
        progress.line(format!("{} gels", gel.name()));
        let mut figures = figures(&plan, &plan_folder, &engine, jobs, progress)?;
        if let Some(other) = args.compare {
            if reference.is_none() {
                progress.line(format!("{} gels, for their labels", other.name()));
                let on_progress = |done: usize| progress.count(done, plan.simulations.len());
                let other = self::engine(other);
                reference = Some(simulate_labels(
                    &plan,
                    &plan_folder,
                    &other,
                    jobs,
                    &on_progress,
                )?);
            }
            figures.label_agreement = agreement(&plan, &plan_folder, reference.as_deref())?;
        }
        found.push((*gel, figures));
    }
    Ok(found)
}

fn figures(
    plan: &Plan,
    folder: &Path,
    engine: &dyn Engine,
    jobs: usize,
    progress: &Progress,
) -> Result<Figures> {
    let start = Instant::now();
    let on_progress = |at: gripcast_synth::RunProgress| progress.count(at.done, at.total);
    let settings = RunSettings {
        shard: Shard::WHOLE,
        jobs,
        retry_failed: false,
        simulate_open: true,
        images: ImageSelection::All,
    };
    let summary = run_plan(plan, folder, &settings, engine, &on_progress)?;
    let wall_h = start.elapsed().as_secs_f64() / 3600.0;
    let store = ResultStore::new(folder);
    let mut figures = Figures {
        grasps_per_hour: summary.simulated as f64 / wall_h,
        simulations: summary.total,
        stable: 0,
        slip: 0,
        failed: summary.failed.len(),
        cpu_s: CpuSeconds::default(),
        rss_mb: peak_rss_mb(),
        label_agreement: None,
    };
    for simulation in &plan.simulations {
        let Some(result) = store.load(plan, &simulation.id)? else {
            continue;
        };
        figures.stable += usize::from(result.stable == Some(true));
        figures.slip += usize::from(result.stable == Some(false));
        let (sum, own) = (&mut figures.cpu_s, result.cpu_s);
        let fraction = 1.0 / summary.total as f64;
        sum.prepare += fraction * own.prepare;
        sum.simulate += fraction * own.simulate;
        sum.tactile += fraction * own.tactile;
        sum.visual += fraction * own.visual;
    }
    Ok(figures)
}

/// Returns the fraction of the labelled results that agree with `reference`.
fn agreement(
    plan: &Plan,
    folder: &Path,
    reference: Option<&[Option<bool>]>,
) -> Result<Option<f64>> {
    let store = ResultStore::new(folder);
    let [mut same, mut all] = [0; 2];
    for (simulation, other) in plan.simulations.iter().zip(reference.unwrap_or_default()) {
        let found = store.load(plan, &simulation.id)?;
        if let Some(stable) = found.and_then(|result| result.stable) {
            all += 1;
            same += usize::from(*other == Some(stable));
        }
    }
    Ok((all > 0).then(|| same as f64 / all as f64))
}

fn engine(gel: GelResolution) -> FemEngine {
    let mut settings = GraspSettings::new(Preset::Paper);
    settings.resolution = gel;
    FemEngine { settings }
}

impl Args {
    fn jobs(&self) -> usize {
        self.jobs.map_or_else(cores, usize::from)
    }
}

/// Settings of a plan with the paper's stopping forces.
pub(crate) fn plan_settings(seed: u64, grasps: usize, jobs: usize) -> PlanSettings {
    PlanSettings {
        preset: "bench".to_owned(),
        seed,
        grasps,
        stop_forces_n: vec![10.0, 40.0],
        rendering: PlanPreset::SMALL.rendering,
        textures: Vec::new(),
        mass_map: MassMap::Logarithmic,
        friction_from: FrictionFrom::Soiled,
        min_friction_fraction: MIN_FRICTION_FRACTION,
        jobs,
    }
}

fn report(args: &Args, found: &[(GelResolution, Figures)]) -> Report {
    let gels: Map<String, Value> = found
        .iter()
        .map(|(gel, figures)| (gel.name().to_owned(), json!(figures)))
        .collect();
    let params = json!({
        "objects": args.objects,
        "grasps": args.grasps,
        "seed": args.seed,
        "jobs": args.jobs(),
        "renderings": PlanPreset::SMALL.rendering.renderings,
        "compare": args.compare.map(GelResolution::name),
    });
    Report::new("synth", params, gels.into(), text(args, found))
}

fn text(args: &Args, found: &[(GelResolution, Figures)]) -> String {
    let mut lines = Vec::new();
    for (gel, figures) in found {
        let cpu = figures.cpu_s;
        lines.push(format!(
            "{:8} {:6.0} grasps/h · {} stable, {} slip, {} failed · CPU s: prepare {:.2}, \
             simulate {:.2}, tactile {:.2}, visual {:.2} · {:.0} MB",
            gel.name(),
            figures.grasps_per_hour,
            figures.stable,
            figures.slip,
            figures.failed,
            cpu.prepare,
            cpu.simulate,
            cpu.tactile,
            cpu.visual,
            figures.rss_mb,
        ));
        if let (Some(fraction), Some(other)) = (figures.label_agreement, args.compare) {
            lines.push(format!(
                "{:8} labels agree with {} gels on {:.1} %",
                "",
                other.name(),
                1e2 * fraction
            ));
        }
    }
    lines.join("\n")
}
