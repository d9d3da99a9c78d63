//! Intersection of two surfaces, independent of the contact code that it checks.

use glam::DVec3;

use gripcast_geometry::{Aabb, Bvh, TriangleMesh};

/// Whether a triangle of one surface intersects a triangle of the other.
pub(super) fn surfaces_intersect(a: &TriangleMesh, b: &TriangleMesh) -> bool {
    edges_pierce(a, b) || edges_pierce(b, a)
}

/// Whether an edge of `lines` pierces a triangle of `faces`.
fn edges_pierce(lines: &TriangleMesh, faces: &TriangleMesh) -> bool {
    let tree = Bvh::build(&faces.triangle_bounds());
    let edges = lines.edges();
    edges.vertices.iter().any(|edge| {
        let [p, q] = edge.map(|v| lines.vertices[v as usize]);
        let mut found = false;
        tree.for_each_overlap(&Aabb::from_points([p, q]), |triangle| {
            let corners = faces.corners(faces.triangles[triangle as usize]);
            found |= pierces(p, q, corners);
        });
        found
    })
}

/// Whether a segment pierces a triangle, by the signs of volumes.
fn pierces(p: DVec3, q: DVec3, [a, b, c]: [DVec3; 3]) -> bool {
    let normal = (b - a).cross(c - a);
    let (above, below) = (normal.dot(p - a), normal.dot(q - a));
    if above * below > 0.0 || above == below {
        return false;
    }
    let side = |from: DVec3, to: DVec3| (q - p).dot((from - p).cross(to - p));
    let sides = [side(a, b), side(b, c), side(c, a)];
    sides.iter().all(|s| *s >= 0.0) || sides.iter().all(|s| *s <= 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_geometry::{Pose, builtin};

    #[test]
    fn spheres_intersect_below_their_diameter() {
        let sphere = builtin("sphere").unwrap();
        let at = |x: f64| sphere.transformed(&Pose::from_translation(DVec3::new(x, 0.003, 0.002)));
        assert!(surfaces_intersect(&sphere, &at(0.049)));
        assert!(!surfaces_intersect(&sphere, &at(0.051)));
        assert!(!surfaces_intersect(&sphere, &sphere.scaled(0.9)));
    }

    #[test]
    fn spike_through_a_face_is_detected() {
        let (spike, plate) = (builtin("spike").unwrap(), builtin("bar").unwrap());
        let at = |x: f64| spike.transformed(&Pose::from_translation(DVec3::X * x));
        for x in [0.024, -0.024] {
            assert!(surfaces_intersect(&plate, &at(x)) && surfaces_intersect(&at(x), &plate));
        }
        assert!(!surfaces_intersect(&plate, &at(0.026)));
    }
}
