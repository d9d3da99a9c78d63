//! Tests of scenes: frames, mountings, faces.

use glam::{DMat3, DVec3};

use super::*;
use crate::object_depth;
use gripcast_geometry::builtin;
use gripcast_sim::fem::{GelPad, GelResolution};
use gripcast_sim::grasp::{GelSpec, Scene, StageName};

const GRID: SensorGeometry = SensorGeometry {
    width: 80,
    height: 60,
    pixel_m: 2e-4,
    gel_thickness_m: 4e-3,
};
const OPENING_M: f64 = 0.03;

fn gel() -> SimulatedGel {
    SimulatedGel {
        grid: GelPad::default().grid(GelResolution::Coarse).unwrap(),
        d_hat_m: 5e-4,
    }
}

/// A rotated gripper pose.
fn gripper() -> Pose {
    let rotation = DQuat::from_rotation_x(0.7) * DQuat::from_rotation_z(-2.0);
    Pose::new(rotation, DVec3::new(0.1, -0.2, 0.3))
}

/// A 2 mm box that reaches 1 mm into both gels, centred at `across` in the gripper frame.
fn feature(across: DVec3) -> TriangleMesh {
    let mut mesh = builtin("builtin:box").unwrap();
    let extent = mesh.bounds().extent();
    let size = DVec3::new(OPENING_M + 2e-3, 2e-3, 2e-3);
    for vertex in &mut mesh.vertices {
        *vertex = *vertex / extent * size + across;
    }
    mesh
}

/// A snapshot with both gels at rest.
fn snapshot(gel: &SimulatedGel) -> Snapshot {
    let nodes = Finger::BOTH.map(|finger| {
        let t_gripper_gel = SensorMount::on(finger).t_gripper_sensor(OPENING_M, 4e-3);
        let t_world_gel = gripper() * t_gripper_gel;
        let to_world = |p: &DVec3| t_world_gel.transform_point(*p).to_array();
        gel.grid.positions().iter().map(to_world).collect()
    });
    Snapshot {
        stage: StageName::Adjustment,
        t_s: 1.0,
        t_world_object: gripper(),
        t_world_gripper: gripper(),
        opening_m: OPENING_M,
        gels: nodes,
    }
}

/// Mean column and row of the indentation from the image centre, and the maximum depth.
fn pressed_at(object: &TriangleMesh, mount: SensorMount) -> ([f64; 2], f64) {
    let gel = gel();
    let scene = TactileScene::from_snapshot(object, &gel, &snapshot(&gel), mount).unwrap();
    assert!((scene.face_m - 4e-3).abs() < 1e-12);
    assert_eq!(
        scene.gap_m, gel.d_hat_m,
        "undeformed gel: no contact is measured"
    );
    let press = object_depth(&scene, &GRID, &mut Rasteriser::new());
    let (mut sum, mut count) = ([0.0; 2], 0.0);
    for (pixel, depth) in press.depth_m.iter().enumerate() {
        if *depth > 0.0 {
            sum[0] += (pixel % 80) as f64 - 39.5;
            sum[1] += (pixel / 80) as f64 - 29.5;
            count += 1.0;
        }
    }
    (sum.map(|s| s / count), press.deepest_m())
}

#[test]
fn features_appear_at_documented_positions() {
    let ahead = feature(DVec3::Z * 5e-3);
    let aside = feature(DVec3::Y * 4e-3);
    for finger in Finger::BOTH {
        let ([column, row], depth) = pressed_at(&ahead, SensorMount::on(finger));
        assert!(
            (column - 25.0).abs() < 0.6 && row.abs() < 0.6,
            "{finger:?} {column} {row}"
        );
        assert!((depth - 1.5e-3).abs() < 1e-8, "1 mm and the gap: {depth}");
        let ([column, row], _) = pressed_at(&aside, SensorMount::on(finger));
        let expected = if finger == Finger::Left { -20.0 } else { 20.0 };
        assert!(
            (row - expected).abs() < 0.6 && column.abs() < 0.6,
            "{finger:?} {column} {row}"
        );
    }
}

#[test]
fn mounting_angle_rotates_image_oppositely() {
    let ahead = feature(DVec3::Z * 5e-3);
    let expected = [
        (0, [25.0, 0.0]),
        (90, [0.0, -25.0]),
        (180, [-25.0, 0.0]),
        (270, [0.0, 25.0]),
    ];
    for finger in Finger::BOTH {
        for (degrees, expected) in expected {
            let mounting = MountingAngle::from_degrees(degrees).unwrap();
            let (centre, _) = pressed_at(&ahead, SensorMount { finger, mounting });
            let off = (centre[0] - expected[0])
                .abs()
                .max((centre[1] - expected[1]).abs());
            assert!(off < 0.6, "{finger:?} {degrees}: {centre:?}");
        }
    }
}

