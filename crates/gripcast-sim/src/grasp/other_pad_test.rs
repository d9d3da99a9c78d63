use std::sync::Arc;

use super::{GraspOutcome, GraspSettings, Placement, Preset, StageName, resting_pose};
use crate::fem::{GelPad, GelResolution};
use crate::rigid::{RigidEngine, RigidSettings};
use crate::{Engine, FemEngine, GraspSetup};
use gripcast_geometry::{TriangleMesh, builtin};

/// A pad of the size of a DIGIT's.
const PAD: GelPad = GelPad {
    size_m: [0.019, 0.016],
    thickness_m: 0.002,
};

fn fem() -> FemEngine {
    let mut settings = GraspSettings::new(Preset::Paper);
    settings.pad = PAD;
    settings.resolution = GelResolution::Coarse;
    settings.protocol.lift_m = 0.01;
    settings.protocol.success_height_m = 0.005;
    FemEngine { settings }
}

fn rigid() -> RigidEngine {
    RigidEngine::new(RigidSettings {
        pad: PAD,
        ..RigidSettings::default()
    })
}

/// A box gripped from above at the lowest height that the pad allows.
fn setup(mesh: TriangleMesh, pad: GelPad) -> GraspSetup {
    let t_world_object = resting_pose(&mesh, None).unwrap().1.t_world_object;
    let placement = Placement {
        pad,
        ..Placement::default()
    };
    let placed = placement.place(&mesh, &t_world_object).unwrap();
    GraspSetup {
        mesh: Arc::new(mesh),
        mass_kg: 0.05,
        t_world_object,
        t_world_gripper: placed.t_world_gripper,
        opening_m: placed.opening_m,
    }
}

#[test]
fn both_engines_lift_with_a_digit_sized_pad() {
    let mesh = builtin("box").unwrap();
    let engines: [Box<dyn Engine>; 2] = [Box::new(fem()), Box::new(rigid())];
    for engine in engines {
        assert_eq!(engine.pad(), PAD);
        let result = engine.simulate(&setup(mesh.clone(), PAD), 0.8, 15.0);
        let result = result.unwrap();
        let kind = engine.kind();
        assert_eq!(result.outcome, GraspOutcome::Success, "{kind:?}");
        assert!(result.trace.mean_force(StageName::Lift, 5).unwrap() > 5.0);
    }
}

#[test]
fn a_lower_pad_reaches_a_flatter_object() {
    // Flatter than half of the default pad, so that the ground decides the height.
    let mut mesh = builtin("box").unwrap();
    let height = mesh.bounds().extent().z;
    for vertex in &mut mesh.vertices {
        vertex.z *= 0.01 / height;
    }
    let height_m = |pad| setup(mesh.clone(), pad).t_world_gripper.translation_m.z;
    let lower = height_m(GelPad::default()) - height_m(PAD);
    assert!((lower - 0.5 * (0.025 - 0.019)).abs() < 1e-9, "{lower}");
}

#[test]
fn parameters_name_another_pad_only() {
    let pad = serde_json::json!({"size_m": [0.019, 0.016], "thickness_m": 0.002});
    let parameters = fem().parameters().unwrap();
    assert_eq!(parameters["gel"]["pad"], pad);
    assert_eq!(parameters["gel"]["nodes"], serde_json::json!([10, 9, 3]));
    assert_eq!(rigid().parameters().unwrap()["pad"], pad);
    let usual = FemEngine::default().parameters().unwrap();
    assert!(usual["gel"].get("pad").is_none());
    let usual = RigidEngine::default().parameters().unwrap();
    assert!(usual.get("pad").is_none());
}

#[test]
fn a_pad_in_millimetres_is_refused() {
    let mut engine = fem();
    engine.settings.pad.thickness_m = 2.0;
    let setup = setup(builtin("box").unwrap(), PAD);
    let error = engine.simulate(&setup, 0.4, 10.0).unwrap_err();
    assert!(error.to_string().contains("thickness_m"), "{error}");
}
