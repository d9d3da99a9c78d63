//! `gripcast-bench rigid`: grasps of the rigid-body baseline, beside PyBullet's.
//!
//! ```text
//! gripcast-bench rigid --per-object 20 --peer pybullet --json
//! gripcast-bench rigid --objects builtin:mug,parts/b1.obj --unit mm --peer pybullet
//! ```
//!
//! Random grasps of each object, of which about four of ten fail: stable pose, turn, offsets, tilt,
//! friction and force from the seed. One thread; the time of a grasp is that after its convex
//! decomposition. `--peer pybullet` simulates the same pieces, poses and motors with PyPI's
//! pybullet through `python3` in the same run, with time steps four times as fine as ours:
//! at its usual 1/240 s it differs from its own finer run in one outcome of six (`--refine 1`).
//!
//! Exit codes: 0 measured · 2 usage · 4 the outcomes agree on less than 90 % of the grasps.

use std::sync::Arc;
use std::time::Instant;

use gripcast::cli::Context;
use gripcast::cli::bench::Report;
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::statistics::median;
use gripcast_geometry::{LengthUnit, TriangleMesh, load_object_mesh};
use gripcast_sim::Engine as _;
use gripcast_sim::grasp::{GraspOutcome, GraspResult};
use gripcast_sim::rigid::{RigidEngine, RigidSettings};
use serde::Serialize;
use serde_json::json;

use crate::peer::Peer;
use crate::rigid_grasps::{Agreement, PeerAnswer, PeerGrasp, compare, peer_cases, random_grasps};

/// Fraction of outcomes that have to agree.
const MIN_AGREEMENT: f64 = 0.9;
const PYBULLET: Peer = Peer {
    name: "pybullet",
    packages: "pybullet",
    script: include_str!("../peers/pybullet_grasp.py"),
};

/// Arguments.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Mesh files or builtin:NAME, separated by commas
    #[arg(long, value_name = "MESH", value_delimiter = ',', default_values = [
        "builtin:box", "builtin:cylinder", "builtin:mug", "builtin:wedge", "builtin:spike",
        "builtin:bottle",
    ])]
    objects: Vec<String>,
    /// Unit of the coordinates in mesh files: mm, cm, m, in
    #[arg(long, default_value_t = LengthUnit::Metre)]
    unit: LengthUnit,
    /// Factor on the size of mesh files
    #[arg(long, default_value_t = 1.0)]
    scale: f64,
    /// Grasps of each object
    #[arg(long, value_name = "N", default_value_t = 20)]
    per_object: usize,
    /// Seed of the grasps
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Simulate the grasps with PyPI's pybullet as well
    #[arg(long, value_parser = [PYBULLET.name])]
    peer: Option<String>,
    /// Time steps of the peer in one of ours
    #[arg(long, value_name = "N", default_value_t = 4,
        value_parser = clap::value_parser!(u32).range(1..=64))]
    refine: u32,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// Runs the bench.
pub(crate) fn run(context: &Context, args: &Args) -> Result<()> {
    let engine = RigidEngine::new(RigidSettings::default());
    let meshes = meshes(args)?;
    let began = Instant::now();
    for (_, mesh) in &meshes {
        engine.decomposition(mesh)?;
    }
    let decomposition_s = began.elapsed().as_secs_f64();
    let grasps = random_grasps(&engine, &meshes, args.per_object, args.seed)?;
    let (results, seconds) = simulated(&engine, &grasps)?;
    let peer = match args.peer {
        Some(_) => ask(context, &engine, &grasps, &results, args.refine)?,
        None => None,
    };
    let lifted = |r: &&GraspResult| r.outcome == GraspOutcome::Success;
    let figures = Figures {
        wall_s_median: median(seconds.iter().copied()).unwrap_or(f64::NAN),
        wall_s_max: seconds.iter().copied().fold(0.0, f64::max),
        decomposition_s,
        grasps: grasps.len(),
        lifted: results.iter().filter(lifted).count(),
        outcome_ok: peer.as_ref().and_then(|peer| peer.agreement.fraction()),
    };
    report(args, &figures, peer.as_ref()).print(args.json)?;
    match figures.outcome_ok {
        Some(fraction) if fraction < MIN_AGREEMENT => Err(Error::new(
            ErrorKind::Check,
            format!(
                "the outcomes agree on {:.1} % of the grasps only",
                1e2 * fraction
            ),
        )),
        _ => Ok(()),
    }
}

