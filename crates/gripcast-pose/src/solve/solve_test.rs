//! Poses from noisy corners: accuracy, covariance, ambiguity, outliers.

use glam::{DQuat, DVec2, DVec3};
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64;

use super::*;
use crate::camera::project;
use crate::synthetic::{GraspScene, gripper_markers, ring_board, test_camera};
use crate::{BoardFile, BoardMarker, Dictionary};
use gripcast_geometry::Pose;

fn normal(random: &mut Pcg64) -> f64 {
    let radius = (-2.0 * (1.0 - random.random::<f64>()).ln()).sqrt();
    radius * (std::f64::consts::TAU * random.random::<f64>()).cos()
}

fn scene(index: u64, bodies: [Body; 2]) -> GraspScene {
    let dictionary = Dictionary::by_name("DICT_4X4_50").unwrap();
    let (board, gripper) = (
        ring_board(&dictionary),
        gripper_markers(&dictionary, bodies),
    );
    GraspScene::random(&board, &gripper, &dictionary, 11, index)
}

/// Noisy detections of the markers on the posed bodies.
fn detect(board: &Board, poses: &[(Body, Pose)], sigma: f64, random: &mut Pcg64) -> Vec<Detection> {
    let camera = test_camera(1280, 720);
    let mut detections = Vec::new();
    for marker in &board.markers {
        let Some((_, pose)) = poses.iter().find(|(body, _)| *body == marker.body) else {
            continue;
        };
        let corners_px = marker.corners_m.map(|c| {
            let noise = DVec2::new(normal(random), normal(random)) * sigma;
            project(&camera, pose.transform_point(c)).unwrap() + noise
        });
        detections.push(Detection {
            id: marker.id,
            corners_px,
            hamming: 0,
            margin: 50.0,
        });
    }
    detections
}

fn errors(found: &Pose, truth: &Pose) -> (f64, f64) {
    (
        found.translation_m.distance(truth.translation_m),
        angle_between(found, truth),
    )
}

/// eᵀ C⁻¹ e of the pose's error.
fn normalised_error(found: &Pose, truth: &Pose, covariance: &[[f64; 6]; 6]) -> f64 {
    let shift = truth.translation_m - found.translation_m;
    let rotation = Pose::from_rotation(truth.rotation * found.rotation.conjugate());
    let rotation = rotation.rotation.to_scaled_axis();
    let e = [shift.to_array(), rotation.to_array()].concat();
    let inverse = gripcast_base::linear::Cholesky::beyond_rounding(covariance)
        .unwrap()
        .inverse();
    (0..6)
        .map(|i| (0..6).map(|k| e[i] * inverse[i][k] * e[k]).sum::<f64>())
        .sum()
}

#[test]
fn poses_are_exact_without_noise() {
    let camera = test_camera(1280, 720);
    let mut random = Pcg64::seed_from_u64(1);
    for index in 0..10 {
        let scene = scene(index, [Body::Gripper; 2]);
        let object = [(Body::Object, scene.t_camera_object)];
        let detections = detect(&scene.board, &object, 0.0, &mut random);
        let found = solve_body_pose(&scene.board, Body::Object, &detections, &camera).unwrap();
        let (shift, rotation) = errors(&found.t_camera_body, &scene.t_camera_object);
        assert!(
            shift < 1e-8 && rotation < 1e-7,
            "{index}: {shift} {rotation}"
        );
        assert!(found.rms_px < 1e-6 && !found.ambiguous);
        assert_eq!(found.markers.len(), 14);
    }
}

#[test]
fn covariance_is_consistent_with_the_errors() {
    let camera = test_camera(1280, 720);
    let mut random = Pcg64::seed_from_u64(2);
    const RUNS: u64 = 150;
    let sigma = 0.08;
    let (mut object_sum, mut relative_sum, mut sigma_sum) = (0.0, 0.0, 0.0);
    for index in 0..RUNS {
        let scene = scene(index, [Body::Gripper; 2]);
        let object = [(Body::Object, scene.t_camera_object)];
        let detections = detect(&scene.board, &object, sigma, &mut random);
        let object = solve_body_pose(&scene.board, Body::Object, &detections, &camera).unwrap();
        let body = [(Body::Gripper, scene.t_camera_gripper)];
        let detections = detect(&scene.gripper, &body, sigma, &mut random);
        let gripper = solve_gripper(&scene.gripper, &detections, &camera, None).unwrap();
        assert_eq!(gripper.opening, None);
        let relative = relative_pose(&object, &gripper.body);
        object_sum += normalised_error(
            &object.t_camera_body,
            &scene.t_camera_object,
            &object.covariance,
        );
        relative_sum += normalised_error(
            &relative.t_object_gripper,
            &scene.t_object_gripper(),
            &relative.covariance,
        );
        sigma_sum += object.corner_sigma_px;
    }
    // 6 for Gaussian errors of known deviation; here the deviation is estimated from few corners.
    let (object, relative) = (object_sum / RUNS as f64, relative_sum / RUNS as f64);
    assert!((5.0..7.5).contains(&object), "{object}");
    assert!((5.0..10.0).contains(&relative), "{relative}");
    let mean = sigma_sum / RUNS as f64;
    assert!((mean - sigma).abs() < 0.1 * sigma, "{mean}");
}

