//! Initial gripper pose: a grasp from above by a few parameters, or a recorded pose.

use std::f64::consts::FRAC_PI_2;

use glam::{DMat3, DQuat, DVec3};
use serde::{Deserialize, Serialize};

use crate::fem::GelPad;
use gripcast_base::error::{Error, Result};
use gripcast_geometry::{Aabb, Pose, StablePose, TriangleMesh, nearest_pose, stable_poses};

/// Largest opening of the gripper by default, m: a parallel gripper of the size of the paper's.
pub const GRIPPER_OPENING_M: f64 = 0.09;
/// Clearance between the object and each gel, m.
const SIDE_CLEARANCE_M: f64 = 1e-3;
/// Clearance between the gels and the ground, m.
const GROUND_CLEARANCE_M: f64 = 5e-4;

/// A grasp from above, relative to the resting object.
///
/// By default the gripper's z axis points down and its x axis along the world's; its origin is the
/// centre of the object's bounding box, raised if the gels would not clear the ground; the opening
/// is the object's width plus 1 mm on each side.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Placement {
    /// Rotation about the world's z axis, rad.
    pub yaw_rad: f64,
    /// Rotation about the gripper's y axis, rad: one finger higher than the other.
    pub roll_rad: f64,
    /// Rotation about the gripper's x axis, rad: approach out of the vertical.
    pub pitch_rad: f64,
    /// Offset along the horizontal x and y axes of the yawed gripper, m.
    pub offset_m: [f64; 2],
    /// Height of the gripper's origin above the ground, m; default as above.
    pub height_m: Option<f64>,
    /// Distance between the gel faces at the start, m; default as above.
    pub opening_m: Option<f64>,
    /// Size of the gels, which clear the ground.
    pub pad: GelPad,
}

/// Largest rotation to a stable pose for which that pose is preferred, rad.
const NEAR_STABLE_RAD: f64 = 5.0 * std::f64::consts::PI / 180.0;

/// Returns a stable pose of an object and its index by falling probability: pose `index` if given,
/// else the one nearest to the mesh's own orientation within 5°, else the most probable.
///
/// # Errors
/// `Input` if the index is out of range or there is no stable pose.
pub fn resting_pose(mesh: &TriangleMesh, index: Option<usize>) -> Result<(usize, StablePose)> {
    let poses = stable_poses(mesh, 0.0)?;
    let nearest = || nearest_pose(&poses, NEAR_STABLE_RAD);
    let index = index.or_else(nearest).unwrap_or(0);
    let pose = poses.get(index).ok_or_else(|| {
        Error::input(format!(
            "stable pose {index} not found: the object has {} (0 to {})",
            poses.len(),
            poses.len().saturating_sub(1)
        ))
        .remedy("pass a smaller --stable-pose, or --pose with t_world_object")
    })?;
    Ok((index, *pose))
}

/// Gripper pose and opening at the start of a grasp.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct GripperState {
    /// Pose of the gripper in the world.
    pub t_world_gripper: Pose,
    /// Distance between the gel faces, m.
    pub opening_m: f64,
}

impl Placement {
    /// Places the gripper relative to an object.
    ///
    /// # Errors
    /// `Input` for a number that is not finite.
    pub fn place(&self, mesh: &TriangleMesh, t_world_object: &Pose) -> Result<GripperState> {
        self.validate()?;
        let points = || mesh.all_corners().flatten();
        let bounds = Aabb::from_points(points().map(|v| t_world_object.transform_point(v)));
        let yaw = DQuat::from_rotation_z(self.yaw_rad);
        let down = DQuat::from_mat3(&DMat3::from_cols(DVec3::X, DVec3::NEG_Y, DVec3::NEG_Z));
        let rotation = yaw
            * down
            * DQuat::from_rotation_y(self.roll_rad)
            * DQuat::from_rotation_x(self.pitch_rad);
        let [along, across] = self.offset_m;
        let mut origin = bounds.center() + yaw * (DVec3::X * along + DVec3::NEG_Y * across);
        let closing = rotation * DVec3::X;
        origin.z = self.height_m.unwrap_or(origin.z);
        let opening = |origin: DVec3| {
            let points = points().map(|v| t_world_object.transform_point(v));
            self.opening_m
                .unwrap_or_else(|| clear_opening(points, origin, closing))
        };
        let mut opening_m = opening(origin);
        if self.height_m.is_none() {
            let raise = |z: f64, opening_m: f64| {
                let lowest = lowest_height(rotation, self.pad.pair_half_m(opening_m));
                z.max(lowest + GROUND_CLEARANCE_M)
            };
            origin.z = raise(origin.z, opening_m);
            // With roll, a higher gripper reaches further across.
            opening_m = opening(origin);
            origin.z = raise(origin.z, opening_m);
        }
        Ok(GripperState {
            t_world_gripper: Pose::new(rotation, origin),
            opening_m,
        })
    }

