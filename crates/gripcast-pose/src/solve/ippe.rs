//! Infinitesimal plane-based pose estimation (IPPE): the two poses of a plane.
//!
//! T. Collins and A. Bartoli, *Infinitesimal plane-based pose estimation*, International Journal
//! of Computer Vision 109 (2014): the Jacobian of the homography at one point of the plane
//! determines the rotation up to a reflection.

use glam::{DMat3, DQuat, DVec2, DVec3};

use super::homography::plane_to_image;
use gripcast_base::linear::NormalEquations;
use gripcast_geometry::Pose;

/// Maximum distance of points from their plane, relative to their radius.
const FLAT: f64 = 0.02;

/// The two poses `t_camera_body` of coplanar points, unordered; `ideal` are their normalised image
/// coordinates. `None`: the points are not coplanar or do not determine a pose.
pub(super) fn both_poses(points_m: &[DVec3], ideal: &[DVec2]) -> Option<[Pose; 2]> {
    let t_body_plane = plane_of(points_m)?;
    let t_plane_body = t_body_plane.inverse();
    let plane: Vec<DVec2> = points_m
        .iter()
        .map(|p| t_plane_body.transform_point(*p).truncate())
        .collect();
    let h = plane_to_image(&plane, ideal)?;
    let rotations = rotations(&h)?;
    let mut poses = [Pose::IDENTITY; 2];
    for (pose, rotation) in poses.iter_mut().zip(rotations) {
        let translation = translation(&rotation, &plane, ideal)?;
        *pose = Pose::new(DQuat::from_mat3(&rotation), translation) * t_plane_body;
    }
    Some(poses)
}

/// Frame at the centroid of the points with z along their normal, towards the side from which
/// each marker's corners run clockwise. `None`: the points are not coplanar.
fn plane_of(points_m: &[DVec3]) -> Option<Pose> {
    let centre = points_m.iter().sum::<DVec3>() / points_m.len() as f64;
    let extent = points_m
        .iter()
        .map(|p| p.distance(centre))
        .fold(0.0, f64::max);
    let normal: DVec3 = points_m
        .chunks_exact(4)
        .map(|c| (c[3] - c[1]).cross(c[2] - c[0]))
        .sum();
    let z = normal.try_normalize()?;
    let is_flat = points_m
        .iter()
        .all(|p| (*p - centre).dot(z).abs() <= FLAT * extent);
    if !is_flat {
        return None;
    }
    let x = z.any_orthonormal_vector();
    let rotation = DMat3::from_cols(x, z.cross(x), z);
    Some(Pose::new(DQuat::from_mat3(&rotation), centre))
}

/// Section 4.3 of the paper: rotations from the homography at the origin of the plane.
fn rotations(h: &DMat3) -> Option<[DMat3; 2]> {
    // p: image of the origin; the columns of the homography's Jacobian there.
    let p = h.z_axis.truncate();
    let jacobian = [h.x_axis, h.y_axis].map(|c| c.truncate() - c.z * p);
    // Rv rotates the optical axis to the ray through p.
    let ray = p.extend(1.0).normalize();
    let rv = DMat3::from_quat(DQuat::from_rotation_arc(DVec3::Z, ray));
    let projected = |c: DVec3| c.truncate() - c.z * p;
    let b = glam::DMat2::from_cols(projected(rv.x_axis), projected(rv.y_axis));
    if b.determinant().abs() < 1e-12 {
        return None;
    }
    let a = b.inverse() * glam::DMat2::from_cols(jacobian[0], jacobian[1]);
    // The largest singular value of A is the inverse of the distance.
    let aat = a * a.transpose();
    let (trace, gap) = (aat.col(0).x + aat.col(1).y, aat.col(0).x - aat.col(1).y);
    let gamma = (0.5 * (trace + gap.hypot(2.0 * aat.col(1).x))).sqrt();
    if !(gamma.is_finite() && gamma > 0.0) {
        return None;
    }
    let r = a * gamma.recip();
    let c0 = (1.0 - r.col(0).length_squared()).max(0.0).sqrt();
    let mut c1 = (1.0 - r.col(1).length_squared()).max(0.0).sqrt();
    if r.col(0).dot(r.col(1)) > 0.0 {
        c1 = -c1;
    }
    Some([1.0, -1.0].map(|sign| {
        let x = r.col(0).extend(sign * c0);
        let y = r.col(1).extend(sign * c1);
        rv * DMat3::from_cols(x, y, x.cross(y))
    }))
}