#[test]
fn opening_and_body_are_recovered_together() {
    let camera = test_camera(1280, 720);
    let mut random = Pcg64::seed_from_u64(3);
    let bodies = [Body::FingerLeft, Body::FingerRight];
    let mut squared = 0.0;
    for index in 0..40 {
        let scene = scene(index, bodies);
        let half = DVec3::X * 0.5 * scene.opening_m;
        let shifted = |by| scene.t_camera_gripper * Pose::from_translation(by);
        let poses = [(bodies[0], shifted(-half)), (bodies[1], shifted(half))];
        let exact = detect(&scene.gripper, &poses, 0.0, &mut random);
        let found = solve_gripper(&scene.gripper, &exact, &camera, None).unwrap();
        let opening = found.opening.unwrap();
        assert!((opening.opening_m - scene.opening_m).abs() < 1e-8);
        let (shift, rotation) = errors(&found.body.t_camera_body, &scene.t_camera_gripper);
        assert!(shift < 1e-8 && rotation < 1e-7, "{shift} {rotation}");

        let noisy = detect(&scene.gripper, &poses, 0.05, &mut random);
        let found = solve_gripper(&scene.gripper, &noisy, &camera, None).unwrap();
        let opening = found.opening.unwrap();
        squared += ((opening.opening_m - scene.opening_m) / opening.sigma_m).powi(2);

        let known = solve_gripper(&scene.gripper, &noisy, &camera, Some(scene.opening_m)).unwrap();
        assert_eq!(known.opening.unwrap().sigma_m, 0.0);
        let better = |p: &BodyPose| p.covariance[2][2];
        assert!(better(&known.body) < better(&found.body));
    }
    let mean = squared / 40.0;
    assert!((0.5..2.0).contains(&mean), "{mean}");
}

/// The outlier is the only finger marker.
#[test]
fn outlier_on_a_finger_does_not_affect_the_pose() {
    let camera = test_camera(1280, 720);
    let mut random = Pcg64::seed_from_u64(5);
    let board = BoardFile::gripper_umi().unwrap().board;
    let truth = scene(5, [Body::Gripper; 2]).t_camera_gripper;
    let right = truth * Pose::from_translation(DVec3::X * 0.04);
    let poses = [(Body::Gripper, truth), (Body::FingerRight, right)];
    let mut detections = detect(&board, &poses, 0.05, &mut random);
    assert!(detections.len() > 3);
    let whole = solve_gripper(&board, &detections, &camera, None).unwrap();
    assert!((whole.opening.unwrap().opening_m - 0.08).abs() < 1e-3);

    let finger = board.markers.iter().find(|m| m.body == Body::FingerRight);
    let finger = finger.unwrap().id;
    let wrong = detections.iter_mut().find(|d| d.id == finger).unwrap();
    // Rotated, so that it fits at no opening.
    wrong.corners_px.rotate_left(1);
    let found = solve_gripper(&board, &detections, &camera, None).unwrap();
    assert_eq!(found.opening, None);
    let (shift, rotation) = errors(&found.body.t_camera_body, &truth);
    assert!(shift < 1e-3 && rotation < 5e-3, "{shift} {rotation}");
    let expected = format!("marker {finger} was excluded");
    assert!(found.body.notes.iter().any(|note| note.contains(&expected)));
}

#[test]
fn single_finger_requires_a_known_opening() {
    let camera = test_camera(1280, 720);
    let mut random = Pcg64::seed_from_u64(4);
    let scene = scene(5, [Body::FingerLeft, Body::FingerRight]);
    let shift = Pose::from_translation(DVec3::X * (-0.5 * scene.opening_m));
    let left = [(Body::FingerLeft, scene.t_camera_gripper * shift)];
    let detections = detect(&scene.gripper, &left, 0.0, &mut random);
    assert_eq!(detections.len(), 1);
    let error = solve_gripper(&scene.gripper, &detections, &camera, None).unwrap_err();
    assert!(error.to_string().contains("one finger"), "{error}");
    let found = solve_gripper(&scene.gripper, &detections, &camera, Some(scene.opening_m)).unwrap();
    let (shift, _) = errors(&found.body.t_camera_body, &scene.t_camera_gripper);
    assert!(shift < 1e-8, "{shift}");
}

