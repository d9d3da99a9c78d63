//! Closed solids of machine parts: rounded boxes, cylinders, tubes.

use std::collections::BTreeMap;
use std::f64::consts::{FRAC_PI_4, TAU};

use glam::DVec3;

use gripcast_geometry::TriangleMesh;

/// Steps over the rounding of an edge.
const ROUNDING_STEPS: usize = 3;

/// Box from `low` to `high` (m) whose edges are rounded by `radius` (m; at most half the
/// smallest side). Its faces are not cut further.
pub(super) fn rounded_box(low: DVec3, high: DVec3, radius: f64) -> TriangleMesh {
    let (center, half) = (0.5 * (low + high), 0.5 * (high - low).abs());
    let radius = radius.min(0.999 * half.min_element()).max(1e-6);
    let inner = half - DVec3::splat(radius);
    // Tangents of even angles, so that the rounding has even steps.
    let rounding = |step: usize| radius * (FRAC_PI_4 * step as f64 / ROUNDING_STEPS as f64).tan();
    let lines = [0, 1, 2].map(|axis| {
        let upper = (0..=ROUNDING_STEPS).map(|step| inner[axis] + rounding(step));
        let lower = upper.clone().rev().map(|c| -c);
        lower.chain(upper).collect::<Vec<f64>>()
    });
    let last = 2 * ROUNDING_STEPS + 1;
    let mut mesh = TriangleMesh::default();
    let mut vertex_ids = BTreeMap::new();
    for axis in 0..3 {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        for end in [0, last] {
            for (i, j) in (0..last).flat_map(|i| (0..last).map(move |j| (i, j))) {
                let mut quad = [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(di, dj)| {
                    let mut at = [0; 3];
                    (at[axis], at[u], at[v]) = (end, i + di, j + dj);
                    *vertex_ids.entry(at).or_insert_with(|| {
                        let on_box = DVec3::new(lines[0][at[0]], lines[1][at[1]], lines[2][at[2]]);
                        let core = on_box.clamp(-inner, inner);
                        let outwards = (on_box - core).normalize_or_zero();
                        push(&mut mesh, center + core + radius * outwards)
                    })
                });
                if end == 0 {
                    quad.reverse();
                }
                push_quad(&mut mesh, quad);
            }
        }
    }
    mesh
}

/// Cylinder between two distinct points, m.
pub(super) fn cylinder(from: DVec3, to: DVec3, radius: f64, segments: u32) -> TriangleMesh {
    tube(&[from, to], radius, segments)
}

/// Round tube along a path of two or more points without reversal, with flat ends, m.
pub(super) fn tube(path: &[DVec3], radius: f64, segments: u32) -> TriangleMesh {
    let mut mesh = TriangleMesh::default();
    let mut normal = DVec3::ZERO;
    let mut rings: Vec<Vec<u32>> = Vec::new();
    for (k, point) in path.iter().enumerate() {
        let before = path[k.saturating_sub(1)];
        let after = path[(k + 1).min(path.len() - 1)];
        let along = (after - before).normalize_or(DVec3::Z);
        // Frame of the previous ring, rotated as little as possible.
        let carried = normal - along * normal.dot(along);
        normal = carried
            .try_normalize()
            .unwrap_or_else(|| along.any_orthonormal_vector());
        let side = along.cross(normal);
        let ring = (0..segments).map(|s| {
            let (sin, cos) = (TAU * f64::from(s) / f64::from(segments)).sin_cos();
            push(&mut mesh, *point + radius * (cos * normal + sin * side))
        });
        rings.push(ring.collect());
    }
    for pair in rings.windows(2) {
        for s in 0..pair[0].len() {
            let next = (s + 1) % pair[0].len();
            push_quad(
                &mut mesh,
                [pair[0][s], pair[0][next], pair[1][next], pair[1][s]],
            );
        }
    }
    if let (Some(first), Some(last)) = (rings.first(), rings.last()) {
        let (start, end) = (path[0], path[path.len() - 1]);
        let (low, high) = (push(&mut mesh, start), push(&mut mesh, end));
        for s in 0..first.len() {
            let next = (s + 1) % first.len();
            mesh.triangles.push([low, first[next], first[s]]);
            mesh.triangles.push([high, last[s], last[next]]);
        }
    }
    mesh
}

