//! `gripcast-bench contact`: the contact phases of one Newton iteration.
//!
//! ```text
//! gripcast-bench contact --gel coarse,fine --faces 1280,5120 --peer ipctk --json
//! ```
//!
//! Two gels are pressed 1.5 mm on an icosphere of radius 20 mm and are about to move by 0.2 mm
//! over it; contact begins at 0.5 mm. One thread, shortest and median wall time of each phase for
//! both gels. `--peer ipctk` runs PyPI's ipctk in `python3` on the same surfaces in the same run,
//! on one thread; of it the CPU time is taken, so that other work on the machine, which only a
//! short phase escapes, does not count against it.
//!
//! What is compared, per iteration (`ours_ms`, `ipctk_ms`; the sum of the shortest times of the
//! phases, because a busy machine only ever adds to them):
//!
//! | ours | ipctk |
//! | --- | --- |
//! | find active contacts | `NormalCollisions.build` with its own broad phase |
//! | gather candidates, half of it | `Candidates.build` over the motion |
//! | largest free fraction of the step | `compute_collision_free_stepsize` |
//! | energy, gradient | the same of `BarrierPotential` |
//! | positive semidefinite stiffness | `hessian` with CLAMP |
//!
//! Ours keeps its candidates until a node has moved 0.4 mm, so half of a gathering falls on one
//! iteration of this motion; `ours_gathering_ms` counts a whole one. ipctk can keep candidates as
//! well: `ipctk_kept_ms` takes its collisions from kept ones and counts half of their gathering.
//! Ours takes the object as rigid (12 unknowns) and keeps of a contact's stiffness the part along
//! its normal; ipctk gives every vertex of the object its own unknowns and projects each local
//! 12 x 12 block. `agreement` holds what both found: pairs, smallest distance, energy, gradient.
//!
//! Exit codes: 0 measured · 2 usage · 4 ipctk found other contacts.

use gripcast::cli::Context;
use gripcast::cli::bench::Report;
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_sim::fem::GelResolution;
use serde::Serialize;
use serde_json::{Map, Value, json};

use crate::contact_scene::{ContactPhases, ContactScene, ContactState};
use crate::peer::Peer;

/// Runs below this give no usable minimum.
const MIN_RUNS: u64 = 20;
/// Relative difference of energy and gradient that rounding explains.
const AGREEMENT: f64 = 1e-9;
const IPCTK: Peer = Peer {
    name: "ipctk",
    packages: "ipctk==1.6.1 numpy",
    script: include_str!("../peers/ipctk_contact.py"),
};

/// Arguments.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Gel meshes, separated by commas
    #[arg(long, value_parser = GelResolution::from_name, value_delimiter = ',', default_value = "coarse")]
    gel: Vec<GelResolution>,
    /// Faces of the sphere, separated by commas
    #[arg(long, value_parser = ["1280", "5120", "20480"], value_delimiter = ',',
        default_value = "1280,5120,20480")]
    faces: Vec<String>,
    /// Measurements of each phase
    #[arg(long, default_value_t = 50, value_parser = clap::value_parser!(u64).range(MIN_RUNS..))]
    runs: u64,
    /// Measure PyPI's ipctk as well
    #[arg(long, value_parser = [IPCTK.name])]
    peer: Option<String>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// How often an icosahedron's faces are cut in four.
fn cuts(faces: &str) -> u32 {
    match faces {
        "1280" => 3,
        "5120" => 4,
        _ => 5,
    }
}

/// One gel mesh on one sphere.
#[derive(Serialize)]
struct Measured {
    gel: &'static str,
    faces: usize,
    phases: ContactPhases,
    state: ContactState,
    #[serde(skip_serializing_if = "Option::is_none")]
    ipctk: Option<Theirs>,
}

/// What ipctk's script answered.
#[derive(Serialize)]
struct Theirs {
    /// All of its iteration, ms.
    iteration_ms: f64,
    /// The same with kept candidates, ms.
    kept_ms: f64,
    agrees: bool,
    report: Value,
}

