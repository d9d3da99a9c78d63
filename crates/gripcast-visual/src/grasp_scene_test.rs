use super::*;
use crate::VisualRandomisation;
use crate::demo::demo_model;
use gripcast_geometry::builtin;
use gripcast_sim::fem::{GelGrid, GelPad, GelResolution};
use gripcast_sim::grasp::{Finger, Placement, Snapshot, StageName};

fn mug_state() -> (Model, GraspState) {
    let mesh = builtin("mug").unwrap();
    let t_world_object = Pose::from_translation(DVec3::Z * -mesh.bounds().min.z);
    let placed = Placement::default().place(&mesh, &t_world_object).unwrap();
    let state = GraspState {
        t_world_object,
        t_world_gripper: placed.t_world_gripper,
        opening_m: placed.opening_m,
        gels: None,
    };
    (demo_model("mug", 1).unwrap(), state)
}

fn snapshot(state: &GraspState, resolution: GelResolution) -> Snapshot {
    let grid = GelPad::default().grid(resolution).unwrap();
    let gels = Finger::BOTH.map(|finger| {
        let back = finger.closing() * -(0.5 * state.opening_m + grid.thickness_m());
        let place = state.t_world_gripper * Pose::new(DQuat::from_mat3(&finger.rotation()), back);
        let nodes = grid.positions().iter();
        nodes
            .map(|p| place.transform_point(*p).to_array())
            .collect()
    });
    Snapshot {
        stage: StageName::Adjustment,
        t_s: 1.0,
        t_world_object: state.t_world_object,
        t_world_gripper: state.t_world_gripper,
        opening_m: state.opening_m,
        gels,
    }
}

#[test]
fn gels_and_object_are_in_view_for_every_seed() {
    let (model, state) = mug_state();
    let ranges = VisualRandomisation::default();
    for seed in 0..100 {
        let camera = eye_in_hand_camera(&state, &ranges.sample(seed), [320, 240]);
        assert!(sees_gels(&camera, &state), "{seed}");
        let places = model
            .positions()
            .map(|p| state.t_world_object.transform_point(p));
        let seen = places.filter(|p| {
            camera.project(*p).is_some_and(|[column, row, _]| {
                (0.0..319.0).contains(&column) && (0.0..239.0).contains(&row)
            })
        });
        let fraction = seen.count() as f64 / model.positions().count() as f64;
        assert!(fraction > 0.7, "{seed}: {fraction}");
    }
}

#[test]
fn camera_moves_back_until_gels_are_visible() {
    let (_, state) = mug_state();
    let mut conditions = VisualRandomisation::default().sample(0);
    conditions.t_nominal_camera = Pose::from_rotation(DQuat::from_rotation_y(0.9));
    let camera = eye_in_hand_camera(&state, &conditions, [320, 240]);
    assert!(sees_gels(&camera, &state));
}

#[test]
fn scene_contains_object_ground_gripper_and_gels() {
    let (model, state) = mug_state();
    let conditions = VisualRandomisation::default().sample(5);
    let view = View::EyeInHand([64, 48]);
    let scene = grasp_scene(&model, &state, &conditions, view).unwrap();
    let outside = grasp_scene(&model, &state, &conditions, View::External([64, 48])).unwrap();
    assert!(
        outside.meshes.len() > scene.meshes.len(),
        "the D435 is visible only from outside"
    );

    for resolution in [
        GelResolution::Coarse,
        GelResolution::Default,
        GelResolution::Fine,
    ] {
        let snapshot = snapshot(&state, resolution);
        let pressed = GraspState::from_snapshot(&snapshot, None).unwrap();
        let scene_pressed = grasp_scene(&model, &pressed, &conditions, view).unwrap();
        assert_eq!(scene_pressed.meshes.len(), scene.meshes.len());
        let gels = pressed.gels.unwrap();
        assert!(gels.iter().all(|gel| gel.edges().is_closed()));
        // At rest the deformed gels are the undeformed ones.
        let t_gripper_world = state.t_world_gripper.inverse();
        let left = Aabb::from_points(
            gels[0]
                .vertices
                .iter()
                .map(|p| t_gripper_world.transform_point(*p)),
        );
        assert!((left.max.x + 0.5 * state.opening_m).abs() < 1e-9);
        assert!((left.extent() - DVec3::new(0.004, 0.020, 0.025)).length() < 1e-9);
    }
}

#[test]
fn gel_of_unknown_mesh_is_refused() {
    let (_, state) = mug_state();
    let mut snapshot = snapshot(&state, GelResolution::Coarse);
    snapshot.gels[1].pop();
    let text = GraspState::from_snapshot(&snapshot, None)
        .unwrap_err()
        .to_string();
    assert!(text.contains("428 nodes"), "{text}");
    let grid = GelGrid::uniform([5, 4, 2], [0.025, 0.02, 0.004]).unwrap();
    let own = grid
        .positions()
        .iter()
        .map(|p| p.to_array())
        .collect::<Vec<_>>();
    snapshot.gels = [own.clone(), own];
    assert!(GraspState::from_snapshot(&snapshot, None).is_err());
    assert!(GraspState::from_snapshot(&snapshot, Some(&grid)).is_ok());
}

#[test]
fn camera_inside_object_or_ground_is_refused() {
    let (model, state) = mug_state();
    let conditions = VisualRandomisation::default().sample(1);
    let mut big = model.clone();
    for position in &mut big.meshes[0].positions {
        *position *= 20.0;
    }
    let view = View::EyeInHand([64, 48]);
    // The wall of a mug as high as a person.
    let eye = eye_in_hand_camera(&state, &conditions, [64, 48])
        .t_world_camera
        .translation_m;
    let wall = DVec3::new(0.58, 0.1, 0.3);
    let moved = GraspState {
        t_world_object: Pose::from_translation(eye - wall),
        ..state.clone()
    };
    let error = grasp_scene(&big, &moved, &conditions, view).unwrap_err();
    let text = error.to_string();
    assert!(
        text.contains("inside the object") && text.contains("unit"),
        "{text}"
    );
    let low = GraspState {
        t_world_gripper: Pose::from_translation(DVec3::Z * -1.0),
        ..state
    };
    let text = grasp_scene(&model, &low, &conditions, view)
        .unwrap_err()
        .to_string();
    assert!(text.contains("below the ground"), "{text}");
}
