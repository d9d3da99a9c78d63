//! `gripcast-bench grasp`: simulated grasps of the paper's protocol at 40 N.
//!
//! *Easy* grasps meet the object squarely; *hard* ones push, rotate or tilt it, touch edges or
//! slip. Each case is simulated `--repeat` times and the minimum time is reported; steps,
//! iterations and outcomes are deterministic. EGAD's B1 is read from the folder of shared data
//! (`GRIPCAST_SHARED`, else `../shared`); without it, its cases are skipped. Finally, the
//! throughput of independent grasps on one and on two threads, one grasp per thread.
//!
//! Exit codes: 0 measured · 3 measured, but cases were skipped or did not converge.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::Instant;

use gripcast::cli::Context;
use gripcast::cli::bench::Report;
use gripcast::cli::working::{Progress, interruptible};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_geometry::{LengthUnit, MeshOptions, TriangleMesh, load_object_mesh};
use gripcast_sim::fem::GelResolution;
use gripcast_sim::grasp::{GraspOutcome, GraspSettings, GraspSummary, Scene, StageWork, simulate};
use gripcast_sim::solver::PhaseTimes;
use rayon::ThreadPool;
use serde::Serialize;
use serde_json::{Value, json};

use crate::grasp_cases::{CaseClass, GraspCase, cases};
use crate::timing::pool;

/// Grasps per thread in the throughput measurement.
const GRASPS_PER_THREAD: usize = 4;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    /// Gel meshes, comma-separated
    #[arg(long, value_parser = GelResolution::from_name, value_delimiter = ',', default_value = "coarse")]
    gel: Vec<GelResolution>,
    /// Simulations per case; the minimum time is reported
    #[arg(long, value_name = "N", default_value_t = 1,
        value_parser = clap::value_parser!(u32).range(1..=100))]
    repeat: u32,
    /// Class of cases
    #[arg(long, value_parser = ["easy", "hard", "all"], default_value = "all")]
    class: String,
    /// Only run cases whose name contains this text
    #[arg(long, value_name = "TEXT", default_value = "")]
    only: String,
    /// Number of threads of a grasp
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u16).range(1..=256))]
    threads: u16,
    /// Newton convergence tolerance (max nodal speed, m/s)
    #[arg(long, value_name = "M_PER_S")]
    tolerance: Option<f64>,
    /// Skip the throughput of independent grasps
    #[arg(long)]
    no_throughput: bool,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// Result of a case.
#[derive(Serialize)]
struct Measured {
    case: &'static str,
    class: CaseClass,
    gel: &'static str,
    wall_s: f64,
    steps: usize,
    newton_per_step: f64,
    newton_max: u32,
    stages: Vec<StageWork>,
    times: PhaseTimes,
    outcome: GraspOutcome,
    outcome_ok: bool,
    lifted_m: f64,
    mean_force_n: Option<f64>,
    unconverged_steps: usize,
}

struct Outcome {
    measured: Vec<Measured>,
    skipped: Vec<&'static str>,
    throughput: Option<[f64; 2]>,
}

/// Runs the benchmark.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    let is_json = args.json;
    let params = params(&args);
    let outcome = interruptible(context, "simulating grasps", move |progress| {
        measure(&args, progress)
    })??;
    let mut report = Report::new("grasp", params, json!(figures(&outcome)), table(&outcome));
    let more = json!({"cases": outcome.measured, "skipped": outcome.skipped});
    report
        .more
        .extend(more.as_object().cloned().unwrap_or_default());
    report.print(is_json)?;
    let unconverged = outcome
        .measured
        .iter()
        .filter(|m| m.outcome == GraspOutcome::NotConverged);
    let unconverged = unconverged.count();
    if outcome.skipped.is_empty() && unconverged == 0 {
        return Ok(());
    }
    let skipped = outcome.skipped.len();
    let error = Error::new(
        ErrorKind::Partial,
        format!("{skipped} case(s) skipped, {unconverged} not converged"),
    );
    Err(if skipped > 0 {
        error.remedy("set GRIPCAST_SHARED to the folder with data/egad_eval/B1.obj")
    } else {
        error
    })
}

