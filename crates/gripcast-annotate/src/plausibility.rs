//! Plausibility of a grasp pose.

use glam::DVec3;

use gripcast_geometry::{Aabb, Pose, TriangleMesh};

/// Half extents of a gel along the gripper's y and z, m.
const GEL_HALF_M: [f64; 2] = [0.010, 0.0125];

/// Whether the object overlaps the volume that the gels sweep when they close from `opening_m`. A
/// wrong scale of the board file or a misplaced object displaces the gripper by centimetres.
#[must_use]
pub fn is_between_fingers(mesh: &TriangleMesh, t_object_gripper: &Pose, opening_m: f64) -> bool {
    let [y, z] = GEL_HALF_M;
    let half = DVec3::new(0.5 * opening_m, y, z);
    let swept = Aabb::from_points([-half, half]);
    let in_gripper = mesh.transformed(&t_object_gripper.inverse());
    in_gripper
        .triangle_bounds()
        .iter()
        .any(|bounds| bounds.intersects(&swept))
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_geometry::builtin;

    #[test]
    fn object_of_a_grasp_is_between_the_fingers() {
        let mesh = builtin("box").unwrap();
        let down = glam::DQuat::from_rotation_x(std::f64::consts::PI);
        let at = |offset: DVec3| Pose::new(down, offset);
        let is_grasp = |offset| is_between_fingers(&mesh, &at(offset), 0.08);
        assert!(is_grasp(DVec3::ZERO) && is_grasp(DVec3::new(0.01, 0.02, 0.0)));
        // Beside, above, and displaced by a sheet printed at 90 % seen from 0.65 m.
        assert!(!is_grasp(DVec3::new(0.0, 0.06, 0.0)));
        assert!(!is_grasp(DVec3::new(0.0, 0.0, 0.06)));
        assert!(!is_grasp(0.065 * DVec3::new(0.0, 0.87, 0.5)));
    }
}