    /// Places a gripper that opens up to `max_opening_m`. If the object is too wide for it and
    /// `may_turn`, the gripper is turned by 90° about the vertical where that fits; then also
    /// returns a warning.
    ///
    /// # Errors
    /// As [`place`](Self::place); `Input` if the object is too wide.
    pub fn place_within(
        &self,
        mesh: &TriangleMesh,
        t_world_object: &Pose,
        max_opening_m: f64,
        may_turn: bool,
    ) -> Result<(GripperState, Option<String>)> {
        let placed = self.place(mesh, t_world_object)?;
        if placed.opening_m <= max_opening_m {
            return Ok((placed, None));
        }
        if self.opening_m.is_none() && may_turn {
            let turned = Self {
                yaw_rad: self.yaw_rad + FRAC_PI_2,
                ..*self
            };
            let turned = turned.place(mesh, t_world_object)?;
            if turned.opening_m <= max_opening_m {
                let warning = format!(
                    "the gripper is turned by 90°: the object is {:.1} mm wide along x, the \
                     gripper opens to {} mm",
                    1e3 * (placed.opening_m - 2.0 * SIDE_CLEARANCE_M),
                    millimetres(max_opening_m)
                );
                return Ok((turned, Some(warning)));
            }
        }
        let clearance_m = if self.opening_m.is_some() {
            0.0
        } else {
            SIDE_CLEARANCE_M
        };
        check_opening(placed.opening_m, clearance_m, max_opening_m)?;
        Ok((placed, None))
    }

    fn validate(&self) -> Result<()> {
        let [along, across] = self.offset_m;
        let numbers = [
            ("--yaw-deg", self.yaw_rad),
            ("--roll-deg", self.roll_rad),
            ("--pitch-deg", self.pitch_rad),
            ("--offset-x", along),
            ("--offset-y", across),
            ("--height", self.height_m.unwrap_or(0.0)),
        ];
        for (flag, value) in numbers {
            if !value.is_finite() {
                return Err(Error::input(format!(
                    "`{flag}` must be a finite number, found {value}"
                )));
            }
        }
        Ok(())
    }
}

/// Checks that the gripper opens as far as a grasp needs: `clearance_m` beyond the object on each
/// side, or a given opening with a clearance of 0.
fn check_opening(opening_m: f64, clearance_m: f64, max_opening_m: f64) -> Result<()> {
    if opening_m <= max_opening_m {
        return Ok(());
    }
    let limit = millimetres(max_opening_m);
    let what = if clearance_m > 0.0 {
        format!(
            "the object is {:.1} mm wide where the fingers close, and needs {} mm of clearance on \
             each side: wider than the gripper's {limit} mm",
            1e3 * (opening_m - 2.0 * clearance_m),
            millimetres(clearance_m)
        )
    } else {
        format!(
            "the opening of {} mm is wider than the gripper's {limit} mm",
            millimetres(opening_m)
        )
    };
    Err(Error::input(what).remedy(
        "turn the gripper (--yaw-deg), lay the object on another side (--stable-pose), scale it \
         (--scale), or name a gripper that opens further (--max-opening)",
    ))
}

/// A length in millimetres without trailing zeros.
fn millimetres(length_m: f64) -> f64 {
    (1e6 * length_m).round() / 1e3
}

/// Opening that leaves [`SIDE_CLEARANCE_M`] between the points and each gel, m.
fn clear_opening(points: impl Iterator<Item = DVec3>, origin: DVec3, closing: DVec3) -> f64 {
    let reach = points.map(|p| (p - origin).dot(closing).abs());
    2.0 * (reach.fold(0.0, f64::max) + SIDE_CLEARANCE_M)
}

/// Height of the gripper's origin at which a gel touches the ground, m; `half` (m) is that of the
/// box around both gels.
fn lowest_height(rotation: DQuat, half: DVec3) -> f64 {
    // The lowest corner of the box around both gels is a corner of a gel.
    DMat3::from_quat(rotation)
        .transpose()
        .z_axis
        .abs()
        .dot(half)
}

/// A recorded grasp pose, as in `--pose FILE`:
/// `{"t_object_gripper": {"t_m", "q_wxyz"}, "t_world_object": …, "opening_m": …}`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GraspPose {
    /// Pose of the gripper in the frame of the object's mesh.
    pub t_object_gripper: Pose,
    /// Pose of the object on the ground; a stable pose if missing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub t_world_object: Option<Pose>,
    /// Distance between the gel faces at the start, m; the object's width plus 2 mm if missing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub opening_m: Option<f64>,
}

