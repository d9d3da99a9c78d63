//! Boxes, spheres, cylinders, octahedra, and their rings and discs.

use std::collections::BTreeMap;
use std::f64::consts::{FRAC_PI_4, PI, TAU};

use glam::{DVec2, DVec3};

use crate::mesh::TriangleMesh;

/// Box of a size (m); faces are divided into cells of two triangles.
pub(super) fn grid_box(size: DVec3, cells: [u32; 3]) -> TriangleMesh {
    let mut mesh = TriangleMesh::default();
    let mut indices = BTreeMap::new();
    for axis in 0..3 {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        for end in [0, cells[axis]] {
            for i in 0..cells[u] {
                for j in 0..cells[v] {
                    let mut quad = [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(di, dj)| {
                        let mut node = [0; 3];
                        (node[axis], node[u], node[v]) = (end, i + di, j + dj);
                        *indices.entry(node).or_insert_with(|| {
                            let unit = |k: usize| f64::from(node[k]) / f64::from(cells[k]) - 0.5;
                            push(&mut mesh, DVec3::new(unit(0), unit(1), unit(2)) * size)
                        })
                    });
                    if end == 0 {
                        quad.reverse();
                    }
                    push_quad(&mut mesh, quad);
                }
            }
        }
    }
    mesh
}

/// Sphere of radius `radius` (m) with `segments` meridians and `stacks` rings of faces; the poles
/// are single vertices on the z axis.
pub(crate) fn uv_sphere(radius: f64, segments: u32, stacks: u32) -> TriangleMesh {
    let mut mesh = TriangleMesh::default();
    let bottom = push(&mut mesh, DVec3::NEG_Z * radius);
    let mut rings = Vec::new();
    for stack in 1..stacks {
        let (r, z) = (PI * f64::from(stack) / f64::from(stacks)).sin_cos();
        rings.push(ring(&mut mesh, segments, 0.0, r * radius, -z * radius));
    }
    let top = push(&mut mesh, DVec3::Z * radius);
    for pair in rings.windows(2) {
        band(&mut mesh, &pair[0], &pair[1]);
    }
    for (first, last) in rings.first().into_iter().zip(rings.last()) {
        for s in 0..first.len() {
            let next = (s + 1) % first.len();
            mesh.triangles.push([bottom, first[next], first[s]]);
            mesh.triangles.push([last[s], last[next], top]);
        }
    }
    mesh
}

/// Upright cylinder (m) with 4 · `quarter` segments and `rows` rings of faces.
pub(super) fn cylinder(radius: f64, height: f64, quarter: u32, rows: u32) -> TriangleMesh {
    let mut mesh = TriangleMesh::default();
    let rings: Vec<_> = (0..=rows)
        .map(|row| {
            let z = height * (f64::from(row) / f64::from(rows) - 0.5);
            square_ring(&mut mesh, quarter, radius, z)
        })
        .collect();
    for pair in rings.windows(2) {
        band(&mut mesh, &pair[0], &pair[1]);
    }
    disc(&mut mesh, &rings[0], false);
    disc(&mut mesh, &rings[rows as usize], true);
    mesh
}

/// Octahedron with corners at ± the half axes (m); each side is divided into `cuts` parts.
pub(super) fn octahedron(half: DVec3, cuts: u32) -> TriangleMesh {
    let mut mesh = TriangleMesh::default();
    let mut indices = BTreeMap::new();
    for octant in 0..8u32 {
        let sign = [0, 1, 2].map(|axis| if octant >> axis & 1 == 0 { 1 } else { -1 });
        let mirrored = sign.iter().product::<i32>() < 0;
        // Lattice node with i steps towards x, j towards y and the rest towards z.
        let mut at = |i: u32, j: u32| {
            let steps = [i, j, cuts - i - j].map(|n| n as i32);
            let node = [0, 1, 2].map(|axis| sign[axis] * steps[axis]);
            *indices.entry(node).or_insert_with(|| {
                let unit = DVec3::from_array(node.map(|n| f64::from(n) / f64::from(cuts)));
                push(&mut mesh, unit * half)
            })
        };
        let mut faces = Vec::new();
        for i in 0..cuts {
            for j in 0..cuts - i {
                faces.push([at(i + 1, j), at(i, j + 1), at(i, j)]);
                if i + j + 2 <= cuts {
                    faces.push([at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]);
                }
            }
        }
        if mirrored {
            faces.iter_mut().for_each(|face| face.swap(0, 1));
        }
        mesh.triangles.extend(faces);
    }
    mesh
}

