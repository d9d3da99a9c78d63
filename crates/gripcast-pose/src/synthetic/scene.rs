//! Random scenes of a board, a gripper above it and a camera.

use glam::{DQuat, DVec3};
use rand::RngExt as _;
use rand_pcg::Pcg64;

use super::{ImageConditions, PlacedBoard, SyntheticImage, render};
use crate::{Board, BoardMarker, Body, Dictionary};
use gripcast_geometry::Pose;
use gripcast_imaging::{DistortionModel, Intrinsics};

/// Side of all markers, m.
const MARKER_M: f64 = 0.03;
/// Yaw (to both sides) and pitch of the gripper's markers: 35°.
const TILT_RAD: f64 = 0.6109;

/// Fourteen markers of 30 mm around the centre of an A4 sheet: ids 0 to 13.
#[must_use]
pub fn ring_board(dictionary: &Dictionary) -> Board {
    let mut markers = Vec::new();
    for row in 0..4u32 {
        for column in 0..5u32 {
            let is_middle = (1..=3).contains(&column) && (1..=2).contains(&row);
            if is_middle {
                continue;
            }
            let x = -0.108 + 0.054 * f64::from(column);
            let y = 0.072 - 0.048 * f64::from(row);
            let centre = Pose::from_translation(DVec3::new(x, y, 0.0));
            markers.push(marker(markers.len() as u32, Body::Object, &centre));
        }
    }
    Board {
        name: "ring of 14".to_owned(),
        dictionary: dictionary.name().to_owned(),
        markers,
    }
}

/// Two markers of 30 mm on one side of a gripper, 56° apart: ids 40 and 41. `bodies` are what
/// carries the one at −x and the one at +x.
#[must_use]
pub fn gripper_markers(dictionary: &Dictionary, bodies: [Body; 2]) -> Board {
    let t_body_marker = |side: f64| {
        let normal = DVec3::new(
            TILT_RAD.cos() * (side * TILT_RAD).sin(),
            TILT_RAD.cos() * TILT_RAD.cos(),
            -TILT_RAD.sin(),
        );
        // The marker's up is opposite to the approach.
        let up = (-DVec3::Z).reject_from(normal).normalize_or(DVec3::X);
        let axes = glam::DMat3::from_cols(up.cross(normal), up, normal);
        Pose::new(
            DQuat::from_mat3(&axes),
            DVec3::new(side * 0.026, 0.020, -0.025),
        )
    };
    Board {
        name: "gripper".to_owned(),
        dictionary: dictionary.name().to_owned(),
        markers: vec![
            marker(40, bodies[0], &t_body_marker(-1.0)),
            marker(41, bodies[1], &t_body_marker(1.0)),
        ],
    }
}

/// The marker with the frame `t_body_marker`: x right, y up, z normal.
fn marker(id: u32, body: Body, t_body_marker: &Pose) -> BoardMarker {
    let h = 0.5 * MARKER_M;
    let corners = [(-h, h), (h, h), (h, -h), (-h, -h)];
    BoardMarker {
        id,
        body,
        corners_m: corners.map(|(x, y)| t_body_marker.transform_point(DVec3::new(x, y, 0.0))),
    }
}

/// Intrinsics similar to the colour camera of a D435.
#[must_use]
pub fn test_camera(width: u32, height: u32) -> Intrinsics {
    let focal = 915.0 * f64::from(width) / 1280.0;
    Intrinsics {
        width,
        height,
        fx: focal,
        fy: focal,
        cx: 0.5 * f64::from(width) - 0.5 + 3.3,
        cy: 0.5 * f64::from(height) - 0.5 - 2.1,
        model: DistortionModel::None,
        coefficients: [0.0; 5],
    }
}

