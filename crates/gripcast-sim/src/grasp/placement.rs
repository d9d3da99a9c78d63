//! Where the gripper stands: from above by a few numbers, or by a recorded pose.

use glam::{DMat3, DQuat, DVec3};
use serde::{Deserialize, Serialize};

use gripcast_base::error::{Error, Result};
use gripcast_geometry::{Aabb, Pose, StablePose, TriangleMesh, stable_poses};

/// Free space that is left between the object and each gel, m.
const SIDE_CLEARANCE_M: f64 = 1e-3;
/// Free space that is left between the gels and the ground, m.
const GROUND_CLEARANCE_M: f64 = 5e-4;
/// Half of the gel along the approach and across, and its thickness, m.
const GEL_M: [f64; 3] = [0.0125, 0.010, 0.004];

/// A grasp from above, relative to the object as it lies.
///
/// All zero or none: the gripper's z axis points down and its x axis along the world's, its origin
/// is the middle of the object's bounding box, but high enough for the gels to clear the ground,
/// and it is open by the width of the object and 1 mm on each side.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Placement {
    /// Turn about the world's z axis, rad.
    pub yaw_rad: f64,
    /// Turn about the gripper's y axis, rad: one finger higher than the other.
    pub tilt_rad: f64,
    /// Turn about the gripper's x axis, rad: the approach leaves the vertical.
    pub lean_rad: f64,
    /// Shift along the turned gripper's horizontal x and y axes, m.
    pub offset_m: [f64; 2],
    /// Height of the gripper's origin above the ground, m.
    pub height_m: Option<f64>,
    /// Distance between the gels' faces at the start, m.
    pub opening_m: Option<f64>,
}

/// An object that lies this close to a stable pose already is put into that one, rad.
const NEAR_STABLE_RAD: f64 = 5.0 * std::f64::consts::PI / 180.0;

/// The stable pose of an object, and its number by falling probability: number `wanted`, else the
/// one nearest to how the mesh stands if that is within 5°, else the most probable.
///
/// # Errors
/// `Input` if there is no such pose, or none at all.
pub fn resting_pose(mesh: &TriangleMesh, wanted: Option<usize>) -> Result<(usize, StablePose)> {
    let poses = stable_poses(mesh, 0.0)?;
    let turn = |pose: &StablePose| 2.0 * pose.t_world_object.rotation.w.abs().min(1.0).acos();
    let nearest = || {
        let all = poses.iter().map(turn).enumerate();
        all.filter(|(_, turn)| *turn < NEAR_STABLE_RAD)
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .map(|(index, _)| index)
    };
    let index = wanted.or_else(nearest).unwrap_or(0);
    let pose = poses.get(index).ok_or_else(|| {
        Error::input(format!(
            "there is no stable pose {index}: the object has {} (0 to {})",
            poses.len(),
            poses.len().saturating_sub(1)
        ))
        .remedy("pass a smaller --stable-pose, or --pose with t_world_object")
    })?;
    Ok((index, *pose))
}

/// Where the gripper stands.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Placed {
    /// The gripper in the world.
    pub t_world_gripper: Pose,
    /// Distance between the gels' faces, m.
    pub opening_m: f64,
}

impl Placement {
    /// Places the gripper at an object.
    ///
    /// # Errors
    /// `Input` where a number is not finite.
    pub fn place(&self, mesh: &TriangleMesh, t_world_object: &Pose) -> Result<Placed> {
        self.validate()?;
        let points = || mesh.all_corners().flatten();
        let bounds = Aabb::from_points(points().map(|v| t_world_object.transform_point(v)));
        let turn = DQuat::from_rotation_z(self.yaw_rad);
        let down = DQuat::from_mat3(&DMat3::from_cols(DVec3::X, DVec3::NEG_Y, DVec3::NEG_Z));
        let rotation = turn
            * down
            * DQuat::from_rotation_y(self.tilt_rad)
            * DQuat::from_rotation_x(self.lean_rad);
        let [along, across] = self.offset_m;
        let mut origin = bounds.center() + turn * (DVec3::X * along + DVec3::NEG_Y * across);
        let closing = rotation * DVec3::X;
        origin.z = self.height_m.unwrap_or(origin.z);
        let width = |origin: DVec3| {
            let reach = points()
                .map(|v| {
                    (t_world_object.transform_point(v) - origin)
                        .dot(closing)
                        .abs()
                })
                .fold(0.0, f64::max);
            self.opening_m.unwrap_or(2.0 * (reach + SIDE_CLEARANCE_M))
        };
        let mut opening_m = width(origin);
        if self.height_m.is_none() {
            origin.z = origin
                .z
                .max(lowest_height(rotation, opening_m) + GROUND_CLEARANCE_M);
            // Tilted fingers reach further where they stand higher.
            opening_m = width(origin);
            origin.z = origin
                .z
                .max(lowest_height(rotation, opening_m) + GROUND_CLEARANCE_M);
        }
        Ok(Placed {
            t_world_gripper: Pose::new(rotation, origin),
            opening_m,
        })
    }

