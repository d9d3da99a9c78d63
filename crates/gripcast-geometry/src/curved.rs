//! Refines a faceted mesh by curved patches towards the smooth body that it represents.

use glam::DVec3;

use super::corner_normals::corner_normals;
use super::mesh::TriangleMesh;

/// Maximum subdivisions of an edge; a triangle becomes the square of that number.
const MAX_PARTS: usize = 5;
/// Distance of the control points from a straight edge, as a fraction of its length.
const STRAIGHT: f64 = 1e-4;

/// Replaces each triangle by a cubic patch that matches the vertex normals (Vlachos et al., "Curved
/// PN triangles", I3D 2001), triangulated with sides of about `side_m` (m). Triangles that meet at
/// less than `crease_rad` belong to one smooth surface; other edges stay sharp and follow the
/// tangent common to both sides, so that the rim of a cylinder becomes round. Closed meshes stay
/// closed, planar faces stay planar, and the first vertices are those of `mesh` in order.
pub fn curved(mesh: &TriangleMesh, crease_rad: f64, side_m: f64) -> TriangleMesh {
    let edges = mesh.edges();
    let normals = corner_normals(mesh, crease_rad);
    let bent: Vec<[DVec3; 2]> = (0..edges.len())
        .map(|edge| {
            let [a, b] = edges.vertices[edge];
            let beside = edges.triangles(edge);
            [(a, b), (b, a)].map(|(from, to)| {
                let normals = beside.iter().map(|&t| {
                    let triangle = mesh.triangles[t as usize];
                    let corner = triangle.iter().position(|&v| v == from).unwrap_or(0);
                    normals[t as usize][corner]
                });
                let ends = [from, to].map(|v| mesh.vertices[v as usize]);
                control_point(ends, normals, crease_rad)
            })
        })
        .collect();
    let longest = edges.vertices.iter().zip(&bent).filter_map(|(edge, bent)| {
        let [a, b] = edge.map(|v| mesh.vertices[v as usize]);
        let off =
            (bent[0] - a.lerp(b, 1.0 / 3.0)).length() + (bent[1] - b.lerp(a, 1.0 / 3.0)).length();
        (off > STRAIGHT * a.distance(b)).then(|| a.distance(b))
    });
    let parts = (longest.fold(0.0, f64::max) / side_m).ceil() as usize;
    match parts.min(MAX_PARTS) {
        0 | 1 => mesh.clone(),
        parts => cut(mesh, &bent, parts),
    }
}

/// Control point of an edge at a third from its first end (b_210 in the paper). `normals` are those
/// of the adjacent triangles at that end.
fn control_point(
    [from, to]: [DVec3; 2],
    normals: impl Iterator<Item = DVec3>,
    crease_rad: f64,
) -> DVec3 {
    let third = (to - from) / 3.0;
    let normals: Vec<DVec3> = normals.collect();
    let offset = match normals[..] {
        [n] => third - third.dot(n) * n,
        [n, m] if n.dot(m) >= crease_rad.cos() => {
            let n = (n + m).normalize_or(n);
            third - third.dot(n) * n
        }
        [n, m] => {
            let tangent = n.cross(m).normalize_or_zero();
            // Opposite normals have no common tangent; one across the edge is not its tangent.
            if third.dot(tangent).abs() > 0.5 * third.length() {
                third.dot(tangent) * tangent
            } else {
                third
            }
        }
        _ => third,
    };
    from + offset
}

