//! From matrices of the Panda's hand to poses of our gripper.

use glam::{DMat3, DVec3};

use gripcast_geometry::Pose;

/// From the origin of the Panda's hand along z to the middle between its fingertips, m: `tcp_xyz`
/// of the hand in Franka's robot description, and its nominal end effector. The tips end 8.8 mm
/// further on, at 112.2 mm. The origin of our gripper, midway between the gel faces, is put there.
pub const PANDA_GEL_MIDDLE_M: f64 = 0.1034;

/// Largest deviation of RᵀR from the identity, and of the last row, that is rounding.
const RIGID_TOLERANCE: f64 = 1e-3;
/// No grasp is farther from the origin of its object, m.
const MAX_M: f64 = 10.0;

/// A grasp of an object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AcronymGrasp {
    /// Number in the file.
    pub number: usize,
    /// Pose of our gripper frame (x closing, z approach, origin midway between the gel faces) in
    /// the frame of the scaled mesh.
    pub t_object_gripper: Pose,
    /// Whether the object stayed in the hand in ACRONYM's simulation, with its own mass and
    /// friction.
    pub held: bool,
}

/// A grasp that cannot be used.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SkippedGrasp {
    /// Number in the file.
    pub number: usize,
    /// What is wrong with it.
    pub why: String,
}

/// Pose of our gripper by the hand's homogeneous matrix, row by row, in the object's frame.
///
/// # Errors
/// What is wrong: numbers that are not finite, no rotation, a translation above 10 m.
pub(super) fn gripper_pose(matrix: &[f64]) -> Result<Pose, String> {
    if let Some(bad) = matrix.iter().find(|v| !v.is_finite()) {
        return Err(format!("its matrix has {bad}"));
    }
    let &[
        r00,
        r01,
        r02,
        x,
        r10,
        r11,
        r12,
        y,
        r20,
        r21,
        r22,
        z,
        l0,
        l1,
        l2,
        l3,
    ] = matrix
    else {
        return Err(format!("its matrix has {} numbers, not 16", matrix.len()));
    };
    if [l0, l1, l2, l3 - 1.0]
        .iter()
        .any(|v| v.abs() > RIGID_TOLERANCE)
    {
        return Err(format!(
            "its last row is [{l0}, {l1}, {l2}, {l3}], not [0, 0, 0, 1]"
        ));
    }
    let rotation = DMat3::from_cols(
        DVec3::new(r00, r10, r20),
        DVec3::new(r01, r11, r21),
        DVec3::new(r02, r12, r22),
    );
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
    let translation = DVec3::new(x, y, z);
    if translation.length() > MAX_M {
        return Err(format!(
            "it is {:.1} m away from the object",
            translation.length()
        ));
    }
    let t_object_hand = Pose::new(glam::DQuat::from_mat3(&rotation), translation);
    Ok(t_object_hand * Pose::from_translation(DVec3::new(0.0, 0.0, PANDA_GEL_MIDDLE_M)))
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
    fn the_middle_of_the_gel_lies_in_front_of_the_hand() {
        let pose = gripper_pose(&ABOVE).unwrap();
        let near = |a: DVec3, b: DVec3| assert!(a.distance(b) < 1e-12, "{a} {b}");
        near(pose.translation_m, DVec3::new(0.01, 0.02, 0.05));
        near(pose.transform_vector(DVec3::X), DVec3::Y);
        near(pose.transform_vector(DVec3::Z), -DVec3::Z);
        // The marker's tips, in our frame: 41 mm to either side, 8.8 mm ahead.
        let tip_hand = DVec3::new(0.041, 0.0, 0.11217);
        let tip_object = DVec3::new(0.01, 0.02 + 0.041, 0.1534 - 0.11217);
        let tip_gripper = pose.inverse().transform_point(tip_object);
        near(tip_gripper, tip_hand - DVec3::Z * PANDA_GEL_MIDDLE_M);
    }

    #[test]
    fn matrices_that_are_no_rigid_motion_are_refused() {
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
