//! Converts poses of the Panda's hand to poses of our gripper.

use glam::{DMat3, DMat4, DVec3, DVec4};

use gripcast_geometry::Pose;

/// Distance along z from the origin of the Panda's hand to its tool centre point, m: `tcp_xyz` in
/// Franka's robot description. The fingertips end 8.8 mm further, at 112.2 mm. The origin of our
/// gripper, midway between the gel faces, is placed there.
pub const PANDA_GEL_CENTER_M: f64 = 0.1034;

/// Maximum deviation of RᵀR from the identity, and of the last row, due to rounding.
const RIGID_TOLERANCE: f64 = 1e-3;
/// Maximum distance of a grasp from the origin of its object, m.
const MAX_M: f64 = 10.0;

/// A grasp of an object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AcronymGrasp {
    /// Index in the file.
    pub number: usize,
    /// Pose of our gripper frame (x closing, z approach, origin midway between the gel faces) in
    /// the frame of the scaled mesh.
    pub t_object_gripper: Pose,
    /// Result of ACRONYM's simulation, with its own mass and friction: stable or slip.
    pub stable: bool,
}

/// A grasp that cannot be used.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SkippedGrasp {
    /// Index in the file.
    pub number: usize,
    /// Why it is skipped.
    pub reason: String,
}

/// Converts the hand's homogeneous matrix (row-major, in the object's frame) to a gripper pose.
///
/// # Errors
/// The reason: numbers that are not finite, not a rotation, a translation above 10 m.
pub(super) fn gripper_pose(matrix: &[f64]) -> Result<Pose, String> {
    if let Some(bad) = matrix.iter().find(|v| !v.is_finite()) {
        return Err(format!("its matrix has {bad}"));
    }
    let Ok(matrix) = <&[f64; 16]>::try_from(matrix) else {
        return Err(format!("its matrix has {} numbers, not 16", matrix.len()));
    };
    let t = DMat4::from_cols_array(matrix).transpose();
    let last_row = t.row(3);
    if (last_row - DVec4::W).abs().max_element() > RIGID_TOLERANCE {
        return Err(format!("its last row is {last_row}, not [0, 0, 0, 1]"));
    }
    let rotation = DMat3::from_mat4(t);
    let gram = rotation.transpose() * rotation - DMat3::IDENTITY;
    let deviation = gram
        .to_cols_array()
        .iter()
        .fold(0.0_f64, |m, v| m.max(v.abs()));
    if deviation > RIGID_TOLERANCE {
        return Err(format!(
            "its axes are not orthonormal (off by {deviation:.2e})"
        ));
    }
    if rotation.determinant() < 0.0 {
        return Err("its axes are left-handed".to_owned());
    }
    let translation = t.w_axis.truncate();
    if translation.length() > MAX_M {
        return Err(format!(
            "it is {:.1} m away from the object",
            translation.length()
        ));
    }
    let t_object_hand = Pose::new(glam::DQuat::from_mat3(&rotation), translation);
    Ok(t_object_hand * Pose::from_translation(DVec3::new(0.0, 0.0, PANDA_GEL_CENTER_M)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Hand above the object, approaching downwards, closing along the object's y.
    const ABOVE: [f64; 16] = [
        0.0, 1.0, 0.0, 0.01, //
        1.0, 0.0, 0.0, 0.02, //
        0.0, 0.0, -1.0, 0.1534, //
        0.0, 0.0, 0.0, 1.0,
    ];

    #[test]
    fn gel_center_lies_in_front_of_the_hand() {
        let pose = gripper_pose(&ABOVE).unwrap();
        let near = |a: DVec3, b: DVec3| assert!(a.distance(b) < 1e-12, "{a} {b}");
        near(pose.translation_m, DVec3::new(0.01, 0.02, 0.05));
        near(pose.transform_vector(DVec3::X), DVec3::Y);
        near(pose.transform_vector(DVec3::Z), -DVec3::Z);
        // The marker's tips, in our frame: 41 mm to either side, 8.8 mm ahead.
        let tip_hand = DVec3::new(0.041, 0.0, 0.11217);
        let tip_object = DVec3::new(0.01, 0.02 + 0.041, 0.1534 - 0.11217);
        let tip_gripper = pose.inverse().transform_point(tip_object);
        near(tip_gripper, tip_hand - DVec3::Z * PANDA_GEL_CENTER_M);
    }

    #[test]
    fn non_rigid_matrices_are_refused() {
        let with = |changes: &[(usize, f64)]| {
            let mut matrix = ABOVE;
            for &(i, value) in changes {
                matrix[i] = value;
            }
            gripper_pose(&matrix).unwrap_err()
        };
        assert!(with(&[(3, f64::NAN)]).contains("NaN"));
        assert!(with(&[(0, f64::INFINITY)]).contains("inf"));
        assert!(with(&[(1, 2.0)]).contains("orthonormal"));
        assert!(with(&[(1, 0.0)]).contains("orthonormal"));
        assert!(with(&[(10, 1.0)]).contains("left-handed"));
        assert!(with(&[(15, 0.0)]).contains("last row"));
        assert!(with(&[(3, 1e3)]).contains("away"));
        assert!(gripper_pose(&ABOVE[..12]).unwrap_err().contains("12"));
        // Single precision is fine.
        assert!(gripper_pose(&ABOVE.map(|v| f64::from(v as f32))).is_ok());
    }
}