fn params(args: &Args) -> Value {
    let settings = args.settings(GelResolution::Default);
    let gels = args.gel.iter().map(|&gel| gel.name());
    json!({
        "class": args.class,
        "gel": gels.collect::<Vec<_>>(),
        "repeat": args.repeat,
        "threads": args.threads,
        "stop_force_n": settings.protocol.stop_force_n,
        "tolerance_m_s": settings.solver.newton_tolerance_m_s,
    })
}

impl Args {
    fn settings(&self, resolution: GelResolution) -> GraspSettings {
        let mut settings = GraspSettings {
            resolution,
            ..GraspSettings::default()
        };
        if let Some(tolerance) = self.tolerance {
            settings.solver.newton_tolerance_m_s = tolerance;
        }
        settings
    }
}

fn measure(args: &Args, progress: &Progress) -> Result<Outcome> {
    let pool = pool(usize::from(args.threads))?;
    let mut outcome = Outcome {
        measured: Vec::new(),
        skipped: Vec::new(),
        throughput: None,
    };
    let chosen: Vec<GraspCase> = cases()
        .into_iter()
        .filter(|case| {
            (args.class == "all" || args.class == case.class.name())
                && case.name.contains(&args.only)
        })
        .collect();
    if chosen.is_empty() {
        return Err(Error::usage(format!(
            "no case of this class has a name with {:?}",
            args.only
        ))
        .remedy("omit --only to see the names"));
    }
    let total = chosen.len() * args.gel.len();
    let mut done = 0;
    for (i, &gel) in args.gel.iter().enumerate() {
        let settings = args.settings(gel);
        for case in &chosen {
            progress.count(done, total);
            done += 1;
            let Some(mesh) = case.object.load(&shared_mesh)? else {
                if i == 0 {
                    progress.line(format!("SKIPPED {}: mesh not found", case.name));
                    outcome.skipped.push(case.name);
                }
                continue;
            };
            let scene = case.scene(mesh, &settings)?;
            let measured = measure_case(case, &scene, &settings, &pool, args.repeat)?;
            progress.line(row(&measured));
            outcome.measured.push(measured);
        }
    }
    if !args.no_throughput {
        progress.line("throughput of independent grasps");
        outcome.throughput = Some(throughput(args)?);
    }
    Ok(outcome)
}

fn measure_case(
    case: &GraspCase,
    scene: &Scene,
    settings: &GraspSettings,
    pool: &ThreadPool,
    repeat: u32,
) -> Result<Measured> {
    let mut wall_s = f64::INFINITY;
    let mut best = None;
    for _ in 0..repeat {
        let started = Instant::now();
        let result = pool.install(|| simulate(scene, &settings.protocol, &settings.solver))?;
        let elapsed = started.elapsed().as_secs_f64();
        if elapsed < wall_s {
            wall_s = elapsed;
            let dt_s = settings.solver.dt_s;
            let summary = GraspSummary::new(&result, &settings.protocol, dt_s);
            best = Some((summary, result.times));
        }
    }
    let (summary, times) = best.ok_or_else(|| Error::internal("nothing was repeated"))?;
    Ok(Measured {
        case: case.name,
        class: case.class,
        gel: settings.resolution.name(),
        wall_s,
        steps: summary.steps,
        newton_per_step: summary.newton_per_step,
        newton_max: summary.newton_max,
        stages: summary.stages,
        times,
        outcome: summary.outcome,
        outcome_ok: summary.outcome == case.expected_on(settings.resolution),
        lifted_m: summary.lifted_m,
        mean_force_n: summary.mean_force_n,
        unconverged_steps: summary.unconverged_steps,
    })
}

/// Measures independent grasps per second on one and on two threads.
fn throughput(args: &Args) -> Result<[f64; 2]> {
    let settings = args.settings(args.gel.first().copied().unwrap_or(GelResolution::Coarse));
    let scenes: Vec<Scene> = cases()
        .iter()
        .filter(|case| case.class == CaseClass::Easy)
        .filter_map(|case| {
            let mesh = case.object.load(&|_, _| Ok(None)).transpose()?;
            Some(mesh.and_then(|mesh| case.scene(mesh, &settings)))
        })
        .collect::<Result<_>>()?;
    let one = grasps_per_second(&scenes, &settings, 1)?;
    Ok([one, grasps_per_second(&scenes, &settings, 2)?])
}

