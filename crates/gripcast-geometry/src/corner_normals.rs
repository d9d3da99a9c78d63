//! Shading normals of a faceted mesh that represents a smooth surface.

use glam::DVec3;

use super::mesh::TriangleMesh;
use super::weld::{join, root};

/// Crease angle: triangles that meet at a smaller angle belong to one smooth surface, rad (40°).
pub const CREASE_RAD: f64 = 0.698;

/// Cosine of the largest angle between coplanar neighbours (0.08°).
const COPLANAR: f64 = 1.0 - 1e-6;

/// Computes a unit normal at each corner of each triangle: the mean over the triangles at its
/// vertex within the crease angle, weighted by their angle there and by the area of their planar
/// face. A face thus stays flat up to the bevel around it, independent of the triangulation.
pub fn corner_normals(mesh: &TriangleMesh, crease_rad: f64) -> Vec<[DVec3; 3]> {
    let units: Vec<DVec3> = mesh.all_corners().map(normal).collect();
    let areas = face_areas(mesh, &units);
    let mut first = vec![0_u32; mesh.vertices.len() + 1];
    for &v in mesh.triangles.iter().flatten() {
        first[v as usize + 1] += 1;
    }
    for v in 1..first.len() {
        first[v] += first[v - 1];
    }
    let mut at_vertex = vec![(0, DVec3::ZERO); 3 * mesh.triangles.len()];
    let mut next = first.clone();
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        let corners = mesh.corners(*triangle);
        for (k, &v) in triangle.iter().enumerate() {
            let weighted = units[t] * (areas[t] * angle_at(corners, k));
            at_vertex[next[v as usize] as usize] = (t, weighted);
            next[v as usize] += 1;
        }
    }
    let limit = crease_rad.cos();
    let corner = |t: usize, v: u32| {
        let around = &at_vertex[first[v as usize] as usize..first[v as usize + 1] as usize];
        let smooth = around
            .iter()
            .filter(|(other, _)| units[t].dot(units[*other]) >= limit);
        let sum: DVec3 = smooth.map(|(_, weighted)| *weighted).sum();
        sum.normalize_or(units[t]).normalize_or(DVec3::Z)
    };
    let triangles = mesh.triangles.iter().enumerate();
    triangles
        .map(|(t, tri)| tri.map(|v| corner(t, v)))
        .collect()
}

/// Unit normal of a triangle; zero for one without area.
fn normal([a, b, c]: [DVec3; 3]) -> DVec3 {
    (b - a).cross(c - a).normalize_or_zero()
}

/// Angle of a triangle at its corner `k`, rad.
fn angle_at(corners: [DVec3; 3], k: usize) -> f64 {
    let at = corners[k];
    let [p, q] = [1, 2].map(|next| corners[(k + next) % 3] - at);
    p.cross(q).length().atan2(p.dot(q))
}

/// Area of the planar face that contains each triangle, m².
fn face_areas(mesh: &TriangleMesh, units: &[DVec3]) -> Vec<f64> {
    let mut face: Vec<u32> = (0..mesh.triangles.len() as u32).collect();
    let edges = mesh.edges();
    for edge in 0..edges.len() {
        if let [a, b] = *edges.triangles(edge)
            && units[a as usize].dot(units[b as usize]) >= COPLANAR
        {
            join(&mut face, a, b);
        }
    }
    let roots: Vec<usize> = (0..face.len() as u32)
        .map(|t| root(&mut face, t) as usize)
        .collect();
    let mut sums = vec![0.0; face.len()];
    for (area, &root) in mesh.triangle_areas().iter().zip(&roots) {
        sums[root] += area;
    }
    roots.iter().map(|&root| sums[root]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{BUILTIN_NAMES, builtin};

    #[test]
    fn box_keeps_its_edges_and_sphere_is_smooth() {
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

    #[test]
    fn face_stays_flat_up_to_its_bevel() {
        // A square of 20 mm cut into squares of 2 mm, with a bevel of 1 mm at 30° along x = 10 mm.
        let mut mesh = TriangleMesh::default();
        let down = 1e-3 * 30_f64.to_radians().tan();
        for i in 0..=11 {
            for j in 0..=10 {
                let x = if i == 11 {
                    11.0
                } else {
                    2.0 * f64::from(i) - 10.0
                };
                let z = if i == 11 { -down } else { 0.0 };
                let y = 2.0 * f64::from(j) - 10.0;
                mesh.vertices.push(DVec3::new(1e-3 * x, 1e-3 * y, z));
            }
        }
        for i in 0..11_u32 {
            for j in 0..10 {
                let a = 11 * i + j;
                mesh.triangles.push([a, a + 11, a + 12]);
                mesh.triangles.push([a, a + 12, a + 1]);
            }
        }
        let normals = corner_normals(&mesh, CREASE_RAD);
        for (triangle, normals) in mesh.triangles.iter().zip(&normals) {
            for (vertex, normal) in mesh.corners(*triangle).iter().zip(normals) {
                let tilt = normal.angle_between(DVec3::Z);
                let max = if vertex.x > 0.0105 { 0.53 } else { 0.04 };
                assert!(tilt < max, "{tilt} at {vertex}");
            }
        }
    }

    #[test]
    fn face_area_is_the_sum_of_its_triangles() {
        for name in BUILTIN_NAMES {
            let mesh = builtin(name).unwrap();
            let units: Vec<DVec3> = mesh.all_corners().map(normal).collect();
            let areas = face_areas(&mesh, &units);
            // Each face counts once if each of its triangles counts by its fraction of the area.
            let faces: f64 = mesh
                .triangle_areas()
                .iter()
                .zip(&areas)
                .map(|(t, f)| t / f)
                .sum();
            assert!(faces >= 1.0, "{name}");
            if *name == "box" {
                assert!((faces - 6.0).abs() < 1e-9, "{faces}");
            }
        }
    }
}
