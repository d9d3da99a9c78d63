//! `gripcast-bench rigid`: grasps of the rigid engine, compared with PyBullet.
//!
//! ```text
//! gripcast-bench rigid --per-object 20 --baseline pybullet --json
//! gripcast-bench rigid --objects builtin:mug,parts/b1.obj --unit mm --baseline pybullet
//! ```
//!
//! Random grasps of each object, of which about 40 % fail: stable pose, yaw, offsets, roll, pitch,
//! friction and force are drawn from the seed. One thread; times exclude the convex decomposition.
//! `--baseline pybullet` simulates the same pieces, poses and motors with PyBullet at a quarter of
//! our time step: at its default 1/240 s, one outcome of six differs from its own finer run
//! (`--refine 1`).
//!
//! Exit codes: 0 measured · 2 usage · 4 the outcomes agree on less than 90 % of the grasps.

use std::sync::Arc;
use std::time::Instant;

use gripcast::cli::Context;
use gripcast::cli::bench::Report;
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::statistics::median;
use gripcast_geometry::{LengthUnit, MeshOptions, TriangleMesh, load_object_mesh};
use gripcast_sim::Engine as _;
use gripcast_sim::grasp::{GraspOutcome, GraspResult};
use gripcast_sim::rigid::{RigidEngine, RigidSettings};
use serde::Serialize;
use serde_json::json;

use crate::baseline::Baseline;
use crate::rigid_grasps::{
    Agreement, BaselineAnswer, BaselineGrasp, baseline_cases, compare, random_grasps,
};

/// Minimum fraction of agreeing outcomes.
const MIN_AGREEMENT: f64 = 0.9;
const PYBULLET: Baseline = Baseline {
    name: "pybullet",
    packages: "pybullet",
    script: include_str!("../peers/pybullet_grasp.py"),
};

/// Arguments.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Mesh files or builtin:NAME, comma-separated
    #[arg(long, value_name = "MESH", value_delimiter = ',', default_values = [
        "builtin:box", "builtin:cylinder", "builtin:mug", "builtin:wedge", "builtin:spike",
        "builtin:bottle",
    ])]
    objects: Vec<String>,
    /// Unit of the mesh coordinates: mm, cm, m, in
    #[arg(long, default_value_t = LengthUnit::Metre)]
    unit: LengthUnit,
    /// Scale factor of mesh files
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    scale: f64,
    /// Grasps per object
    #[arg(long, value_name = "N", default_value_t = 20)]
    per_object: usize,
    /// Random seed of the grasps
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    seed: u64,
    /// Baseline to compare against (PyPI)
    #[arg(long, value_parser = [PYBULLET.name])]
    baseline: Option<String>,
    /// Time steps of the baseline per step of ours
    #[arg(long, value_name = "N", default_value_t = 4,
        value_parser = clap::value_parser!(u32).range(1..=64))]
    refine: u32,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// Runs the benchmark.
pub(crate) fn run(context: &Context, args: &Args) -> Result<()> {
    let engine = RigidEngine::new(RigidSettings::default());
    let meshes = meshes(args)?;
    let start = Instant::now();
    for (_, mesh) in &meshes {
        engine.decomposition(mesh)?;
    }
    let decomposition_s = start.elapsed().as_secs_f64();
    let grasps = random_grasps(&engine, &meshes, args.per_object, args.seed)?;
    let (results, seconds) = simulate_all(&engine, &grasps)?;
    let baseline = match args.baseline {
        Some(_) => run_baseline(context, &engine, &grasps, &results, args.refine)?,
        None => None,
    };
    let lifted = |r: &&GraspResult| r.outcome == GraspOutcome::Success;
    let figures = Figures {
        wall_s_median: median(seconds.iter().copied()).unwrap_or(f64::NAN),
        wall_s_max: seconds.iter().copied().fold(0.0, f64::max),
        decomposition_s,
        grasps: grasps.len(),
        lifted: results.iter().filter(lifted).count(),
        outcome_ok: baseline
            .as_ref()
            .and_then(|baseline| baseline.agreement.fraction()),
    };
    report(args, &figures, baseline.as_ref()).print(args.json)?;
    match figures.outcome_ok {
        Some(fraction) if fraction < MIN_AGREEMENT => Err(Error::new(
            ErrorKind::Check,
            format!(
                "the outcomes agree on only {:.1} % of the grasps",
                1e2 * fraction
            ),
        )),
        _ => Ok(()),
    }
}