/// Divides every edge into `parts` and every patch into `parts²` triangles.
fn cut(mesh: &TriangleMesh, bent: &[[DVec3; 2]], parts: usize) -> TriangleMesh {
    let edges = mesh.edges();
    let mut vertices = mesh.vertices.clone();
    for (edge, [near, far]) in edges.vertices.iter().zip(bent) {
        let [a, b] = edge.map(|v| mesh.vertices[v as usize]);
        vertices.extend((1..parts).map(|i| {
            let t = i as f64 / parts as f64;
            let s = 1.0 - t;
            a * (s * s * s) + *near * (3.0 * s * s * t) + *far * (3.0 * s * t * t) + b * (t * t * t)
        }));
    }
    let on_edge = |from: u32, to: u32| {
        let key = [from.min(to), from.max(to)];
        let edge = edges.vertices.binary_search(&key).unwrap_or(0);
        (edge, from > to)
    };
    let mut triangles = Vec::with_capacity(mesh.triangles.len() * parts * parts);
    for &triangle in &mesh.triangles {
        let [a, b, c] = triangle;
        let sides = [on_edge(a, b), on_edge(b, c), on_edge(c, a)];
        let patch = Patch::new(
            mesh.corners(triangle),
            sides.map(|(edge, is_reversed)| {
                let [near, far] = bent[edge];
                if is_reversed {
                    [far, near]
                } else {
                    [near, far]
                }
            }),
        );
        let first_inside = vertices.len() as u32;
        // Rows from the corner a to the side bc; i counts towards b, j towards c.
        let mut inside = 0;
        for i in 1..parts {
            for j in 1..parts - i {
                let (v, w) = (i as f64 / parts as f64, j as f64 / parts as f64);
                vertices.push(patch.at(1.0 - v - w, v, w));
            }
        }
        let along = |(edge, is_reversed): (usize, bool), i: usize| {
            let i = if is_reversed { parts - i } else { i };
            (mesh.vertices.len() + edge * (parts - 1) + i - 1) as u32
        };
        let mut indices = vec![vec![0_u32; parts + 1]; parts + 1];
        for (i, row) in indices.iter_mut().enumerate() {
            for (j, index) in row.iter_mut().enumerate().take(parts + 1 - i) {
                *index = match (i, j) {
                    (0, 0) => a,
                    (i, 0) if i == parts => b,
                    (0, j) if j == parts => c,
                    (i, 0) => along(sides[0], i),
                    (i, j) if i + j == parts => along(sides[1], j),
                    (0, j) => along(sides[2], parts - j),
                    _ => {
                        inside += 1;
                        first_inside + inside - 1
                    }
                };
            }
        }
        for i in 0..parts {
            for j in 0..parts - i {
                triangles.push([indices[i][j], indices[i + 1][j], indices[i][j + 1]]);
                if i + j + 1 < parts {
                    triangles.push([indices[i + 1][j], indices[i + 1][j + 1], indices[i][j + 1]]);
                }
            }
        }
    }
    TriangleMesh {
        vertices,
        triangles,
    }
}

/// Cubic Bézier triangle.
struct Patch {
    corners: [DVec3; 3],
    /// Two control points on each of the sides ab, bc, ca, in that direction.
    sides: [[DVec3; 2]; 3],
    middle: DVec3,
}

impl Patch {
    fn new(corners: [DVec3; 3], sides: [[DVec3; 2]; 3]) -> Self {
        let of_sides = sides.iter().flatten().sum::<DVec3>() / 6.0;
        let of_corners = corners.iter().sum::<DVec3>() / 3.0;
        Self {
            corners,
            sides,
            middle: of_sides + 0.5 * (of_sides - of_corners),
        }
    }

