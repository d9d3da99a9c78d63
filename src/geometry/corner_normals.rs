//! Normals of a faceted mesh where it stands for a smooth one.

use glam::DVec3;

use super::mesh::TriangleMesh;

/// Triangles that meet at less than this angle are parts of one smooth surface, rad (40°).
pub const CREASE_RAD: f64 = 0.698;

/// Unit normal at each corner of each triangle: the sum over the triangles at its vertex that are
/// within the crease angle, weighted by their area.
pub fn corner_normals(mesh: &TriangleMesh, crease_rad: f64) -> Vec<[DVec3; 3]> {
    let faces: Vec<DVec3> = mesh.all_corners().map(scaled_normal).collect();
    let mut first = vec![0_u32; mesh.vertices.len() + 1];
    for &v in mesh.triangles.iter().flatten() {
        first[v as usize + 1] += 1;
    }
    for v in 1..first.len() {
        first[v] += first[v - 1];
    }
    let mut at_vertex = vec![0_u32; 3 * mesh.triangles.len()];
    let mut next = first.clone();
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        for &v in triangle {
            at_vertex[next[v as usize] as usize] = t as u32;
            next[v as usize] += 1;
        }
    }
    let units: Vec<DVec3> = faces.iter().map(|n| n.normalize_or_zero()).collect();
    let limit = crease_rad.cos();
    let corner = |t: usize, v: u32| {
        let range = first[v as usize] as usize..first[v as usize + 1] as usize;
        let around = at_vertex[range].iter().map(|&other| other as usize);
        let smooth = around.filter(|&other| units[t].dot(units[other]) >= limit);
        let sum: DVec3 = smooth.map(|other| faces[other]).sum();
        sum.normalize_or(units[t]).normalize_or(DVec3::Z)
    };
    let triangles = mesh.triangles.iter().enumerate();
    triangles
        .map(|(t, tri)| tri.map(|v| corner(t, v)))
        .collect()
}

/// Normal of a triangle times twice its area.
fn scaled_normal([a, b, c]: [DVec3; 3]) -> DVec3 {
    (b - a).cross(c - a)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::builtin;

    #[test]
    fn a_box_keeps_its_edges_and_a_sphere_is_smooth() {
        let mesh = builtin("box").unwrap();
        for normal in corner_normals(&mesh, CREASE_RAD).iter().flatten() {
            assert!((normal.abs().max_element() - 1.0).abs() < 1e-9, "{normal}");
        }
        let mesh = builtin("sphere").unwrap();
        for (triangle, normals) in mesh.triangles.iter().zip(corner_normals(&mesh, CREASE_RAD)) {
            for (vertex, normal) in mesh.corners(*triangle).iter().zip(normals) {
                assert!(vertex.normalize().dot(normal) > 0.99);
            }
        }
    }
}