/// Mirrors at the plane x = 0.
pub(super) fn mirrored_x(mesh: &TriangleMesh) -> TriangleMesh {
    TriangleMesh {
        vertices: mesh
            .vertices
            .iter()
            .map(|v| DVec3::new(-v.x, v.y, v.z))
            .collect(),
        triangles: mesh.triangles.iter().map(|&[a, b, c]| [a, c, b]).collect(),
    }
}

/// Points of a uniform Catmull–Rom curve through the given points, `steps` per segment.
pub(super) fn smooth_path(points: &[DVec3], steps: usize) -> Vec<DVec3> {
    let at = |k: isize| points[k.clamp(0, points.len() as isize - 1) as usize];
    let mut path = Vec::new();
    for piece in 0..points.len().saturating_sub(1) as isize {
        let [a, b, c, d] = [-1, 0, 1, 2].map(|offset| at(piece + offset));
        for step in 0..steps {
            let t = step as f64 / steps as f64;
            let curve = 2.0 * b
                + (c - a) * t
                + (2.0 * a - 5.0 * b + 4.0 * c - d) * (t * t)
                + (3.0 * b - a - 3.0 * c + d) * (t * t * t);
            path.push(0.5 * curve);
        }
    }
    path.extend(points.last());
    path
}

fn push(mesh: &mut TriangleMesh, vertex: DVec3) -> u32 {
    mesh.vertices.push(vertex);
    mesh.vertices.len() as u32 - 1
}

fn push_quad(mesh: &mut TriangleMesh, [a, b, c, d]: [u32; 4]) {
    mesh.triangles.push([a, b, c]);
    mesh.triangles.push([a, c, d]);
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_geometry::MassProperties;
    use std::f64::consts::PI;

    #[test]
    fn solids_are_closed_and_have_expected_volume() {
        let sharp = rounded_box(DVec3::ZERO, DVec3::new(1.0, 2.0, 3.0), 1e-4);
        let round = rounded_box(DVec3::splat(-1.0), DVec3::splat(1.0), 1.0);
        let rod = cylinder(DVec3::ZERO, DVec3::new(1.0, 1.0, 0.0), 0.1, 64);
        let bend: Vec<DVec3> = (0..=16)
            .map(|k| {
                let angle = PI * f64::from(k) / 16.0;
                DVec3::new(angle.cos(), 0.0, angle.sin())
            })
            .collect();
        let elbow = tube(&bend, 0.1, 32);
        for (name, mesh, volume, tolerance) in [
            ("box", &sharp, 6.0, 1e-3),
            ("ball", &round, 4.0 / 3.0 * PI, 0.12),
            ("rod", &rod, PI * 0.01 * 2f64.sqrt(), 1e-3),
            ("mirrored", &mirrored_x(&rod), PI * 0.01 * 2f64.sqrt(), 1e-3),
            ("elbow", &elbow, PI * PI * 0.01, 2e-3),
        ] {
            assert!(mesh.edges().is_closed(), "{name}");
            let found = MassProperties::from_mesh(mesh).unwrap().volume_m3;
            assert!(
                (found - volume).abs() < tolerance * volume.max(1.0),
                "{name}: {found}"
            );
        }
    }

    #[test]
    fn smooth_path_passes_through_its_points() {
        let points = [DVec3::ZERO, DVec3::X, DVec3::ONE];
        let path = smooth_path(&points, 5);
        assert_eq!(path.len(), 11);
        for (k, point) in points.iter().enumerate() {
            assert!(path[5 * k].distance(*point) < 1e-12);
        }
    }
}