impl GraspPose {
    /// Parses the JSON of a pose file.
    ///
    /// # Errors
    /// `Input`, with the position of the error and an example.
    pub fn from_json(text: &str) -> Result<Self> {
        serde_json::from_str(text).map_err(|e| {
            Error::input("invalid grasp pose").because(e).remedy(
                "write {\"t_object_gripper\": {\"t_m\": [x, y, z], \"q_wxyz\": [w, x, y, z]}}, \
                     optionally with \"t_world_object\" and \"opening_m\"",
            )
        })
    }

    /// Gripper state in the world for an object at `t_world_object`.
    pub fn place(&self, mesh: &TriangleMesh, t_world_object: &Pose) -> GripperState {
        let closing = self.t_object_gripper.rotation * DVec3::X;
        let origin = self.t_object_gripper.translation_m;
        let points = mesh.all_corners().flatten();
        GripperState {
            t_world_gripper: *t_world_object * self.t_object_gripper,
            opening_m: self
                .opening_m
                .unwrap_or_else(|| clear_opening(points, origin, closing)),
        }
    }

    /// As [`place`](Self::place), with a gripper that opens up to `max_opening_m`.
    ///
    /// # Errors
    /// `Input` if the pose needs a wider opening.
    pub fn place_within(
        &self,
        mesh: &TriangleMesh,
        t_world_object: &Pose,
        max_opening_m: f64,
    ) -> Result<GripperState> {
        let placed = self.place(mesh, t_world_object);
        let clearance_m = self.opening_m.map_or(SIDE_CLEARANCE_M, |_| 0.0);
        check_opening(placed.opening_m, clearance_m, max_opening_m)?;
        Ok(placed)
    }
}