/// Appends a vertex (m) and returns its index.
pub(super) fn push(mesh: &mut TriangleMesh, vertex: DVec3) -> u32 {
    mesh.vertices.push(vertex);
    mesh.vertices.len() as u32 - 1
}

/// Appends two triangles of a counter-clockwise quadrilateral, split from its first to its third
/// corner.
pub(super) fn push_quad(mesh: &mut TriangleMesh, [a, b, c, d]: [u32; 4]) {
    mesh.triangles.push([a, b, c]);
    mesh.triangles.push([a, c, d]);
}

/// Ring of `count` new vertices at height `z`, counter-clockwise seen from above.
fn ring(mesh: &mut TriangleMesh, count: u32, start: f64, radius: f64, z: f64) -> Vec<u32> {
    (0..count)
        .map(|s| {
            let (y, x) = (start + TAU * f64::from(s) / f64::from(count)).sin_cos();
            push(mesh, DVec3::new(radius * x, radius * y, z))
        })
        .collect()
}

/// Ring of 4 · `quarter` vertices that a [`disc`] can fill.
pub(super) fn square_ring(mesh: &mut TriangleMesh, quarter: u32, radius: f64, z: f64) -> Vec<u32> {
    ring(mesh, 4 * quarter, -FRAC_PI_4, radius, z)
}

/// Appends the faces between two rings; they face outwards if the rings run counter-clockwise seen
/// from the side of `upper`.
pub(super) fn band(mesh: &mut TriangleMesh, lower: &[u32], upper: &[u32]) {
    for s in 0..lower.len() {
        let next = (s + 1) % lower.len();
        push_quad(mesh, [lower[s], lower[next], upper[next], upper[s]]);
    }
}

/// Fills a [`square_ring`] with a square grid mapped to a disc, facing up or down (concentric map
/// of Shirley and Chiu, J. Graphics Tools 1997: no slivers in the middle).
pub(super) fn disc(mesh: &mut TriangleMesh, border: &[u32], up: bool) {
    let n = border.len() / 4;
    let rim = mesh.vertices[border[0] as usize];
    let (radius, z) = (rim.truncate().length(), rim.z);
    let mut grid = vec![0; (n + 1) * (n + 1)];
    for i in 0..=n {
        for j in 0..=n {
            grid[i * (n + 1) + j] = match ring_index(i, j, n) {
                Some(s) => border[s],
                None => {
                    let unit = |k: usize| 2.0 * k as f64 / n as f64 - 1.0;
                    let p = concentric(unit(i), unit(j)) * radius;
                    push(mesh, p.extend(z))
                }
            };
        }
    }
    for i in 0..n {
        for j in 0..n {
            let at = |di: usize, dj: usize| grid[(i + di) * (n + 1) + j + dj];
            let mut quad = [at(0, 0), at(1, 0), at(1, 1), at(0, 1)];
            // Split towards the centre to avoid slivers at the corners of the square.
            if (2 * i + 1 > n) != (2 * j + 1 > n) {
                quad.rotate_left(1);
            }
            if !up {
                quad.reverse();
                quad.rotate_left(1);
            }
            push_quad(mesh, quad);
        }
    }
}

/// Index in the ring of a grid vertex on the boundary.
fn ring_index(i: usize, j: usize, n: usize) -> Option<usize> {
    match (i, j) {
        (i, j) if i == n && j < n => Some(j),
        (i, j) if j == n && i > 0 => Some(n + (n - i)),
        (0, j) if j > 0 => Some(2 * n + (n - j)),
        (i, 0) => Some(3 * n + i),
        _ => None,
    }
}

/// Maps the square [−1, 1]² to the unit disc.
fn concentric(a: f64, b: f64) -> DVec2 {
    if a == 0.0 && b == 0.0 {
        return DVec2::ZERO;
    }
    let (radius, angle) = if a.abs() >= b.abs() {
        (a, FRAC_PI_4 * b / a)
    } else {
        (b, 2.0 * FRAC_PI_4 - FRAC_PI_4 * a / b)
    };
    DVec2::from_angle(angle) * radius
}