fn grasps_per_second(scenes: &[Scene], settings: &GraspSettings, threads: usize) -> Result<f64> {
    let pools = (0..threads).map(|_| pool(1)).collect::<Result<Vec<_>>>()?;
    let all = GRASPS_PER_THREAD * threads;
    let next = AtomicUsize::new(0);
    let started = Instant::now();
    thread::scope(|scope| {
        let workers: Vec<_> = pools
            .iter()
            .map(|pool| {
                scope.spawn(|| -> Result<()> {
                    loop {
                        let index = next.fetch_add(1, Ordering::Relaxed);
                        if index >= all {
                            return Ok(());
                        }
                        let scene = &scenes[index % scenes.len()];
                        pool.install(|| simulate(scene, &settings.protocol, &settings.solver))?;
                    }
                })
            })
            .collect();
        for worker in workers {
            worker
                .join()
                .map_err(|_| Error::internal("a grasp ended early"))??;
        }
        Ok::<(), Error>(())
    })?;
    Ok(all as f64 / started.elapsed().as_secs_f64())
}

/// Loads a mesh of the folder of shared data, m, if it exists.
fn shared_mesh(item: &str, unit_m: f64) -> Result<Option<TriangleMesh>> {
    let root = std::env::var_os("GRIPCAST_SHARED").map_or("../shared".into(), PathBuf::from);
    let path = root.join(item);
    if !path.exists() {
        return Ok(None);
    }
    let options = MeshOptions::new(LengthUnit::Metre, unit_m);
    let prepared = load_object_mesh(&path.to_string_lossy(), &options)?;
    Ok(Some(prepared.mesh))
}

fn figures(outcome: &Outcome) -> BTreeMap<String, Value> {
    let mut figures = BTreeMap::new();
    let mut groups: BTreeMap<String, Vec<&Measured>> = BTreeMap::new();
    for measured in &outcome.measured {
        let key = format!("{}_{}", measured.class.name(), measured.gel);
        groups.entry(key).or_default().push(measured);
        let key = format!("{}_{}", measured.case, measured.gel);
        figures.insert(format!("{key}_wall_s"), json!(measured.wall_s));
    }
    for (key, group) in groups {
        let mut walls: Vec<f64> = group.iter().map(|m| m.wall_s).collect();
        walls.sort_unstable_by(f64::total_cmp);
        let newton: f64 = group.iter().map(|m| m.newton_per_step).sum();
        let steps: usize = group.iter().map(|m| m.steps).sum();
        let mut add = |name: &str, value: Value| figures.insert(format!("{key}_{name}"), value);
        add("cases", json!(group.len()));
        add("wall_s_max", json!(walls.last()));
        add("wall_s_median", json!(walls[walls.len() / 2]));
        add("steps_mean", json!(steps as f64 / group.len() as f64));
        add("newton_per_step_mean", json!(newton / group.len() as f64));
        add(
            "outcome_ok",
            json!(group.iter().filter(|m| m.outcome_ok).count()),
        );
    }
    if let Some([one, two]) = outcome.throughput {
        figures.insert("grasps_per_s_1_thread".into(), json!(one));
        figures.insert("grasps_per_s_2_threads".into(), json!(two));
        figures.insert("throughput_ratio".into(), json!(two / one));
    }
    figures
}

fn row(m: &Measured) -> String {
    let outcome = serde_json::to_value(m.outcome).unwrap_or_default();
    format!(
        "{:<6} {:<8} {:<20} {:>7.2} {:>6} {:>7.2} {:>4}  {}{}",
        m.class.name(),
        m.gel,
        m.case,
        m.wall_s,
        m.steps,
        m.newton_per_step,
        m.newton_max,
        outcome.as_str().unwrap_or("?"),
        if m.outcome_ok { "" } else { " (unexpected)" }
    )
}

fn table(outcome: &Outcome) -> String {
    let mut lines = vec![format!(
        "{:<6} {:<8} {:<20} {:>7} {:>6} {:>7} {:>4}  outcome",
        "class", "gel", "case", "wall s", "steps", "newton", "max"
    )];
    lines.extend(outcome.measured.iter().map(row));
    if let Some([one, two]) = outcome.throughput {
        lines.push(format!(
            "independent grasps: {one:.2}/s on 1 thread, {two:.2}/s on 2, ratio {:.2}",
            two / one
        ));
    }
    lines.join("\n")
}