#[derive(Serialize)]
struct Figures {
    /// Time of a grasp without its decomposition.
    wall_s_median: f64,
    wall_s_max: f64,
    /// Time of all decompositions.
    decomposition_s: f64,
    grasps: usize,
    lifted: usize,
    /// Fraction of the outcomes that agree with the baseline.
    #[serde(skip_serializing_if = "Option::is_none")]
    outcome_ok: Option<f64>,
}

fn meshes(args: &Args) -> Result<Vec<(String, Arc<TriangleMesh>)>> {
    let load = |name: &String| {
        let scale = if name.starts_with("builtin:") {
            1.0
        } else {
            args.scale
        };
        let object = load_object_mesh(name, &MeshOptions::new(args.unit, scale))?;
        Ok((name.clone(), Arc::new(object.mesh)))
    };
    args.objects.iter().map(load).collect()
}

/// Results and wall times, s.
fn simulate_all(
    engine: &RigidEngine,
    grasps: &[BaselineGrasp],
) -> Result<(Vec<GraspResult>, Vec<f64>)> {
    let mut results = Vec::new();
    let mut seconds = Vec::new();
    for grasp in grasps {
        let start = Instant::now();
        results.push(engine.simulate(&grasp.setup, grasp.friction, grasp.force_n)?);
        seconds.push(start.elapsed().as_secs_f64());
    }
    Ok((results, seconds))
}

/// Results of PyBullet.
struct BaselineFigures {
    version: String,
    wall_s_median: f64,
    agreement: Agreement,
}

fn run_baseline(
    context: &Context,
    engine: &RigidEngine,
    grasps: &[BaselineGrasp],
    results: &[GraspResult],
    refine: u32,
) -> Result<Option<BaselineFigures>> {
    let cases = json!(baseline_cases(engine, grasps, refine)?).to_string();
    let Some(answer) = PYBULLET.measure(context, 1, cases.as_bytes())? else {
        return Ok(None);
    };
    let answer: BaselineAnswer = serde_json::from_value(answer)
        .map_err(|e| PYBULLET.failed("missing figure in its output").because(e))?;
    let seconds = answer.grasps.iter().map(|grasp| grasp.seconds);
    Ok(Some(BaselineFigures {
        wall_s_median: median(seconds).unwrap_or(f64::NAN),
        agreement: compare(engine, grasps, results, &answer),
        version: answer.version,
    }))
}

fn report(args: &Args, figures: &Figures, baseline: Option<&BaselineFigures>) -> Report {
    let params = json!({
        "objects": args.objects,
        "per_object": args.per_object,
        "seed": args.seed,
        "refine": args.refine,
    });
    let mut report = Report::new("rigid", params, json!(figures), text(figures, baseline));
    if let Some(baseline) = baseline {
        let baseline = json!({
            "version": baseline.version,
            "wall_s_median": baseline.wall_s_median,
            "agreement": baseline.agreement,
        });
        report.baselines.insert("pybullet".to_owned(), baseline);
    }
    report
}

fn text(figures: &Figures, baseline: Option<&BaselineFigures>) -> String {
    let mut lines = vec![format!(
        "{} grasps, {} lifted: {:.1} ms each, max {:.1} ms; decompositions {:.1} s in total",
        figures.grasps,
        figures.lifted,
        1e3 * figures.wall_s_median,
        1e3 * figures.wall_s_max,
        figures.decomposition_s
    )];
    if let Some(baseline) = baseline {
        let agreement = &baseline.agreement;
        lines.push(format!(
            "pybullet {}: {:.1} ms each, lifts {}; {} of {} outcomes agree",
            baseline.version,
            1e3 * baseline.wall_s_median,
            agreement.lifted_baseline,
            agreement.agreeing,
            agreement.compared
        ));
        for one in &agreement.disagreements {
            lines.push(format!(
                "  {}: {}, rise {:.1} mm; baseline {:.1} mm",
                one.name,
                one.outcome.name(),
                1e3 * one.lifted_m,
                1e3 * one.baseline_rise_m
            ));
        }
    }
    lines.join("\n")
}
