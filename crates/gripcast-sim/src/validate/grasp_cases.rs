//! Cases of whole grasps: no penetration, the same bits on every run, the same outcome on every
//! mesh.

use glam::DVec3;
use rayon::prelude::*;
use sha2::{Digest as _, Sha256};

use super::overlap::surfaces_meet;
use super::random_grasp::{RandomGrasp, SHAPES, random_grasp};
use super::report::{Recorder, Tolerance};
use crate::fem::GelResolution;
use crate::grasp::{GraspOutcome, GraspResult, Protocol, simulate};
use crate::solver::SolverParameters;
use gripcast_base::error::{Error, Result};
use gripcast_geometry::TriangleMesh;

/// Seed of the grasps that must not penetrate.
const PENETRATION_SEED: u64 = 20_261_121;
/// Seed of the grasps whose outcomes are compared.
const OUTCOME_SEED: u64 = 7;

/// What a grasp did to its surfaces.
struct Contact {
    /// Smallest distance of all steps, m.
    min_gap_m: f64,
    meets: bool,
    steps: usize,
}

/// In random grasps gels and object never meet: the smallest distance of every step is above
/// zero, and at the end of each stage no edge of one surface pierces the other.
pub(super) fn penetration(recorder: &mut Recorder, count: u64) -> Result<()> {
    let runs: Vec<Result<Contact>> = (0..count).into_par_iter().map(one_contact).collect();
    let (mut smallest, mut meets, mut started, mut steps) = (f64::INFINITY, 0, 0, 0);
    for run in runs {
        let run = run?;
        smallest = smallest.min(run.min_gap_m);
        meets += u32::from(run.meets);
        started += u32::from(run.steps > 0);
        steps += run.steps;
    }
    let pair = (f64::MIN_POSITIVE, smallest);
    recorder.check("smallest distance", pair, "m", Tolerance::AtLeast);
    let pair = (0.0, f64::from(meets));
    recorder.absolute("grasps that pierce", pair, "", 0.0);
    let pair = (0.9 * count as f64, f64::from(started));
    recorder.check("grasps that started", pair, "", Tolerance::AtLeast);
    let pair = (steps as f64, steps as f64);
    recorder.check("steps", pair, "", Tolerance::Stated);
    Ok(())
}

fn one_contact(number: u64) -> Result<Contact> {
    let grasp = random_grasp(PENETRATION_SEED, number, GelResolution::Coarse)?;
    // Closing and the first of adjustment and lift are where contact changes.
    let protocol = Protocol {
        adjust_s: 0.1,
        lift_m: 0.01,
        ..grasp.protocol
    };
    let result = simulate(&grasp.scene, &protocol, &SolverParameters::default())?;
    let gaps = result.trace.steps.iter().flat_map(|step| step.min_gap_m);
    let surface = grasp.scene.gel.grid.contact_surface();
    let meets = result.trace.snapshots.iter().any(|snapshot| {
        let object = grasp.scene.mesh.transformed(&snapshot.t_world_object);
        snapshot.gels.iter().any(|gel| {
            let gel = TriangleMesh {
                vertices: gel.iter().map(|x| DVec3::from_array(*x)).collect(),
                triangles: surface.triangles().to_vec(),
            };
            surfaces_meet(&gel, &object)
        })
    });
    Ok(Contact {
        min_gap_m: gaps.flatten().fold(f64::INFINITY, f64::min),
        meets,
        steps: result.trace.steps.len(),
    })
}

/// SHA-256 over the bits of every force, pose and snapshot of a grasp.
fn state_hash(result: &GraspResult) -> String {
    let mut hash = Sha256::new();
    let mut add = |values: &[f64]| {
        for value in values {
            hash.update(value.to_bits().to_le_bytes());
        }
    };
    for step in &result.trace.steps {
        for force in &step.force {
            add(&[force.normal_n, force.torque_n_m]);
            add(&force.shear_n);
        }
        add(&step.t_world_object.translation_m.to_array());
    }
    for snapshot in &result.trace.snapshots {
        for gel in &snapshot.gels {
            gel.iter().for_each(|x| add(x));
        }
    }
    hash.finalize().iter().map(|b| format!("{b:02x}")).collect()
}

