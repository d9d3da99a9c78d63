//! `gripcast-bench contact`: contact phases of a Newton iteration.
//!
//! ```text
//! gripcast-bench contact --gel coarse,fine --faces 1280,5120 --baseline ipctk --json
//! ```
//!
//! Two gels are pressed 1.5 mm on an icosphere of radius 20 mm and move by 0.2 mm over it; d̂ is
//! 0.5 mm. Minimum and median wall time of each phase for both gels, on one thread. `--baseline
//! ipctk` runs ipctk on the same surfaces on one thread and takes its CPU time, which other load on
//! the machine does not affect.
//!
//! Compared per iteration (`ours_ms`, `ipctk_ms`: the sums of the minimum times of the phases):
//!
//! | ours | ipctk |
//! | --- | --- |
//! | find active contacts | `NormalCollisions.build` with its own broad phase |
//! | build candidates, half of it | `Candidates.build` over the motion |
//! | collision-free step size | `compute_collision_free_stepsize` |
//! | energy, gradient | the same of `BarrierPotential` |
//! | positive semidefinite stiffness | `hessian` with CLAMP |
//!
//! Ours keeps candidates until a node has moved 0.4 mm, so half a broad phase falls on one
//! iteration of this motion; `ours_rebuild_ms` counts a complete one. ipctk can keep candidates as
//! well: `ipctk_kept_ms` reuses them and counts half of their build. Ours has an affine object (12
//! unknowns) and keeps the normal part of the contact stiffness; ipctk gives every vertex of the
//! object its own unknowns and projects each local 12 x 12 block. Pairs, minimum distance, energy
//! and gradient must agree.
//!
//! Exit codes: 0 measured · 2 usage · 4 ipctk found other contacts.

use gripcast::cli::Context;
use gripcast::cli::bench::Report;
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_sim::fem::GelResolution;
use serde::Serialize;
use serde_json::{Map, Value, json};

use crate::baseline::Baseline;
use crate::contact_scene::{ContactPhases, ContactScene, ContactState};

/// Minimum for a usable minimum time.
const MIN_RUNS: u64 = 20;
/// Relative tolerance of energy and gradient (rounding).
const AGREEMENT: f64 = 1e-9;
const IPCTK: Baseline = Baseline {
    name: "ipctk",
    packages: "ipctk==1.6.1 numpy",
    script: include_str!("../peers/ipctk_contact.py"),
};

/// Arguments.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Gel meshes, comma-separated
    #[arg(long, value_parser = GelResolution::from_name, value_delimiter = ',', default_value = "coarse")]
    gel: Vec<GelResolution>,
    /// Faces of the sphere, comma-separated
    #[arg(long, value_parser = ["1280", "5120", "20480"], value_delimiter = ',',
        default_value = "1280,5120,20480")]
    faces: Vec<String>,
    /// Number of measurements per phase
    #[arg(long, value_name = "N", default_value_t = 50, value_parser = clap::value_parser!(u64).range(MIN_RUNS..))]
    runs: u64,
    /// Baseline to compare against (PyPI)
    #[arg(long, value_parser = [IPCTK.name])]
    baseline: Option<String>,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// Returns the number of subdivisions of an icosahedron.
fn cuts(faces: &str) -> u32 {
    match faces {
        "1280" => 3,
        "5120" => 4,
        _ => 5,
    }
}

/// Result of a gel mesh and a sphere.
#[derive(Serialize)]
struct Measured {
    gel: &'static str,
    faces: usize,
    phases: ContactPhases,
    state: ContactState,
    #[serde(skip_serializing_if = "Option::is_none")]
    ipctk: Option<BaselineFigures>,
}

/// Result of ipctk.
#[derive(Serialize)]
struct BaselineFigures {
    /// One iteration, ms.
    iteration_ms: f64,
    /// One iteration with kept candidates, ms.
    kept_ms: f64,
    agrees: bool,
    report: Value,
}

impl BaselineFigures {
    fn new(report: Value, phases: &ContactPhases, ours: &ContactState) -> Result<Self> {
        let missing = || IPCTK.failed("missing figure in its output");
        let number = |path: &str| report.pointer(path).and_then(Value::as_f64);
        let ms = |phase: &str| number(&format!("/phases/{phase}/min")).ok_or_else(missing);
        let common = ms("ccd")? + ms("energy")? + ms("gradient")? + ms("hessian")?;
        let state = |key: &str| number(&format!("/state/{key}")).ok_or_else(missing);
        let near = |a: f64, b: f64| (a - b).abs() <= AGREEMENT * b.abs();
        let agrees = state("vertex_triangle_pairs")? == ours.vertex_triangle_pairs as f64
            && state("edge_edge_pairs")? == ours.edge_edge_pairs as f64
            && near(state("min_distance_m")?, ours.min_distance_m)
            && near(state("energy_j")?, ours.energy_j)
            && near(state("gradient_n")?, ours.gradient_n);
        Ok(Self {
            iteration_ms: common + ms("build")? + ms("candidates")?,
            kept_ms: common + ms("build_kept")? + phases.rebuilds_per_iteration * ms("gather")?,
            agrees,
            report,
        })
    }
}

/// Runs the benchmark.
pub(crate) fn run(context: &Context, args: &Args) -> Result<()> {
    let mut measured = Vec::new();
    let mut version = None;
    let mut has_baseline = args.baseline.is_some();
    for &gel in &args.gel {
        for faces in &args.faces {
            let mut scene = ContactScene::new(gel, cuts(faces))?;
            let phases = scene.measure(args.runs as usize);
            let state = scene.state();
            let mut ipctk = None;
            if has_baseline {
                let mesh = json!(scene.mesh()).to_string();
                let answer = IPCTK.measure(context, args.runs, mesh.as_bytes())?;
                has_baseline = answer.is_some();
                if let Some(report) = answer {
                    version = Some(report["version"].clone());
                    ipctk = Some(BaselineFigures::new(report, &phases, &state)?);
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
        let rebuild = m.phases.rebuild_iteration_ms();
        figures.insert(key("ours_rebuild_ms"), json!(rebuild));
        if let Some(theirs) = &m.ipctk {
            figures.insert(key("ipctk_ms"), json!(theirs.iteration_ms));
            figures.insert(key("ipctk_kept_ms"), json!(theirs.kept_ms));
            figures.insert(key("ratio"), json!(theirs.iteration_ms / ours));
            figures.insert(key("ratio_rebuild"), json!(theirs.iteration_ms / rebuild));
            figures.insert(key("ratio_kept"), json!(theirs.kept_ms / ours));
        }
    }
    let params = json!({"runs": args.runs, "threads": 1});
    let mut report = Report::new("contact", params, figures.into(), table(measured));
    report.more.insert("meshes".to_owned(), json!(measured));
    if let Some(version) = version {
        let baseline = json!({"version": version});
        report.baselines.insert("ipctk".to_owned(), baseline);
    }
    report
}

fn table(measured: &[Measured]) -> String {
    let mut lines = vec![
        "minimum, ms             find  energy gradient hessian    ccd   build |   ours   ipctk ratio"
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
            p.build.min,
            p.iteration_ms(),
        );
        if let Some(theirs) = &m.ipctk {
            let ratio = theirs.iteration_ms / p.iteration_ms();
            line += &format!(" {:>7.2} {ratio:>5.1}", theirs.iteration_ms);
        }
        lines.push(line);
    }
    lines.push("ours: half a candidate build and one of each other phase".to_owned());
    lines.join("\n")
}