fn single(tilt: f64) -> (Board, Pose) {
    let h = 0.015;
    let corners = [(-h, h), (h, h), (h, -h), (-h, -h)];
    let board = Board {
        name: "one".into(),
        dictionary: "none".into(),
        markers: vec![BoardMarker {
            id: 7,
            body: Body::Gripper,
            corners_m: corners.map(|(x, y)| DVec3::new(x, y, 0.0)),
        }],
    };
    let rotation = DQuat::from_rotation_y(tilt) * DQuat::from_rotation_x(std::f64::consts::PI);
    (board, Pose::new(rotation, DVec3::new(0.0, 0.0, 0.5)))
}

#[test]
fn single_marker_is_ambiguous_if_frontal() {
    let camera = test_camera(1280, 720);
    let mut random = Pcg64::seed_from_u64(5);
    let solved = |tilt: f64, random: &mut Pcg64| {
        let (board, pose) = single(tilt);
        let detections = detect(&board, &[(Body::Gripper, pose)], 0.05, random);
        (
            solve_body_pose(&board, Body::Gripper, &detections, &camera).unwrap(),
            pose,
        )
    };
    for _ in 0..20 {
        let (frontal, pose) = solved(0.1, &mut random);
        assert!(frontal.ambiguous, "{:?}", frontal.ambiguity);
        // One of them is near the truth.
        let both = [Some(frontal.t_camera_body), frontal.runner_up];
        let nearest = both
            .iter()
            .flatten()
            .map(|p| angle_between(p, &pose))
            .fold(f64::INFINITY, f64::min);
        assert!(nearest < 0.1, "{nearest}");
        assert!(frontal.notes.iter().any(|n| n.contains("ambiguous")));
        let (tilted, pose) = solved(0.9, &mut random);
        assert!(!tilted.ambiguous, "{:?}", tilted.ambiguity);
        assert!(tilted.ambiguity.is_none_or(|ratio| ratio > 2.0));
        assert!(angle_between(&tilted.t_camera_body, &pose) < 0.02);
    }
}

#[test]
fn outliers_are_excluded() {
    let camera = test_camera(1280, 720);
    let mut random = Pcg64::seed_from_u64(6);
    let scene = scene(3, [Body::Gripper; 2]);
    let object = [(Body::Object, scene.t_camera_object)];
    let mut detections = detect(&scene.board, &object, 0.05, &mut random);
    for corner in &mut detections[4].corners_px {
        *corner += DVec2::new(7.0, -4.0);
    }
    detections[9].corners_px.rotate_left(1);
    let found = solve_body_pose(&scene.board, Body::Object, &detections, &camera).unwrap();
    let outliers: Vec<u32> = found
        .markers
        .iter()
        .filter(|m| !m.used)
        .map(|m| m.id)
        .collect();
    assert_eq!(outliers, [4, 9]);
    assert!(
        found
            .notes
            .iter()
            .any(|n| n.contains("marker 4 was excluded"))
    );
    let (shift, rotation) = errors(&found.t_camera_body, &scene.t_camera_object);
    assert!(shift < 3e-4 && rotation < 1e-3, "{shift} {rotation}");
    assert!(found.rms_px < 0.15, "{}", found.rms_px);
}

#[test]
fn unsolvable_detections_are_reported() {
    let camera = test_camera(1280, 720);
    let mut random = Pcg64::seed_from_u64(7);
    let mut scene = scene(3, [Body::Gripper; 2]);
    let none = solve_body_pose(&scene.board, Body::Object, &[], &camera).unwrap_err();
    assert!(
        none.to_string().contains("no marker of the object's board"),
        "{none}"
    );
    let body = [(Body::Gripper, scene.t_camera_gripper)];
    let detections = detect(&scene.gripper, &body, 0.05, &mut random);
    // The board file has the left marker 20 mm off.
    for corner in &mut scene.gripper.markers[0].corners_m {
        corner.z += 0.02;
    }
    let wrong = solve_gripper(&scene.gripper, &detections, &camera, None).unwrap_err();
    assert!(
        wrong.to_string().contains("do not match the board"),
        "{wrong}"
    );
    for marker in &mut scene.gripper.markers {
        marker.corners_m = [DVec3::ZERO; 4];
    }
    let flat = solve_gripper(&scene.gripper, &detections, &camera, None).unwrap_err();
    assert!(flat.to_string().contains("do not determine"), "{flat}");
    let mut broken = detections;
    for detection in &mut broken {
        detection.corners_px[1] = DVec2::NAN;
    }
    assert!(solve_gripper(&scene.gripper, &broken, &camera, None).is_err());
}