/// The same grasp gives the same bits on one thread, on two, and again.
pub(super) fn determinism(recorder: &mut Recorder, is_quick: bool) -> Result<()> {
    let numbers: &[u64] = if is_quick { &[1] } else { &[1, 3, 4] };
    for &number in numbers {
        let grasp = random_grasp(OUTCOME_SEED, number, GelResolution::Coarse)?;
        let protocol = Protocol {
            adjust_s: 0.1,
            lift_m: 0.01,
            ..grasp.protocol
        };
        let run = |threads: usize| -> Result<String> {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            let pool = pool.map_err(|e| Error::internal("cannot start threads").because(e))?;
            let parameters = SolverParameters::default();
            let result = pool.install(|| simulate(&grasp.scene, &protocol, &parameters))?;
            Ok(state_hash(&result))
        };
        let [one, two, again] = [run(1)?, run(2)?, run(2)?];
        recorder.hold(format!("{}: 1 and 2 threads", grasp.name), one == two);
        recorder.hold(format!("{}: two runs", grasp.name), two == again);
    }
    Ok(())
}

/// One grasp on several meshes.
#[derive(Clone, Debug, serde::Serialize)]
pub struct MeshOutcomes {
    /// What it was.
    pub name: String,
    /// Outcome on the coarse, the default and the fine mesh.
    pub outcomes: Vec<GraspOutcome>,
    /// Mean force of the last 20 steps of the adjustment on each, N.
    pub force_n: Vec<f64>,
    /// Rise of the object on each, m.
    pub lifted_m: Vec<f64>,
    /// Steps on each that did not converge.
    pub unconverged: Vec<usize>,
}

/// Runs random grasps, hard ones among them, on each of the meshes, one grasp a thread.
///
/// # Errors
/// None for the built-in objects.
pub fn mesh_outcomes(count: u64, meshes: &[GelResolution]) -> Result<Vec<MeshOutcomes>> {
    let runs: Vec<Result<MeshOutcomes>> = (0..count)
        .into_par_iter()
        .map(|number| on_meshes(number, meshes))
        .collect();
    runs.into_iter().collect()
}

fn on_meshes(number: u64, meshes: &[GelResolution]) -> Result<MeshOutcomes> {
    let mut found = MeshOutcomes {
        name: String::new(),
        outcomes: Vec::new(),
        force_n: Vec::new(),
        lifted_m: Vec::new(),
        unconverged: Vec::new(),
    };
    for &mesh in meshes {
        let RandomGrasp {
            name,
            scene,
            protocol,
        } = random_grasp(OUTCOME_SEED, number, mesh)?;
        let result = simulate(&scene, &protocol, &SolverParameters::default())?;
        let force = result
            .trace
            .mean_force(crate::grasp::StageName::Adjustment, 20);
        found.name = name;
        found.outcomes.push(result.outcome);
        found.force_n.push(force.unwrap_or(0.0));
        found.lifted_m.push(result.lifted_m);
        found.unconverged.push(result.unconverged_steps);
    }
    Ok(found)
}

/// Outcomes on the default mesh are those on the fine one in 95 % of the grasps.
pub(super) fn mesh_agreement(recorder: &mut Recorder, is_quick: bool) -> Result<()> {
    use GelResolution::{Coarse, Default, Fine};
    if is_quick {
        agreement(recorder, SHAPES.len() as u64, &[Coarse, Default], 0.5)
    } else {
        agreement(recorder, 42, &[Coarse, Default, Fine], 0.95)
    }
}

fn agreement(
    recorder: &mut Recorder,
    count: u64,
    meshes: &[GelResolution],
    least: f64,
) -> Result<()> {
    let runs = mesh_outcomes(count, meshes)?;
    let agree = |a: usize, b: usize| {
        let same = runs.iter().filter(|run| run.outcomes[a] == run.outcomes[b]);
        same.count() as f64 / runs.len() as f64
    };
    if meshes.len() > 2 {
        let pair = (least, agree(0, 2));
        recorder.check("coarse and fine agree", pair, "", Tolerance::Stated);
    }
    let last = meshes.len() - 1;
    let pair = (least, agree(last - 1, last));
    recorder.check("the two finest agree", pair, "", Tolerance::AtLeast);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The group itself runs for minutes.
    #[test]
    fn a_mesh_agrees_with_itself_and_others_are_counted() {
        let coarse = [GelResolution::Coarse; 3];
        let mut recorder = Recorder::new("mesh");
        agreement(&mut recorder, 1, &coarse, 1.0).unwrap();
        assert_eq!(recorder.cases.len(), 2);
        assert!(recorder.cases.iter().all(|case| case.passed));
    }
}