/// Least-squares translation of the collinearity equations.
fn translation(rotation: &DMat3, plane: &[DVec2], ideal: &[DVec2]) -> Option<DVec3> {
    let mut equations = NormalEquations::<3>::zero();
    for (p, q) in plane.iter().zip(ideal) {
        let rotated = *rotation * p.extend(0.0);
        equations.add(&[1.0, 0.0, -q.x], q.x * rotated.z - rotated.x, 1.0);
        equations.add(&[0.0, 1.0, -q.y], q.y * rotated.z - rotated.y, 1.0);
    }
    equations.solve().map(DVec3::from_array)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::least_squares::angle_between;

    fn square(half: f64) -> Vec<DVec3> {
        [(-1.0, 1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)]
            .map(|(x, y)| DVec3::new(half * x, half * y, 0.0))
            .to_vec()
    }

    fn project(points: &[DVec3], pose: &Pose) -> Vec<DVec2> {
        points
            .iter()
            .map(|p| {
                let c = pose.transform_point(*p);
                c.truncate() / c.z
            })
            .collect()
    }

    fn facing(tilt: f64, azimuth: f64) -> Pose {
        let axis = DVec3::new(azimuth.cos(), azimuth.sin(), 0.0);
        Pose::new(
            DQuat::from_axis_angle(axis, tilt) * DQuat::from_rotation_x(std::f64::consts::PI),
            DVec3::new(0.06, -0.04, 0.55),
        )
    }

    #[test]
    fn the_poses_are_the_truth_and_its_mirror_image() {
        // The plane is not z = 0.
        let t_body_square = Pose::new(
            DQuat::from_rotation_y(0.6) * DQuat::from_rotation_x(-0.3),
            DVec3::new(0.02, -0.03, 0.1),
        );
        let points: Vec<DVec3> = square(0.015)
            .iter()
            .map(|p| t_body_square.transform_point(*p))
            .collect();
        for (tilt, azimuth) in [(0.3, 0.0), (0.7, 1.0), (0.5, 2.5), (1.0, 4.0)] {
            let t_camera_square = facing(tilt, azimuth);
            let truth = t_camera_square * t_body_square.inverse();
            let poses = both_poses(&points, &project(&points, &truth)).unwrap();
            let mut found = poses.map(|p| angle_between(&p, &truth));
            let best = poses[usize::from(found[1] < found[0])];
            found.sort_by(f64::total_cmp);
            assert!(found[0] < 1e-6, "{tilt} {azimuth}: {found:?}");
            assert!(best.translation_m.distance(truth.translation_m) < 1e-7);
            // The mirror image is tilted to the other side of the viewing ray.
            let ray = t_camera_square.translation_m.normalize();
            let tilt = t_camera_square
                .transform_vector(DVec3::Z)
                .angle_between(-ray);
            assert!(
                (found[1] - 2.0 * tilt).abs() < 0.25 * tilt,
                "{found:?} {tilt}"
            );
        }
    }

    #[test]
    fn coplanar_markers_are_solved_together() {
        let points: Vec<DVec3> = [(-0.1, 0.05), (0.1, 0.06), (0.0, -0.08)]
            .iter()
            .flat_map(|(x, y)| {
                square(0.015)
                    .into_iter()
                    .map(|p| p + DVec3::new(*x, *y, 0.3))
            })
            .collect();
        let truth = facing(0.6, 1.2) * Pose::from_translation(DVec3::new(0.0, 0.0, -0.3));
        let poses = both_poses(&points, &project(&points, &truth)).unwrap();
        assert!(poses.iter().any(|p| angle_between(p, &truth) < 1e-6));
    }

    #[test]
    fn points_that_are_not_coplanar_have_no_pose() {
        let mut points = square(0.015);
        points.extend(square(0.015).iter().map(|p| *p + DVec3::Z * 0.02));
        let ideal = project(&points, &facing(0.5, 0.0));
        assert!(both_poses(&points, &ideal).is_none());
        assert!(both_poses(&[DVec3::ZERO; 4], &[DVec2::ZERO; 4]).is_none());
    }
}
