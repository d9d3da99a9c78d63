//! Rigid grasps for a baseline simulator, and the agreement of the outcomes.

use std::sync::Arc;

use gripcast_base::error::{Error, Result};
use gripcast_geometry::{MassProperties, Pose, TriangleMesh, stable_poses};
use gripcast_sim::GraspSetup;
use gripcast_sim::grasp::{GraspOutcome, GraspResult, Placement};
use gripcast_sim::rigid::{RigidEngine, RigidSettings};
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

/// Frictions and forces (N) to draw from: Taxim's sweep.
const FRICTIONS: [f64; 3] = [0.1, 0.25, 0.4];
const FORCES_N: [f64; 3] = [5.0, 10.0, 20.0];
/// Number of most probable stable poses to draw from.
const POSES: usize = 4;

/// A grasp with friction and force.
#[derive(Clone, Debug)]
pub(crate) struct BaselineGrasp {
    /// Unique name.
    pub(crate) name: String,
    /// Name of the object; the same for the same mesh and mass.
    pub(crate) object: String,
    /// Poses, mesh, mass.
    pub(crate) setup: GraspSetup,
    /// Coulomb friction coefficient.
    pub(crate) friction: f64,
    /// Grasping force, N.
    pub(crate) force_n: f64,
}

/// Input of the baseline.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct BaselineCases {
    /// Parameters without those of the contact solver.
    pub(crate) settings: RigidSettings,
    /// Time steps of the baseline per step of ours; a solver without substeps needs several for the
    /// same accuracy.
    pub(crate) refine: u32,
    /// Objects, each listed once.
    pub(crate) objects: Vec<BaselineObject>,
    /// Grasps.
    pub(crate) grasps: Vec<BaselineCase>,
}

/// An object of the cases.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct BaselineObject {
    /// Its name.
    pub(crate) name: String,
    /// Mass, kg.
    pub(crate) mass_kg: f64,
    /// Centre of mass in the mesh's frame, m.
    pub(crate) center_of_mass_m: [f64; 3],
    /// Inertia tensor about the centre of mass in the mesh's axes, kg m².
    pub(crate) inertia_kg_m2: [[f64; 3]; 3],
    /// Convex pieces.
    pub(crate) pieces: Vec<BaselinePiece>,
}

/// A convex piece in the mesh's frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct BaselinePiece {
    /// Corners, m.
    pub(crate) vertices_m: Vec<[f64; 3]>,
    /// Faces, counter-clockwise seen from outside.
    pub(crate) triangles: Vec<[u32; 3]>,
}

/// A grasp of the cases.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct BaselineCase {
    /// Its name.
    pub(crate) name: String,
    /// Index of its object.
    pub(crate) object: usize,
    /// The object on the ground.
    pub(crate) t_world_object: Pose,
    /// The gripper at the start.
    pub(crate) t_world_gripper: Pose,
    /// Distance between the fingers' faces at the start, m.
    pub(crate) opening_m: f64,
    /// Coulomb friction coefficient of every contact.
    pub(crate) friction: f64,
    /// Maximum motor force of each finger, N.
    pub(crate) force_n: f64,
}

/// Output of the baseline.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct BaselineAnswer {
    /// Its version.
    pub(crate) version: String,
    /// One for each grasp, in the order of the cases.
    pub(crate) grasps: Vec<BaselineResult>,
}

/// Result of a grasp in the baseline.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct BaselineResult {
    /// Name of the grasp.
    pub(crate) name: String,
    /// Whether a finger touched the object while closing.
    pub(crate) touched: bool,
    /// Rise of the centre of mass in the lift, m.
    pub(crate) rise_m: f64,
    /// Normal forces of the left and the right finger at the end of closing, N.
    pub(crate) force_n: [f64; 2],
    /// Wall time of its time steps, s.
    pub(crate) seconds: f64,
}

/// Agreement of two simulators on the outcomes.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Agreement {
    /// Grasps simulated by both.
    pub(crate) compared: usize,
    /// Lifted in both or in neither.
    pub(crate) agreeing: usize,
    /// Lifted by ours.
    pub(crate) lifted_ours: usize,
    /// Lifted by the baseline.
    pub(crate) lifted_baseline: usize,
    /// Grasps with different outcomes.
    pub(crate) disagreements: Vec<Disagreement>,
}

