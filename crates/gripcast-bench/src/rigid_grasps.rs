//! The same rigid grasps for another simulator, and how far it agrees.

use std::sync::Arc;

use gripcast_base::error::{Error, Result};
use gripcast_geometry::{MassProperties, Pose, TriangleMesh, stable_poses};
use gripcast_sim::GraspSetup;
use gripcast_sim::grasp::{GraspOutcome, GraspResult, Placement};
use gripcast_sim::rigid::{RigidEngine, RigidSettings};
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

/// Frictions and forces (N) that the grasps are drawn from: Taxim's sweep.
const FRICTIONS: [f64; 3] = [0.1, 0.25, 0.4];
const FORCES_N: [f64; 3] = [5.0, 10.0, 20.0];
/// Stable poses are drawn from the most probable few.
const POSES: usize = 4;

/// A grasp with its unknowns chosen.
#[derive(Clone, Debug)]
pub(crate) struct PeerGrasp {
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

/// What the other simulator reads.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct PeerCases {
    /// Parameters of the set-up, those of the contact solver aside.
    pub(crate) settings: RigidSettings,
    /// Time steps of the other simulator in one of ours: what a solver without substeps needs to
    /// be as exact.
    pub(crate) refine: u32,
    /// Objects, each named once.
    pub(crate) objects: Vec<PeerObject>,
    /// Grasps.
    pub(crate) grasps: Vec<PeerCase>,
}

/// An object of the cases.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct PeerObject {
    /// Its name.
    pub(crate) name: String,
    /// Mass, kg.
    pub(crate) mass_kg: f64,
    /// Centre of mass in the mesh's frame, m.
    pub(crate) center_of_mass_m: [f64; 3],
    /// Inertia tensor about the centre of mass in the mesh's axes, kg m².
    pub(crate) inertia_kg_m2: [[f64; 3]; 3],
    /// Convex pieces.
    pub(crate) pieces: Vec<PeerPiece>,
}

/// A convex piece in the mesh's frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct PeerPiece {
    /// Corners, m.
    pub(crate) vertices_m: Vec<[f64; 3]>,
    /// Faces, counter-clockwise seen from outside.
    pub(crate) triangles: Vec<[u32; 3]>,
}

/// A grasp of the cases.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct PeerCase {
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
    /// Most force of each finger's motor, N.
    pub(crate) force_n: f64,
}

/// What the other simulator answers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct PeerAnswer {
    /// Its version.
    pub(crate) version: String,
    /// One for each grasp, in the order of the cases.
    pub(crate) grasps: Vec<PeerResult>,
}

/// A grasp in the other simulator.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct PeerResult {
    /// Name of the grasp.
    pub(crate) name: String,
    /// Whether a finger felt the object while closing.
    pub(crate) touched: bool,
    /// Rise of the centre of mass in the lift, m.
    pub(crate) rise_m: f64,
    /// Normal forces of the left and the right finger at the end of closing, N.
    pub(crate) force_n: [f64; 2],
    /// Wall time of its time steps, s.
    pub(crate) seconds: f64,
}

/// How far two simulators agree on what was lifted.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Agreement {
    /// Grasps that both simulated.
    pub(crate) compared: usize,
    /// Lifted in both, or in neither.
    pub(crate) agreeing: usize,
    /// Lifted here.
    pub(crate) lifted_ours: usize,
    /// Lifted there.
    pub(crate) lifted_theirs: usize,
    /// The others.
    pub(crate) disagreements: Vec<Disagreement>,
}

/// A grasp that only one simulator lifted.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Disagreement {
    /// Name of the grasp.
    pub(crate) name: String,
    /// Our outcome.
    pub(crate) outcome: GraspOutcome,
    /// Rise of the centre of mass here since before the closing, m.
    pub(crate) lifted_m: f64,
    /// Rise of the centre of mass there in the lift, m.
    pub(crate) their_rise_m: f64,
}

impl Agreement {
    /// Fraction of the grasps that agree; none where none was compared.
    pub(crate) fn fraction(&self) -> Option<f64> {
        (self.compared > 0).then(|| self.agreeing as f64 / self.compared as f64)
    }
}