impl Theirs {
    fn new(report: Value, phases: &ContactPhases, ours: &ContactState) -> Result<Self> {
        let lacking = || IPCTK.failed("its answer lacks a figure");
        let number = |path: &str| report.pointer(path).and_then(Value::as_f64);
        let ms = |phase: &str| number(&format!("/phases/{phase}/min")).ok_or_else(lacking);
        let common = ms("ccd")? + ms("energy")? + ms("gradient")? + ms("hessian")?;
        let state = |key: &str| number(&format!("/state/{key}")).ok_or_else(lacking);
        let near = |a: f64, b: f64| (a - b).abs() <= AGREEMENT * b.abs();
        let agrees = state("vertex_triangle_pairs")? == ours.vertex_triangle_pairs as f64
            && state("edge_edge_pairs")? == ours.edge_edge_pairs as f64
            && near(state("min_distance_m")?, ours.min_distance_m)
            && near(state("energy_j")?, ours.energy_j)
            && near(state("gradient_n")?, ours.gradient_n);
        Ok(Self {
            iteration_ms: common + ms("build")? + ms("candidates")?,
            kept_ms: common + ms("build_kept")? + phases.gathers_per_iteration * ms("gather")?,
            agrees,
            report,
        })
    }
}

/// Runs the bench.
pub(crate) fn run(context: &Context, args: &Args) -> Result<()> {
    let mut measured = Vec::new();
    let mut version = None;
    let mut has_peer = args.peer.is_some();
    for &gel in &args.gel {
        for faces in &args.faces {
            let mut scene = ContactScene::new(gel, cuts(faces))?;
            let phases = scene.measure(args.runs as usize);
            let state = scene.state();
            let mut ipctk = None;
            if has_peer {
                let mesh = json!(scene.mesh()).to_string();
                let answer = IPCTK.measure(context, args.runs, mesh.as_bytes())?;
                has_peer = answer.is_some();
                if let Some(report) = answer {
                    version = Some(report["version"].clone());
                    ipctk = Some(Theirs::new(report, &phases, &state)?);
                }
            }
            measured.push(Measured {
                gel: gel.name(),
                faces: scene.faces(),
                phases,
                state,
                ipctk,
            });
        }
    }
    report(args, &measured, version).print(args.json)?;
    let differ = |m: &&Measured| m.ipctk.as_ref().is_some_and(|theirs| !theirs.agrees);
    match measured.iter().find(differ) {
        Some(m) => Err(Error::new(
            ErrorKind::Check,
            format!(
                "ipctk finds other contacts at {} / {} faces",
                m.gel, m.faces
            ),
        )),
        None => Ok(()),
    }
}

fn report(args: &Args, measured: &[Measured], version: Option<Value>) -> Report {
    let mut figures = Map::new();
    for m in measured {
        let key = |name: &str| format!("{}_{}_{name}", m.gel, m.faces);
        let ours = m.phases.iteration_ms();
        figures.insert(key("ours_ms"), json!(ours));
        let gathering = m.phases.gathering_iteration_ms();
        figures.insert(key("ours_gathering_ms"), json!(gathering));
        if let Some(theirs) = &m.ipctk {
            figures.insert(key("ipctk_ms"), json!(theirs.iteration_ms));
            figures.insert(key("ipctk_kept_ms"), json!(theirs.kept_ms));
            figures.insert(key("ratio"), json!(theirs.iteration_ms / ours));
            figures.insert(
                key("ratio_gathering"),
                json!(theirs.iteration_ms / gathering),
            );
            figures.insert(key("ratio_kept"), json!(theirs.kept_ms / ours));
        }
    }
    let params = json!({"runs": args.runs, "threads": 1});
    let mut report = Report::new("contact", params, figures.into(), table(measured));
    report.more.insert("meshes".to_owned(), json!(measured));
    if let Some(version) = version {
        let peer = json!({"version": version});
        report.peers.insert("ipctk".to_owned(), peer);
    }
    report
}

fn table(measured: &[Measured]) -> String {
    let mut lines = vec![
        "shortest, ms            find  energy gradient hessian    ccd  gather |   ours   ipctk ratio"
            .to_owned(),
    ];
    for m in measured {
        let p = &m.phases;
        let mut line = format!(
            "{:<8} {:>6} faces {:>7.3} {:>7.3} {:>8.3} {:>7.3} {:>6.3} {:>7.3} | {:>6.2}",
            m.gel,
            m.faces,
            p.find.min,
            p.energy.min,
            p.gradient.min,
            p.hessian.min,
            p.ccd.min,
            p.gather.min,
            p.iteration_ms(),
        );
        if let Some(theirs) = &m.ipctk {
            let ratio = theirs.iteration_ms / p.iteration_ms();
            line += &format!(" {:>7.2} {ratio:>5.1}", theirs.iteration_ms);
        }
        lines.push(line);
    }
    lines.push("ours: half a gathering and one of each other phase".to_owned());
    lines.join("\n")
}