    fn validate(&self) -> Result<()> {
        let [along, across] = self.offset_m;
        let numbers = [
            ("--yaw-deg", self.yaw_rad),
            ("--roll-deg", self.tilt_rad),
            ("--pitch-deg", self.lean_rad),
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

/// Height of the gripper's origin at which its gels touch the ground, m.
fn lowest_height(rotation: DQuat, opening_m: f64) -> f64 {
    let [z, y, thickness] = GEL_M;
    let half = DVec3::new(0.5 * opening_m + thickness, y, z);
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
    /// The gripper in the frame of the object's mesh.
    pub t_object_gripper: Pose,
    /// The object on the ground; a stable pose where missing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub t_world_object: Option<Pose>,
    /// Distance between the gels' faces at the start, m; the object's width and 2 mm where missing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub opening_m: Option<f64>,
}

impl GraspPose {
    /// Parses the JSON of a pose file.
    ///
    /// # Errors
    /// `Input` with the place of the mistake and an example.
    pub fn from_json(text: &str) -> Result<Self> {
        serde_json::from_str(text).map_err(|e| {
            Error::input("this is no grasp pose").because(e).remedy(
                "write {\"t_object_gripper\": {\"t_m\": [x, y, z], \"q_wxyz\": [w, x, y, z]}}, \
                     optionally with \"t_world_object\" and \"opening_m\"",
            )
        })
    }

    /// Places the gripper at the object, which stands at `t_world_object`.
    pub fn place(&self, mesh: &TriangleMesh, t_world_object: &Pose) -> Placed {
        let closing = self.t_object_gripper.rotation * DVec3::X;
        let origin = self.t_object_gripper.translation_m;
        let reach = mesh
            .all_corners()
            .flatten()
            .map(|v| (v - origin).dot(closing).abs())
            .fold(0.0, f64::max);
        Placed {
            t_world_gripper: *t_world_object * self.t_object_gripper,
            opening_m: self.opening_m.unwrap_or(2.0 * (reach + SIDE_CLEARANCE_M)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_geometry::builtin;

    fn on_ground(mesh: &TriangleMesh) -> Pose {
        Pose::from_translation(DVec3::Z * -mesh.bounds().min.z)
    }

    #[test]
    fn from_above_at_mid_height() {
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
    fn low_objects_leave_the_gels_above_the_ground() {
        let mesh = builtin("sphere").unwrap().scaled(0.4);
        let placed = Placement::default()
            .place(&mesh, &on_ground(&mesh))
            .unwrap();
        assert!((placed.t_world_gripper.translation_m.z - 0.013).abs() < 1e-12);
        let tilted = Placement {
            tilt_rad: 0.3,
            ..Placement::default()
        };
        let placed = tilted.place(&mesh, &on_ground(&mesh)).unwrap();
        let half = 0.5 * placed.opening_m + 0.004;
        let lowest =
            placed.t_world_gripper.translation_m.z - (0.0125 * 0.3f64.cos() + half * 0.3f64.sin());
        assert!((lowest - 5e-4).abs() < 1e-9, "{lowest}");
    }

    #[test]
    fn turns_and_shifts_widen_the_opening() {
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
    fn objects_rest_as_they_stand_where_that_is_stable() {
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
    fn a_recorded_pose_is_relative_to_the_object() {
        let mesh = builtin("box").unwrap();
        let text = r#"{"t_object_gripper": {"t_m": [0, 0, 0.01], "q_wxyz": [0, 1, 0, 0]}}"#;
        let pose = GraspPose::from_json(text).unwrap();
        let placed = pose.place(&mesh, &on_ground(&mesh));
        assert!((placed.t_world_gripper.translation_m.z - 0.04).abs() < 1e-12);
        assert!((placed.opening_m - 0.042).abs() < 1e-12);
    }

    #[test]
    fn misspelt_pose_files_are_explained() {
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
