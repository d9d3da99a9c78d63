//! Object size as in the paper's prompt.

use glam::{DVec2, DVec3};

use gripcast_base::error::Result;
use gripcast_geometry::{TriangleMesh, convex_hull};

/// Maximum hull faces that are tried; round objects have thousands of similar ones.
const MAX_FACES: usize = 256;

/// Returns the sides of the oriented bounding box, m, longest first: the box of minimum volume
/// among those that lie on one of the 256 largest faces of the convex hull and along one side of
/// the hull's projection onto that face.
///
/// # Errors
/// `Input` for a mesh that encloses no volume.
pub fn oriented_size_m(mesh: &TriangleMesh) -> Result<[f64; 3]> {
    let hull = convex_hull(&mesh.vertices)?;
    let areas = hull.triangle_areas();
    let mut faces: Vec<usize> = (0..areas.len()).collect();
    faces.sort_by(|&a, &b| areas[b].total_cmp(&areas[a]).then(a.cmp(&b)));
    let boxes = faces.iter().take(MAX_FACES).filter_map(|&face| {
        let [a, b, c] = hull.corners(hull.triangles[face]);
        let normal = (b - a).cross(c - a).try_normalize()?;
        Some(box_on_face(&hull.vertices, normal))
    });
    let volume = |sides: &[f64; 3]| sides.iter().product::<f64>();
    let smallest = boxes.min_by(|a, b| volume(a).total_cmp(&volume(b)));
    let mut sides = smallest.unwrap_or_else(|| mesh.bounds().extent().to_array());
    sides.sort_by(|a, b| b.total_cmp(a));
    Ok(sides)
}

/// Sides of the smallest box with one side along `normal`, m.
fn box_on_face(points: &[DVec3], normal: DVec3) -> [f64; 3] {
    let (u, v) = normal.any_orthonormal_pair();
    let projection = outline(
        points
            .iter()
            .map(|p| DVec2::new(p.dot(u), p.dot(v)))
            .collect(),
    );
    let next = projection.iter().cycle().skip(1);
    let sizes = projection.iter().zip(next).filter_map(|(a, b)| {
        let along = (*b - *a).try_normalize()?;
        Some([
            extent(&projection, |p| p.dot(along)),
            extent(&projection, |p| p.perp_dot(along)),
        ])
    });
    let smallest = sizes.min_by(|a, b| (a[0] * a[1]).total_cmp(&(b[0] * b[1])));
    let [width, depth] = smallest.unwrap_or_default();
    [width, depth, extent(points, |p| p.dot(normal))]
}

fn extent<T: Copy>(points: &[T], along: impl Fn(T) -> f64) -> f64 {
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for &point in points {
        low = low.min(along(point));
        high = high.max(along(point));
    }
    (high - low).max(0.0)
}

/// Corners of the planar convex hull, counter-clockwise (Andrew's monotone chain).
fn outline(mut points: Vec<DVec2>) -> Vec<DVec2> {
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    points.dedup();
    let mut corners = half(points.iter());
    corners.extend(half(points.iter().rev()));
    corners
}

/// One half of the hull of sorted points, without its last point.
fn half<'a>(points: impl Iterator<Item = &'a DVec2>) -> Vec<DVec2> {
    let mut chain: Vec<DVec2> = Vec::new();
    for &point in points {
        while let [.., a, b] = chain.as_slice()
            && (*b - *a).perp_dot(point - *b) <= 0.0
        {
            chain.pop();
        }
        chain.push(point);
    }
    chain.pop();
    chain
}

#[cfg(test)]
mod tests {
    use glam::DQuat;

    use super::*;
    use gripcast_geometry::{Pose, builtin};

    #[test]
    fn rotated_box_keeps_its_size() {
        let mesh = builtin("box").unwrap();
        for rotation in [
            DVec3::ZERO,
            DVec3::new(0.3, -0.7, 1.1),
            DVec3::new(0.0, 0.0, 0.785),
        ] {
            let rotated = mesh.transformed(&Pose::from_rotation(DQuat::from_scaled_axis(rotation)));
            let size = oriented_size_m(&rotated).unwrap();
            for (found, wanted) in size.iter().zip([0.06, 0.04, 0.04]) {
                assert!((found - wanted).abs() < 1e-9, "{size:?}");
            }
        }
    }

    #[test]
    fn round_objects_have_their_diameter() {
        let size = oriented_size_m(&builtin("cylinder").unwrap()).unwrap();
        assert!(
            (size[0] - 0.08).abs() < 1e-9 && (size[2] - 0.05).abs() < 1e-3,
            "{size:?}"
        );
        let size = oriented_size_m(&builtin("ball").unwrap()).unwrap();
        assert!(size.iter().all(|s| (s - 0.05).abs() < 1e-3), "{size:?}");
        assert!(oriented_size_m(&TriangleMesh::default()).is_err());
    }
}