    /// Point with these barycentric coordinates, m.
    fn at(&self, u: f64, v: f64, w: f64) -> DVec3 {
        let [a, b, c] = self.corners;
        let [[ab, ba], [bc, cb], [ca, ac]] = self.sides;
        let cubes = a * (u * u * u) + b * (v * v * v) + c * (w * w * w);
        let ends = ab * (u * u * v)
            + ba * (u * v * v)
            + bc * (v * v * w)
            + cb * (v * w * w)
            + ca * (w * w * u)
            + ac * (w * u * u);
        cubes + 3.0 * ends + 6.0 * (u * v * w) * self.middle
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{CREASE_RAD, MassProperties, builtin};

    fn volume(mesh: &TriangleMesh) -> f64 {
        MassProperties::from_mesh(mesh).unwrap().volume_m3
    }

    /// Largest deviation of triangle centroids from the radius.
    fn max_deviation(mesh: &TriangleMesh, radius: f64, of: impl Fn(DVec3) -> f64) -> f64 {
        mesh.all_corners()
            .map(|[a, b, c]| (of((a + b + c) / 3.0) - radius).abs())
            .fold(0.0, f64::max)
    }

    #[test]
    fn sphere_becomes_rounder_and_stays_closed() {
        let sphere = builtin("sphere").unwrap();
        let radius = sphere.vertices[0].length();
        let fine = curved(&sphere, CREASE_RAD, 5e-4);
        assert!(fine.edges().is_closed());
        assert_eq!(fine.vertices[..sphere.vertices.len()], sphere.vertices);
        fine.validate().unwrap();
        let [before, after] =
            [&sphere, &fine].map(|mesh| max_deviation(mesh, radius, DVec3::length));
        // Area-weighted corner normals leave a sphere slightly less round than plain means (0.15).
        assert!(after < 0.2 * before, "{after} {before}");
        let ball = 4.0 / 3.0 * std::f64::consts::PI * radius.powi(3);
        let [before, after] = [&sphere, &fine].map(|mesh| (volume(mesh) / ball - 1.0).abs());
        assert!(after < 0.2 * before, "{after} {before}");
    }

    #[test]
    fn cylinder_rim_becomes_round_and_stays_sharp() {
        let cylinder = builtin("cylinder").unwrap();
        let height = cylinder.bounds().extent().z;
        let across = |p: DVec3| p.truncate().length();
        let radius = cylinder
            .vertices
            .iter()
            .copied()
            .map(across)
            .fold(0.0, f64::max);
        let fine = curved(&cylinder, CREASE_RAD, 5e-4);
        assert!(fine.edges().is_closed());
        assert!((fine.bounds().extent().z / height - 1.0).abs() < 1e-9);
        let whole = std::f64::consts::PI * radius * radius * height;
        let [before, after] = [&cylinder, &fine].map(|mesh| (volume(mesh) / whole - 1.0).abs());
        assert!(after < 0.1 * before, "{after} {before}");
        let sharp = corner_normals(&fine, CREASE_RAD);
        let ends = fine.triangles.iter().zip(sharp).filter(|(triangle, _)| {
            let corners = fine.corners(**triangle);
            corners
                .iter()
                .all(|p| (p.z.abs() - 0.5 * height).abs() < 1e-9)
        });
        let mut count = 0;
        for (_, normals) in ends {
            count += 1;
            assert!(normals.iter().all(|n| n.z.abs() > 0.999), "{normals:?}");
        }
        assert!(count > 0);
    }

    #[test]
    fn planar_faces_are_unchanged() {
        for name in ["box", "wedge"] {
            let mesh = builtin(name).unwrap();
            assert_eq!(curved(&mesh, CREASE_RAD, 5e-4), mesh, "{name}");
        }
    }

    #[test]
    fn open_and_degenerate_meshes_are_handled() {
        let mut sphere = builtin("sphere").unwrap();
        sphere.triangles.truncate(sphere.triangles.len() / 2);
        let [a, b, _] = sphere.triangles[0];
        sphere.triangles.push([a, b, sphere.triangles[9][0]]);
        sphere.triangles.push([a, a, b]);
        let fine = curved(&sphere, CREASE_RAD, 5e-4);
        assert!(fine.triangles.len() > 4 * sphere.triangles.len());
        assert!(fine.vertices.iter().all(|v| v.is_finite()));
        let [before, after] = [&sphere, &fine].map(|mesh| mesh.bounds().extent().max_element());
        assert!(after < 1.1 * before);
        let nothing = TriangleMesh::default();
        assert_eq!(curved(&nothing, CREASE_RAD, 5e-4), nothing);
    }
}