/// A grasp lifted by only one simulator.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Disagreement {
    /// Name of the grasp.
    pub(crate) name: String,
    /// Our outcome.
    pub(crate) outcome: GraspOutcome,
    /// Rise of the centre of mass in ours since before closing, m.
    pub(crate) lifted_m: f64,
    /// Rise of the centre of mass in the baseline during the lift, m.
    pub(crate) baseline_rise_m: f64,
}

impl Agreement {
    /// Returns the fraction of agreeing grasps; none without grasps.
    pub(crate) fn fraction(&self) -> Option<f64> {
        (self.compared > 0).then(|| self.agreeing as f64 / self.compared as f64)
    }
}

/// Draws random grasps of each mesh (m): stable pose, yaw, offsets, roll, pitch, height, friction
/// and force. About 40 % fail. Grasps that start in collision are redrawn.
pub(crate) fn random_grasps(
    engine: &RigidEngine,
    meshes: &[(String, Arc<TriangleMesh>)],
    per_mesh: usize,
    seed: u64,
) -> Result<Vec<BaselineGrasp>> {
    let mut grasps = Vec::new();
    for (index, (name, mesh)) in meshes.iter().enumerate() {
        let pieces = engine.decomposition(mesh)?;
        let poses: Vec<Pose> = stable_poses(mesh, 0.0)?
            .iter()
            .take(POSES)
            .map(|pose| pose.t_world_object)
            .collect();
        if poses.is_empty() {
            return Err(
                Error::input(format!("{name} has no stable pose")).remedy("use a closed mesh")
            );
        }
        let stream = seed ^ (index as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let mut rng = Pcg64Mcg::seed_from_u64(stream);
        let mut found = 0;
        // Bounded: a mesh may leave no room for the fingers.
        for _ in 0..100 * per_mesh {
            if found == per_mesh {
                break;
            }
            let mut grasp = draw(&mut rng, mesh, &poses)?;
            if engine.start_opening(&grasp.setup, &pieces).is_ok() {
                grasp.name = format!("{name} {found}");
                grasp.object.clone_from(name);
                grasps.push(grasp);
                found += 1;
            }
        }
    }
    Ok(grasps)
}

fn draw(rng: &mut Pcg64Mcg, mesh: &Arc<TriangleMesh>, poses: &[Pose]) -> Result<BaselineGrasp> {
    let t_world_object = poses[rng.random_range(0..poses.len())];
    let mut spread = |max: f64| rng.random_range(-max..max);
    let placement = Placement {
        yaw_rad: spread(std::f64::consts::PI),
        roll_rad: spread(0.2),
        pitch_rad: spread(0.3),
        offset_m: [spread(0.01), spread(0.02)],
        ..Placement::default()
    };
    let higher = spread(0.5).max(0.0);
    let mut placed = placement.place(mesh, &t_world_object)?;
    placed.t_world_gripper.translation_m.z *= 1.0 + higher;
    Ok(BaselineGrasp {
        name: String::new(),
        object: String::new(),
        setup: GraspSetup {
            mesh: mesh.clone(),
            mass_kg: 0.06,
            t_world_object,
            t_world_gripper: placed.t_world_gripper,
            opening_m: placed.opening_m.min(0.2),
        },
        friction: FRICTIONS[rng.random_range(0..FRICTIONS.len())],
        force_n: FORCES_N[rng.random_range(0..FORCES_N.len())],
    })
}

/// Returns the input of the baseline, with our convex pieces and `refine` of its time steps per
/// step of ours. Grasps that start in collision are omitted.
pub(crate) fn baseline_cases(
    engine: &RigidEngine,
    grasps: &[BaselineGrasp],
    refine: u32,
) -> Result<BaselineCases> {
    let mut cases = BaselineCases {
        settings: engine.settings,
        refine: refine.max(1),
        objects: Vec::new(),
        grasps: Vec::new(),
    };
    for grasp in grasps {
        let setup = &grasp.setup;
        let pieces = engine.decomposition(&setup.mesh)?;
        let Ok(opening_m) = engine.start_opening(setup, &pieces) else {
            continue;
        };
        let index = cases.objects.iter().position(|o| o.name == grasp.object);
        let object = match index {
            Some(index) => index,
            None => {
                cases.objects.push(object(grasp, pieces.pieces())?);
                cases.objects.len() - 1
            }
        };
        cases.grasps.push(BaselineCase {
            name: grasp.name.clone(),
            object,
            t_world_object: setup.t_world_object,
            t_world_gripper: setup.t_world_gripper,
            opening_m,
            friction: grasp.friction,
            force_n: grasp.force_n,
        });
    }
    Ok(cases)
}

/// Compares our results, in the order of `grasps`, with the output of the baseline.
pub(crate) fn compare(
    engine: &RigidEngine,
    grasps: &[BaselineGrasp],
    results: &[GraspResult],
    answer: &BaselineAnswer,
) -> Agreement {
    let enough = engine.settings.success_rise_m();
    let mut agreement = Agreement::default();
    for (grasp, ours) in grasps.iter().zip(results) {
        let Some(theirs) = answer.grasps.iter().find(|g| g.name == grasp.name) else {
            continue;
        };
        let lifted = ours.outcome == GraspOutcome::Success;
        let lifted_in_baseline = theirs.touched && theirs.rise_m >= enough;
        agreement.compared += 1;
        agreement.lifted_ours += usize::from(lifted);
        agreement.lifted_baseline += usize::from(lifted_in_baseline);
        if lifted == lifted_in_baseline {
            agreement.agreeing += 1;
        } else {
            agreement.disagreements.push(Disagreement {
                name: grasp.name.clone(),
                outcome: ours.outcome,
                lifted_m: ours.lifted_m,
                baseline_rise_m: theirs.rise_m,
            });
        }
    }
    agreement
}

fn object(grasp: &BaselineGrasp, pieces: &[TriangleMesh]) -> Result<BaselineObject> {
    let properties = MassProperties::from_mesh(&grasp.setup.mesh)?;
    let mass_kg = grasp.setup.mass_kg;
    let piece = |mesh: &TriangleMesh| BaselinePiece {
        vertices_m: mesh.vertices.iter().map(|v| v.to_array()).collect(),
        triangles: mesh.triangles.clone(),
    };
    Ok(BaselineObject {
        name: grasp.object.clone(),
        mass_kg,
        center_of_mass_m: properties.center_of_mass_m.to_array(),
        // Symmetric, so columns are rows.
        inertia_kg_m2: (properties.inertia_m5() * (mass_kg / properties.volume_m3))
            .to_cols_array_2d(),
        pieces: pieces.iter().map(piece).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_geometry::builtin;
    use gripcast_sim::Engine as _;

    fn grasps(engine: &RigidEngine) -> Vec<BaselineGrasp> {
        let mesh = |name: &str| (name.to_owned(), Arc::new(builtin(name).unwrap()));
        random_grasps(engine, &[mesh("box"), mesh("spike")], 3, 7).unwrap()
    }

    #[test]
    fn cases_list_objects_once_and_are_deterministic() {
        let engine = RigidEngine::default();
        let cases = baseline_cases(&engine, &grasps(&engine), 4).unwrap();
        assert_eq!(cases.objects.len(), 2);
        let objects: Vec<usize> = cases.grasps.iter().map(|g| g.object).collect();
        assert_eq!(objects, [0, 0, 0, 1, 1, 1]);
        let found = &cases.objects[0];
        let expected = 0.06 / 12.0 * (0.04 * 0.04 + 0.06 * 0.06);
        assert!((found.inertia_kg_m2[0][0] - expected).abs() < 1e-9 * expected);
        assert_eq!(cases, baseline_cases(&engine, &grasps(&engine), 4).unwrap());
        let text = serde_json::to_string(&cases).unwrap();
        assert_eq!(serde_json::from_str::<BaselineCases>(&text).unwrap(), cases);
    }

    #[test]
    fn compare_counts_common_grasps() {
        let engine = RigidEngine::default();
        let grasps = grasps(&engine);
        let results: Vec<GraspResult> = grasps
            .iter()
            .map(|g| engine.simulate(&g.setup, g.friction, g.force_n).unwrap())
            .collect();
        let lifted = results
            .iter()
            .filter(|r| r.outcome == GraspOutcome::Success);
        let lifted = lifted.count();
        let theirs = |grasp: &BaselineGrasp| BaselineResult {
            name: grasp.name.clone(),
            touched: true,
            rise_m: 0.2,
            force_n: [1.0, 1.0],
            seconds: 0.01,
        };
        let answer = BaselineAnswer {
            version: "1".to_owned(),
            grasps: grasps.iter().skip(1).map(theirs).collect(),
        };
        let found = compare(&engine, &grasps[1..], &results[1..], &answer);
        assert_eq!((found.compared, found.lifted_baseline), (5, 5));
        assert_eq!(found.agreeing, found.lifted_ours);
        assert_eq!(found.disagreements.len(), 5 - found.lifted_ours);
        assert!(lifted >= found.lifted_ours);
        assert_eq!(Agreement::default().fraction(), None);
    }
}