/// Random grasps of each mesh (m): stable pose, turn, offsets, tilt, lean, height, mass, friction
/// and force from a seed. About four of ten fail. Grasps that start inside something are drawn
/// again.
pub(crate) fn random_grasps(
    engine: &RigidEngine,
    meshes: &[(String, Arc<TriangleMesh>)],
    per_mesh: usize,
    seed: u64,
) -> Result<Vec<PeerGrasp>> {
    let mut grasps = Vec::new();
    for (index, (name, mesh)) in meshes.iter().enumerate() {
        let pieces = engine.decomposition(mesh)?;
        let poses: Vec<Pose> = stable_poses(mesh, 0.0)?
            .iter()
            .take(POSES)
            .map(|pose| pose.t_world_object)
            .collect();
        if poses.is_empty() {
            return Err(Error::input(format!("{name} has no stable pose")).remedy("close its mesh"));
        }
        let stream = seed ^ (index as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let mut rng = Pcg64Mcg::seed_from_u64(stream);
        let mut found = 0;
        // Bounded: a mesh may leave the fingers no room at all.
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

fn draw(rng: &mut Pcg64Mcg, mesh: &Arc<TriangleMesh>, poses: &[Pose]) -> Result<PeerGrasp> {
    let t_world_object = poses[rng.random_range(0..poses.len())];
    let mut spread = |most: f64| rng.random_range(-most..most);
    let placement = Placement {
        yaw_rad: spread(std::f64::consts::PI),
        roll_rad: spread(0.2),
        pitch_rad: spread(0.3),
        offset_m: [spread(0.01), spread(0.02)],
        height_m: None,
        opening_m: None,
    };
    let higher = spread(0.5).max(0.0);
    let mut placed = placement.place(mesh, &t_world_object)?;
    placed.t_world_gripper.translation_m.z *= 1.0 + higher;
    Ok(PeerGrasp {
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

/// The grasps as another simulator can read them, with our convex pieces and `refine` of its
/// time steps in one of ours. Those that start inside something are left out.
pub(crate) fn peer_cases(
    engine: &RigidEngine,
    grasps: &[PeerGrasp],
    refine: u32,
) -> Result<PeerCases> {
    let mut cases = PeerCases {
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
        let known = cases.objects.iter().position(|o| o.name == grasp.object);
        let object = match known {
            Some(index) => index,
            None => {
                cases.objects.push(object(grasp, pieces.pieces())?);
                cases.objects.len() - 1
            }
        };
        cases.grasps.push(PeerCase {
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

/// Compares our results, in the order of `grasps`, with another simulator's answer.
pub(crate) fn compare(
    engine: &RigidEngine,
    grasps: &[PeerGrasp],
    results: &[GraspResult],
    answer: &PeerAnswer,
) -> Agreement {
    let enough = engine.settings.success_rise_m();
    let mut agreement = Agreement::default();
    for (grasp, ours) in grasps.iter().zip(results) {
        let Some(theirs) = answer.grasps.iter().find(|g| g.name == grasp.name) else {
            continue;
        };
        let lifted = ours.outcome == GraspOutcome::Success;
        let lifted_there = theirs.touched && theirs.rise_m >= enough;
        agreement.compared += 1;
        agreement.lifted_ours += usize::from(lifted);
        agreement.lifted_theirs += usize::from(lifted_there);
        if lifted == lifted_there {
            agreement.agreeing += 1;
        } else {
            agreement.disagreements.push(Disagreement {
                name: grasp.name.clone(),
                outcome: ours.outcome,
                lifted_m: ours.lifted_m,
                their_rise_m: theirs.rise_m,
            });
        }
    }
    agreement
}

fn object(grasp: &PeerGrasp, pieces: &[TriangleMesh]) -> Result<PeerObject> {
    let properties = MassProperties::from_mesh(&grasp.setup.mesh)?;
    let mass_kg = grasp.setup.mass_kg;
    let piece = |mesh: &TriangleMesh| PeerPiece {
        vertices_m: mesh.vertices.iter().map(|v| v.to_array()).collect(),
        triangles: mesh.triangles.clone(),
    };
    Ok(PeerObject {
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

    fn grasps(engine: &RigidEngine) -> Vec<PeerGrasp> {
        let mesh = |name: &str| (name.to_owned(), Arc::new(builtin(name).unwrap()));
        random_grasps(engine, &[mesh("box"), mesh("spike")], 3, 7).unwrap()
    }

    #[test]
    fn cases_hold_each_object_once_and_come_again_from_their_seed() {
        let engine = RigidEngine::default();
        let cases = peer_cases(&engine, &grasps(&engine), 4).unwrap();
        assert_eq!(cases.objects.len(), 2);
        let objects: Vec<usize> = cases.grasps.iter().map(|g| g.object).collect();
        assert_eq!(objects, [0, 0, 0, 1, 1, 1]);
        let found = &cases.objects[0];
        let expected = 0.06 / 12.0 * (0.04 * 0.04 + 0.06 * 0.06);
        assert!((found.inertia_kg_m2[0][0] - expected).abs() < 1e-9 * expected);
        assert_eq!(cases, peer_cases(&engine, &grasps(&engine), 4).unwrap());
        let text = serde_json::to_string(&cases).unwrap();
        assert_eq!(serde_json::from_str::<PeerCases>(&text).unwrap(), cases);
    }

    #[test]
    fn only_what_is_lifted_is_compared() {
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
        let theirs = |grasp: &PeerGrasp| PeerResult {
            name: grasp.name.clone(),
            touched: true,
            rise_m: 0.2,
            force_n: [1.0, 1.0],
            seconds: 0.01,
        };
        let answer = PeerAnswer {
            version: "1".to_owned(),
            grasps: grasps.iter().skip(1).map(theirs).collect(),
        };
        let found = compare(&engine, &grasps[1..], &results[1..], &answer);
        assert_eq!((found.compared, found.lifted_theirs), (5, 5));
        assert_eq!(found.agreeing, found.lifted_ours);
        assert_eq!(found.disagreements.len(), 5 - found.lifted_ours);
        assert!(lifted >= found.lifted_ours);
        assert_eq!(Agreement::default().fraction(), None);
    }
}