#[test]
fn sensor_frames_are_right_handed_and_face_each_other() {
    for finger in Finger::BOTH {
        let pose = SensorMount::on(finger).t_gripper_sensor(OPENING_M, 4e-3);
        assert!((pose.rotation_matrix().determinant() - 1.0).abs() < 1e-12);
        let face = pose.transform_point(DVec3::Z * 4e-3);
        let expected = -0.5 * OPENING_M * finger.closing();
        assert!(face.distance(expected) < 1e-12);
        assert!(pose.transform_vector(DVec3::X).distance(DVec3::Z) < 1e-12);
    }
}

#[test]
fn mounting_angle_must_be_quarter_turn() {
    let text = MountingAngle::from_degrees(45).unwrap_err().to_string();
    assert!(text.contains("found 45"), "{text}");
    assert_eq!(MountingAngle::from_degrees(270).unwrap().degrees(), 270);
}

#[test]
fn step_agrees_with_snapshot_of_same_time() {
    let object = feature(DVec3::Z * 5e-3);
    let gel = gel();
    let lift = 0.02;
    let mut step: TraceStep = TraceStep {
        stage: StageName::Lift,
        t_s: 1.0,
        force: Default::default(),
        t_world_object: Pose::from_translation(DVec3::Z * lift) * gripper(),
        opening_m: OPENING_M,
        lifted_m: lift,
        min_gap_m: [None, Some(4.5e-4)],
        solver: None,
    };
    for finger in Finger::BOTH {
        let mount = SensorMount::on(finger);
        let scene = TactileScene::from_step(&object, &gel, &gripper(), &step, mount).unwrap();
        let reference = TactileScene::from_snapshot(&object, &gel, &snapshot(&gel), mount).unwrap();
        let offset = scene.t_sensor_object.inverse() * reference.t_sensor_object;
        assert!(offset.translation_m.length() < 1e-12);
        assert!(scene.gel_face.is_none());
        assert_eq!(scene.gap_m, [5e-4, 4.75e-4][finger as usize]);
    }
    step.opening_m -= 2e-3;
    let mount = SensorMount::on(Finger::Right);
    let scene = TactileScene::from_step(&object, &gel, &gripper(), &step, mount).unwrap();
    let press = object_depth(&scene, &GRID, &mut Rasteriser::new());
    assert!((press.deepest_m() - 2.475e-3).abs() < 1e-8);
}

#[test]
fn no_contact_before_the_fingers_close() {
    let scene = Scene {
        mesh: feature(DVec3::ZERO),
        mass_kg: 0.1,
        friction: 0.5,
        t_world_object: gripper(),
        t_world_gripper: gripper(),
        opening_m: OPENING_M + 0.01,
        gel: GelSpec::standard(GelResolution::Coarse).unwrap(),
    };
    for finger in Finger::BOTH {
        let start = {
            let gel = SimulatedGel {
                grid: scene.gel.grid.clone(),
                d_hat_m: 5e-4,
            };
            let poses = [&scene.t_world_object, &scene.t_world_gripper];
            let mount = SensorMount::on(finger);
            TactileScene::before_closing(&scene.mesh, &gel, poses, scene.opening_m, mount).unwrap()
        };
        let press = object_depth(&start, &GRID, &mut Rasteriser::new());
        assert_eq!(press.deepest_m(), 0.0);
        let face = start.gel_face.unwrap();
        assert!(face.vertices.iter().all(|v| (v.z - 4e-3).abs() < 1e-15));
        let [a, b, c] = face.corners(face.triangles[0]);
        assert!((b - a).cross(c - a).z > 0.0, "seen from outside");
    }
}

#[test]
fn mesh_is_pressed_to_given_depth() {
    let object = feature(DVec3::ZERO);
    let upright = Pose::from_rotation(DQuat::from_mat3(&DMat3::from_cols(
        DVec3::Z,
        DVec3::Y,
        DVec3::NEG_X,
    )));
    let scene = TactileScene::pressed(&object, &upright, 8e-4, &GRID).unwrap();
    let press = object_depth(&scene, &GRID, &mut Rasteriser::new());
    assert!((press.deepest_m() - 8e-4).abs() < 1e-8);
    let aside = Pose::from_translation(DVec3::X * 0.1);
    let text = TactileScene::pressed(&object, &aside, 8e-4, &GRID).unwrap_err();
    assert!(
        text.to_string().contains("not over the sensor's image"),
        "{text}"
    );
    for depth in [0.0, -1e-3, 5e-3, f64::NAN] {
        let text = TactileScene::pressed(&object, &upright, depth, &GRID).unwrap_err();
        assert!(text.to_string().contains("thickness of 0.004"), "{text}");
    }
}

#[test]
fn snapshot_of_another_gel_or_invalid_mesh_is_refused() {
    let object = feature(DVec3::ZERO);
    let gel = gel();
    let mut other = snapshot(&gel);
    other.gels[0].pop();
    let mount = SensorMount::on(Finger::Left);
    let text = TactileScene::from_snapshot(&object, &gel, &other, mount).unwrap_err();
    assert!(text.to_string().contains("429 nodes"), "{text}");
    let empty = TriangleMesh::default();
    assert!(TactileScene::from_snapshot(&empty, &gel, &snapshot(&gel), mount).is_err());
}