/// A gripper above a board, in front of a camera.
#[derive(Clone, Debug)]
pub struct GraspScene {
    /// The object's board.
    pub board: Board,
    /// The gripper's markers.
    pub gripper: Board,
    /// The dictionary of both.
    pub dictionary: Dictionary,
    /// Pose of the object in the camera frame.
    pub t_camera_object: Pose,
    /// Pose of the gripper in the camera frame.
    pub t_camera_gripper: Pose,
    /// Opening of the gripper, m; displaces the finger markers.
    pub opening_m: f64,
}

impl GraspScene {
    /// Scene `index` of a seed: camera at 0.4–0.8 m and 20–55° from the board's normal, gripper
    /// 50–90 mm above the board with its markers towards the camera.
    #[must_use]
    pub fn random(
        board: &Board,
        gripper: &Board,
        dictionary: &Dictionary,
        seed: u64,
        index: u64,
    ) -> Self {
        let mut random = Pcg64::new(u128::from(seed), u128::from(index));
        // The first numbers of adjacent streams are correlated.
        for _ in 0..8 {
            let _: u64 = random.random();
        }
        let mut between = |low: f64, high: f64| random.random_range(low..high);
        let azimuth = between(0.0, std::f64::consts::TAU);
        let tilt = between(20.0f64, 55.0).to_radians();
        let distance = between(0.4, 0.8);
        let target = DVec3::new(between(-0.02, 0.02), between(-0.02, 0.02), 0.02);
        let towards = DVec3::new(
            tilt.sin() * azimuth.cos(),
            tilt.sin() * azimuth.sin(),
            tilt.cos(),
        );
        let z = -towards;
        let x = z.cross(DVec3::Z).normalize_or(DVec3::X);
        let axes = glam::DMat3::from_cols(x, z.cross(x), z);
        let roll = DQuat::from_rotation_z(between(-0.35, 0.35));
        let t_object_camera =
            Pose::new(DQuat::from_mat3(&axes) * roll, target + towards * distance);
        // Gripper y towards the camera, z down.
        let heading = azimuth + between(-15.0f64, 15.0).to_radians();
        let upright = DQuat::from_mat3(&glam::DMat3::from_cols(DVec3::Y, DVec3::X, -DVec3::Z));
        let mut tilt = || between(-8.0f64, 8.0).to_radians();
        let tilted = DQuat::from_rotation_x(tilt()) * DQuat::from_rotation_y(tilt());
        let t_object_gripper = Pose::new(
            DQuat::from_rotation_z(heading) * tilted * upright,
            DVec3::new(
                between(-0.025, 0.025),
                between(-0.015, 0.015),
                between(0.05, 0.09),
            ),
        );
        let t_camera_object = t_object_camera.inverse();
        Self {
            board: board.clone(),
            gripper: gripper.clone(),
            dictionary: dictionary.clone(),
            t_camera_object,
            t_camera_gripper: t_camera_object * t_object_gripper,
            opening_m: between(0.0, 0.08),
        }
    }

    /// True pose of the gripper relative to the object.
    #[must_use]
    pub fn t_object_gripper(&self) -> Pose {
        self.t_camera_object.inverse() * self.t_camera_gripper
    }

    /// Renders the scene.
    #[must_use]
    pub fn render(
        &self,
        intrinsics: &Intrinsics,
        conditions: &ImageConditions,
        seed: u64,
    ) -> SyntheticImage {
        let half = DVec3::X * (0.5 * self.opening_m);
        let gripper = |body, shift| PlacedBoard {
            board: &self.gripper,
            body,
            dictionary: &self.dictionary,
            t_camera_body: self.t_camera_gripper * Pose::from_translation(shift),
        };
        let placed = [
            PlacedBoard {
                board: &self.board,
                body: Body::Object,
                dictionary: &self.dictionary,
                t_camera_body: self.t_camera_object,
            },
            gripper(Body::Gripper, DVec3::ZERO),
            gripper(Body::FingerLeft, -half),
            gripper(Body::FingerRight, half),
        ];
        render(intrinsics, &placed, conditions, seed)
    }
}