/// Height of a placed object's lowest point above the ground (z = 0), m.
pub fn height_above_ground(mesh: &TriangleMesh, t_world_object: &Pose) -> f64 {
    let points = mesh.all_corners().flatten();
    let heights = points.map(|v| t_world_object.transform_point(v).z);
    heights.fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_geometry::builtin;

    fn on_ground(mesh: &TriangleMesh) -> Pose {
        Pose::from_translation(DVec3::Z * -mesh.bounds().min.z)
    }

    #[test]
    fn default_grasp_is_vertical_at_mid_height() {
        let mesh = builtin("box").unwrap();
        let placed = Placement::default()
            .place(&mesh, &on_ground(&mesh))
            .unwrap();
        let axes = placed.t_world_gripper.rotation_matrix();
        assert!((axes.z_axis - DVec3::NEG_Z).length() < 1e-12);
        assert!((axes.x_axis - DVec3::X).length() < 1e-12);
        assert!((placed.t_world_gripper.translation_m - DVec3::Z * 0.03).length() < 1e-12);
        assert!((placed.opening_m - 0.042).abs() < 1e-12);
    }

    #[test]
    fn gels_clear_the_ground_at_low_objects() {
        let mesh = builtin("sphere").unwrap().scaled(0.4);
        let placed = Placement::default()
            .place(&mesh, &on_ground(&mesh))
            .unwrap();
        assert!((placed.t_world_gripper.translation_m.z - 0.013).abs() < 1e-12);
        let rolled = Placement {
            roll_rad: 0.3,
            ..Placement::default()
        };
        let placed = rolled.place(&mesh, &on_ground(&mesh)).unwrap();
        let half = 0.5 * placed.opening_m + 0.004;
        let lowest =
            placed.t_world_gripper.translation_m.z - (0.0125 * 0.3f64.cos() + half * 0.3f64.sin());
        assert!((lowest - 5e-4).abs() < 1e-9, "{lowest}");
    }

    #[test]
    fn yaw_and_offset_widen_the_opening() {
        let mesh = builtin("box").unwrap();
        let placement = Placement {
            yaw_rad: 30f64.to_radians(),
            offset_m: [0.005, 0.002],
            ..Placement::default()
        };
        let placed = placement.place(&mesh, &on_ground(&mesh)).unwrap();
        let reach = 0.02 * (30f64.to_radians().cos() + 0.5);
        assert!((placed.opening_m - 2.0 * (reach + 0.005 + 1e-3)).abs() < 1e-9);
        let shift = placed.t_world_gripper.rotation.conjugate()
            * (placed.t_world_gripper.translation_m - DVec3::Z * 0.03);
        assert!((shift - DVec3::new(0.005, 0.002, 0.0)).length() < 1e-12);
    }

    #[test]
    fn wide_object_turns_the_gripper_or_is_refused() {
        let mut mesh = builtin("box").unwrap();
        let place = |mesh: &TriangleMesh, placement: Placement, may_turn| {
            placement.place_within(mesh, &on_ground(mesh), GRIPPER_OPENING_M, may_turn)
        };
        let (placed, warning) = place(&mesh, Placement::default(), true).unwrap();
        assert!((placed.opening_m - 0.042).abs() < 1e-12 && warning.is_none());
        for v in &mut mesh.vertices {
            v.x *= 3.0;
        }
        let (placed, warning) = place(&mesh, Placement::default(), true).unwrap();
        assert!((placed.opening_m - 0.042).abs() < 1e-12);
        let closing = placed.t_world_gripper.rotation * DVec3::X;
        assert!(closing.y.abs() > 1.0 - 1e-12);
        let warning = warning.unwrap();
        assert!(
            warning.contains("120.0 mm") && warning.contains("90 mm"),
            "{warning}"
        );
        // A yaw of the user's own is kept.
        let error = place(&mesh, Placement::default(), false).unwrap_err();
        let text = error.to_string();
        assert!(
            text.contains("120.0 mm") && text.contains("gripper's 90 mm"),
            "{text}"
        );
        assert!(text.contains("--max-opening"), "{text}");
        let given = Placement {
            opening_m: Some(0.1),
            ..Placement::default()
        };
        let text = place(&mesh, given, true).unwrap_err().to_string();
        assert!(text.contains("opening of 100 mm"), "{text}");
        let wide = Placement::default().place_within(&mesh, &on_ground(&mesh), 0.13, true);
        assert!(wide.unwrap().1.is_none());
        for v in &mut mesh.vertices {
            v.y *= 3.0;
        }
        let text = place(&mesh, Placement::default(), true)
            .unwrap_err()
            .to_string();
        assert!(text.contains("wider than the gripper's 90 mm"), "{text}");
        let pose = GraspPose {
            t_object_gripper: Pose::IDENTITY,
            t_world_object: None,
            opening_m: None,
        };
        let text = pose.place_within(&mesh, &Pose::IDENTITY, GRIPPER_OPENING_M);
        assert!(text.unwrap_err().to_string().contains("120.0 mm"));
    }

    #[test]
    fn resting_pose_keeps_stable_orientations() {
        for name in ["box", "mug", "wedge", "sphere"] {
            let (_, pose) = resting_pose(&builtin(name).unwrap(), None).unwrap();
            assert!(pose.t_world_object.rotation.w > 0.999, "{name}");
        }
        let (index, pose) = resting_pose(&builtin("spike").unwrap(), None).unwrap();
        assert_eq!(index, 0);
        assert!(
            pose.t_world_object.rotation.w < 0.99,
            "it falls off its tip"
        );
        let (_, lying) = resting_pose(&builtin("bar").unwrap(), Some(0)).unwrap();
        assert!(lying.t_world_object.rotation.w < 0.9);
        let error = resting_pose(&builtin("bar").unwrap(), Some(6)).unwrap_err();
        assert!(error.to_string().contains("has 6 (0 to 5)"), "{error}");
    }

    #[test]
    fn recorded_pose_is_relative_to_the_object() {
        let mesh = builtin("box").unwrap();
        let text = r#"{"t_object_gripper": {"t_m": [0, 0, 0.01], "q_wxyz": [0, 1, 0, 0]}}"#;
        let pose = GraspPose::from_json(text).unwrap();
        let placed = pose.place(&mesh, &on_ground(&mesh));
        assert!((placed.t_world_gripper.translation_m.z - 0.04).abs() < 1e-12);
        assert!((placed.opening_m - 0.042).abs() < 1e-12);
    }

    #[test]
    fn invalid_pose_files_and_angles_are_rejected() {
        let text = r#"{"t_object_griper": {"t_m": [0, 0, 0], "q_wxyz": [1, 0, 0, 0]}}"#;
        let error = GraspPose::from_json(text).unwrap_err().to_string();
        assert!(
            error.contains("t_object_griper") && error.contains("q_wxyz"),
            "{error}"
        );
        let text = r#"{"t_object_gripper": {"t_m": [0, 0, 0], "q_wxyz": [2, 0, 0, 0]}}"#;
        assert!(GraspPose::from_json(text).is_err());
        let bad = Placement {
            yaw_rad: f64::NAN,
            ..Placement::default()
        };
        let mesh = builtin("box").unwrap();
        let error = bad.place(&mesh, &Pose::IDENTITY).unwrap_err().to_string();
        assert!(error.contains("--yaw-deg"), "{error}");
    }
}