#[derive(Serialize)]
struct Figures {
    /// Of a grasp after its decomposition.
    wall_s_median: f64,
    wall_s_max: f64,
    /// Of all objects.
    decomposition_s: f64,
    grasps: usize,
    lifted: usize,
    /// Fraction of the outcomes that agree with the peer's.
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
        let object = load_object_mesh(name, args.unit, scale)?;
        Ok((name.clone(), Arc::new(object.mesh)))
    };
    args.objects.iter().map(load).collect()
}

/// Results and wall times, s.
fn simulated(engine: &RigidEngine, grasps: &[PeerGrasp]) -> Result<(Vec<GraspResult>, Vec<f64>)> {
    let mut results = Vec::new();
    let mut seconds = Vec::new();
    for grasp in grasps {
        let began = Instant::now();
        results.push(engine.simulate(&grasp.setup, grasp.friction, grasp.force_n)?);
        seconds.push(began.elapsed().as_secs_f64());
    }
    Ok((results, seconds))
}

/// What PyBullet made of the same grasps.
struct Theirs {
    version: String,
    wall_s_median: f64,
    agreement: Agreement,
}

fn ask(
    context: &Context,
    engine: &RigidEngine,
    grasps: &[PeerGrasp],
    results: &[GraspResult],
    refine: u32,
) -> Result<Option<Theirs>> {
    let cases = json!(peer_cases(engine, grasps, refine)?).to_string();
    let Some(answer) = PYBULLET.measure(context, 1, cases.as_bytes())? else {
        return Ok(None);
    };
    let answer: PeerAnswer = serde_json::from_value(answer)
        .map_err(|e| PYBULLET.failed("its answer lacks a figure").because(e))?;
    let seconds = answer.grasps.iter().map(|grasp| grasp.seconds);
    Ok(Some(Theirs {
        wall_s_median: median(seconds).unwrap_or(f64::NAN),
        agreement: compare(engine, grasps, results, &answer),
        version: answer.version,
    }))
}

fn report(args: &Args, figures: &Figures, peer: Option<&Theirs>) -> Report {
    let params = json!({
        "objects": args.objects,
        "per_object": args.per_object,
        "seed": args.seed,
        "refine": args.refine,
    });
    let mut report = Report::new("rigid", params, json!(figures), text(figures, peer));
    if let Some(peer) = peer {
        let peer = json!({
            "version": peer.version,
            "wall_s_median": peer.wall_s_median,
            "agreement": peer.agreement,
        });
        report.peers.insert("pybullet".to_owned(), peer);
    }
    report
}

fn text(figures: &Figures, peer: Option<&Theirs>) -> String {
    let mut lines = vec![format!(
        "{} grasps, {} lifted: {:.1} ms each, at most {:.1}; decompositions {:.1} s in all",
        figures.grasps,
        figures.lifted,
        1e3 * figures.wall_s_median,
        1e3 * figures.wall_s_max,
        figures.decomposition_s
    )];
    if let Some(peer) = peer {
        let agreement = &peer.agreement;
        lines.push(format!(
            "pybullet {}: {:.1} ms each, lifts {}; {} of {} outcomes agree",
            peer.version,
            1e3 * peer.wall_s_median,
            agreement.lifted_theirs,
            agreement.agreeing,
            agreement.compared
        ));
        for one in &agreement.disagreements {
            lines.push(format!(
                "  {}: {}, rose {:.1} mm; there {:.1} mm",
                one.name,
                one.outcome.name(),
                1e3 * one.lifted_m,
                1e3 * one.their_rise_m
            ));
        }
    }
    lines.join("\n")
}
