//! Merges coincident vertices.

use super::aabb::Aabb;
use super::bvh::Bvh;
use super::mesh::TriangleMesh;

/// Copy in which vertices at most `tolerance_m` apart, directly or through a chain, are merged into
/// the first of them. Triangles may become degenerate; unused vertices are removed.
pub(super) fn weld(mesh: &TriangleMesh, tolerance_m: f64) -> TriangleMesh {
    let first = if tolerance_m > 0.0 {
        first_within(mesh, tolerance_m)
    } else {
        first_coincident(mesh)
    };
    TriangleMesh {
        vertices: mesh.vertices.clone(),
        triangles: mesh
            .triangles
            .iter()
            .map(|t| t.map(|v| first[v as usize]))
            .collect(),
    }
    .without_unused_vertices()
}

/// For each vertex, the first one with the same coordinates.
pub(super) fn first_coincident(mesh: &TriangleMesh) -> Vec<u32> {
    // Adding zero turns −0 into 0.
    let key = |v: u32| {
        mesh.vertices[v as usize]
            .to_array()
            .map(|c| (c + 0.0).to_bits())
    };
    let mut order: Vec<u32> = (0..mesh.vertices.len() as u32).collect();
    order.sort_unstable_by_key(|&v| (key(v), v));
    let mut first = vec![0; order.len()];
    for group in order.chunk_by(|&a, &b| key(a) == key(b)) {
        for &v in group {
            first[v as usize] = group[0];
        }
    }
    first
}

/// For each vertex, the first one of its cluster.
fn first_within(mesh: &TriangleMesh, tolerance_m: f64) -> Vec<u32> {
    let boxes: Vec<Aabb> = mesh
        .vertices
        .iter()
        .map(|&v| Aabb::from_points([v]))
        .collect();
    let bvh = Bvh::build(&boxes);
    let mut first: Vec<u32> = (0..boxes.len() as u32).collect();
    for (v, position) in boxes.iter().enumerate() {
        bvh.for_each_overlap(&position.inflated(tolerance_m), |other| {
            let distance = mesh.vertices[v].distance(mesh.vertices[other as usize]);
            if distance <= tolerance_m {
                join(&mut first, v as u32, other);
            }
        });
    }
    (0..boxes.len() as u32)
        .map(|v| root(&mut first, v))
        .collect()
}

/// Joins the sets of `a` and `b` (union-find).
pub(super) fn join(parent: &mut [u32], a: u32, b: u32) {
    let (a, b) = (root(parent, a), root(parent, b));
    parent[a.max(b) as usize] = a.min(b);
}

/// Smallest member of the set of `v`; shortens the path to it.
pub(super) fn root(parent: &mut [u32], mut v: u32) -> u32 {
    while parent[v as usize] != v {
        parent[v as usize] = parent[parent[v as usize] as usize];
        v = parent[v as usize];
    }
    v
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::builtin;
    use glam::DVec3;

    /// Each triangle with its own vertices, displaced by up to `jitter`.
    fn soup(mesh: &TriangleMesh, jitter: f64) -> TriangleMesh {
        let vertices: Vec<DVec3> = mesh
            .all_corners()
            .flatten()
            .enumerate()
            .map(|(i, v)| v + DVec3::splat(jitter * (i % 3) as f64 / 2.0))
            .collect();
        let triangles = (0..mesh.triangles.len() as u32)
            .map(|t| [3 * t, 3 * t + 1, 3 * t + 2])
            .collect();
        TriangleMesh {
            vertices,
            triangles,
        }
    }

    #[test]
    fn triangle_soup_becomes_a_closed_mesh() {
        let mesh = builtin("mug").unwrap();
        let exact = weld(&soup(&mesh, 0.0), 0.0);
        assert_eq!(exact.vertices.len(), mesh.vertices.len());
        assert!(exact.edges().is_closed());
        let near = soup(&mesh, 1e-8);
        assert!(!weld(&near, 0.0).edges().is_closed());
        let welded = weld(&near, 1e-7);
        assert_eq!(welded.vertices.len(), mesh.vertices.len());
        assert!(welded.edges().is_closed());
    }

    #[test]
    fn negative_zero_coincides_with_zero() {
        let mesh = TriangleMesh {
            vertices: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::new(-0.0, 0.0, -0.0)],
            triangles: vec![[0, 1, 2], [3, 2, 1]],
        };
        assert_eq!(weld(&mesh, 0.0).triangles, [[0, 1, 2], [0, 2, 1]]);
    }
}
