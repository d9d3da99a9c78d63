//! Homography from a plane to normalised image coordinates.

use glam::{DMat3, DVec2, DVec3};

use gripcast_base::linear::NormalEquations;

/// Homography from plane coordinates (m) to normalised image coordinates, with h33 = 1: the
/// origin of the plane must be in front of the camera.
///
/// Direct linear transform over normalised points (Hartley, *In defense of the eight-point
/// algorithm*, 1997). `None`: the points do not span the plane.
pub(crate) fn plane_to_image(plane_m: &[DVec2], ideal: &[DVec2]) -> Option<DMat3> {
    let (plane, from_plane) = normalised(plane_m)?;
    let (image, from_image) = normalised(ideal)?;
    let mut equations = NormalEquations::<8>::zero();
    for (p, q) in plane.iter().zip(&image) {
        let (x, y) = (p.x, p.y);
        let row = [x, y, 1.0, 0.0, 0.0, 0.0, -q.x * x, -q.x * y];
        equations.add(&row, q.x, 1.0);
        let row = [0.0, 0.0, 0.0, x, y, 1.0, -q.y * x, -q.y * y];
        equations.add(&row, q.y, 1.0);
    }
    let h = equations.solve()?;
    let normal = DMat3::from_cols(
        DVec3::new(h[0], h[3], h[6]),
        DVec3::new(h[1], h[4], h[7]),
        DVec3::new(h[2], h[5], 1.0),
    );
    let result = from_image.inverse() * normal * from_plane;
    let scale = result.z_axis.z;
    (scale.is_finite() && scale != 0.0).then(|| result * scale.recip())
}

/// Points with centroid 0 and mean distance 1, and the applied transform.
fn normalised(points: &[DVec2]) -> Option<(Vec<DVec2>, DMat3)> {
    let count = points.len() as f64;
    let centre = points.iter().sum::<DVec2>() / count;
    let spread = points.iter().map(|p| p.distance(centre)).sum::<f64>() / count;
    if !(spread.is_finite() && spread > 0.0) {
        return None;
    }
    let scale = spread.recip();
    let map = DMat3::from_cols(
        DVec3::new(scale, 0.0, 0.0),
        DVec3::new(0.0, scale, 0.0),
        (-centre * scale).extend(1.0),
    );
    Some((points.iter().map(|p| (*p - centre) * scale).collect(), map))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_known_homography_is_found() {
        let h = DMat3::from_cols(
            DVec3::new(1.4, 0.1, 0.3),
            DVec3::new(-0.2, 1.2, -0.1),
            DVec3::new(0.05, -0.02, 1.0),
        );
        let plane: Vec<DVec2> = [
            (-0.1, -0.1),
            (0.1, -0.1),
            (0.1, 0.1),
            (-0.1, 0.12),
            (0.05, 0.0),
        ]
        .map(DVec2::from)
        .to_vec();
        let image: Vec<DVec2> = plane
            .iter()
            .map(|p| {
                let q = h * p.extend(1.0);
                q.truncate() / q.z
            })
            .collect();
        let found = plane_to_image(&plane, &image).unwrap();
        for i in 0..3 {
            assert!(found.col(i).distance(h.col(i)) < 1e-9, "{found}");
        }
    }

    #[test]
    fn collinear_points_have_no_homography() {
        let line: Vec<DVec2> = (0..5).map(|i| DVec2::splat(f64::from(i))).collect();
        assert!(plane_to_image(&line, &line).is_none());
        assert!(plane_to_image(&[DVec2::ZERO; 4], &line[..4]).is_none());
    }
}
