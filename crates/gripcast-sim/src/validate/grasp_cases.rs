//! Cases of whole grasps: no penetration, bit-identical results, agreement between meshes.

use glam::DVec3;
use rayon::prelude::*;
use sha2::{Digest as _, Sha256};

use super::overlap::surfaces_intersect;
use super::random_grasp::{SHAPES, random_grasp};
use super::report::{Recorder, Tolerance};
use crate::fem::GelResolution;
use crate::grasp::{GraspOutcome, GraspResult, Protocol, simulate};
use crate::solver::SolverParameters;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::hex;
use gripcast_geometry::TriangleMesh;

/// Seed of the penetration cases.
const PENETRATION_SEED: u64 = 20_261_121;
/// Seed of the determinism and mesh cases.
const OUTCOME_SEED: u64 = 7;

/// Contact of a grasp.
struct Contact {
    /// Smallest distance of all steps, m.
    min_gap_m: f64,
    intersects: bool,
    steps: usize,
}

/// In random grasps gels and object never intersect: the smallest distance of every step is above
/// zero, and at the end of each stage no edge of one surface pierces the other.
pub(super) fn penetration(recorder: &mut Recorder, is_quick: bool) -> Result<()> {
    let count: u64 = if is_quick { 7 } else { 200 };
    let runs: Vec<Result<Contact>> = (0..count).into_par_iter().map(contact_of).collect();
    let (mut smallest, mut intersecting, mut started, mut steps) = (f64::INFINITY, 0, 0, 0);
    for run in runs {
        let run = run?;
        smallest = smallest.min(run.min_gap_m);
        intersecting += u32::from(run.intersects);
        started += u32::from(run.steps > 0);
        steps += run.steps;
    }
    let pair = (f64::MIN_POSITIVE, smallest);
    recorder.check("smallest distance", pair, "m", Tolerance::AtLeast);
    let pair = (0.0, f64::from(intersecting));
    recorder.absolute("grasps that pierce", pair, "", 0.0);
    let pair = (0.9 * count as f64, f64::from(started));
    recorder.check("grasps that started", pair, "", Tolerance::AtLeast);
    let pair = (steps as f64, steps as f64);
    recorder.check("steps", pair, "", Tolerance::Informational);
    Ok(())
}

fn contact_of(number: u64) -> Result<Contact> {
    let grasp = random_grasp(PENETRATION_SEED, number, GelResolution::Coarse)?;
    // Contact changes in the closure and at the start of adjustment and lift.
    let protocol = Protocol {
        adjust_s: 0.1,
        lift_m: 0.01,
        ..grasp.protocol
    };
    let result = simulate(&grasp.scene, &protocol, &SolverParameters::default())?;
    let gaps = result.trace.steps.iter().flat_map(|step| step.min_gap_m);
    let surface = grasp.scene.gel.grid.contact_surface();
    let intersects = result.trace.snapshots.iter().any(|snapshot| {
        let object = grasp.scene.mesh.transformed(&snapshot.t_world_object);
        snapshot.gels.iter().any(|gel| {
            let gel = TriangleMesh {
                vertices: gel.iter().map(|x| DVec3::from_array(*x)).collect(),
                triangles: surface.triangles().to_vec(),
            };
            surfaces_intersect(&gel, &object)
        })
    });
    Ok(Contact {
        min_gap_m: gaps.flatten().fold(f64::INFINITY, f64::min),
        intersects,
        steps: result.trace.steps.len(),
    })
}

/// SHA-256 over all forces, poses and snapshots of a grasp.
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
    hex(&hash.finalize())
}

/// The same grasp is bit-identical on one thread, on two threads, and repeated.
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
        let [one, two, repeated] = [run(1)?, run(2)?, run(2)?];
        recorder.require(format!("{}: 1 and 2 threads", grasp.name), one == two);
        recorder.require(format!("{}: two runs", grasp.name), two == repeated);
    }
    Ok(())
}

/// Outcome of a random grasp on each of the meshes.
fn outcomes(number: u64, meshes: &[GelResolution]) -> Result<Vec<GraspOutcome>> {
    let outcome = |&mesh: &GelResolution| {
        let grasp = random_grasp(OUTCOME_SEED, number, mesh)?;
        let parameters = SolverParameters::default();
        Ok(simulate(&grasp.scene, &grasp.protocol, &parameters)?.outcome)
    };
    meshes.iter().map(outcome).collect()
}

/// Outcomes on the default and the fine mesh agree in 95 % of random grasps.
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
    min_agreement: f64,
) -> Result<()> {
    let runs: Vec<Result<Vec<GraspOutcome>>> = (0..count)
        .into_par_iter()
        .map(|number| outcomes(number, meshes))
        .collect();
    let runs = runs.into_iter().collect::<Result<Vec<_>>>()?;
    let agree = |a: usize, b: usize| {
        let same = runs.iter().filter(|outcomes| outcomes[a] == outcomes[b]);
        same.count() as f64 / runs.len() as f64
    };
    if meshes.len() > 2 {
        let pair = (min_agreement, agree(0, 2));
        recorder.check("coarse and fine agree", pair, "", Tolerance::Informational);
    }
    let last = meshes.len() - 1;
    let pair = (min_agreement, agree(last - 1, last));
    recorder.check("the two finest agree", pair, "", Tolerance::AtLeast);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The full group takes minutes.
    #[test]
    fn mesh_agrees_with_itself() {
        let coarse = [GelResolution::Coarse; 3];
        let mut recorder = Recorder::new("mesh");
        agreement(&mut recorder, 1, &coarse, 1.0).unwrap();
        assert_eq!(recorder.cases.len(), 2);
        assert!(recorder.cases.iter().all(|case| case.passed));
    }
}
