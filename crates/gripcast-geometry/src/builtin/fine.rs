//! Shapes with faces of about 1 mm, for tactile images without visible facets.

use std::f64::consts::TAU;

use glam::DVec3;

use super::shapes::{band, disc, octahedron, square_ring};
use crate::mesh::TriangleMesh;

/// Ball of a radius (m): an octahedron with `cuts` subdivisions per side, projected onto the
/// sphere.
pub(super) fn ball(radius: f64, cuts: u32) -> TriangleMesh {
    let mut mesh = octahedron(DVec3::ONE, cuts);
    for vertex in &mut mesh.vertices {
        // Equal steps of the angle instead of the edge, for faces of nearly equal size.
        let bent = vertex.abs().map(|component| (0.25 * TAU * component).sin());
        *vertex = bent.normalize().copysign(*vertex) * radius;
    }
    mesh
}

/// A quarter of the segments around the bottle.
const QUARTER: u32 = 32;
/// Ribs around the cap.
const RIBS: f64 = 32.0;
/// Depth of the grooves between them, m.
const GROOVE_M: f64 = 0.0007;
/// Outline from bottom to top: height and radius, m, and rows of faces up to there.
const OUTLINE: [(f64, f64, u32); 9] = [
    (0.000, 0.0190, 0),
    (0.002, 0.0215, 2),
    (0.058, 0.0215, 26),
    (0.074, 0.0130, 12),
    (0.081, 0.0130, 4),
    (0.082, 0.0160, 2),
    (0.083, 0.0165, 1),
    (0.107, 0.0165, 18),
    (0.110, 0.0150, 2),
];
/// Height range of the ribs on the cap, m.
const CAP_M: (f64, f64) = (0.0835, 0.1065);

/// Upright bottle with a ribbed cap, centred at the origin.
pub(super) fn bottle() -> TriangleMesh {
    let mut mesh = TriangleMesh::default();
    let mut rings = Vec::new();
    let half = 0.5 * OUTLINE[OUTLINE.len() - 1].0;
    for (number, (height, radius, rows)) in OUTLINE.into_iter().enumerate() {
        let before = OUTLINE[number.saturating_sub(1)];
        for row in (1..=rows).chain((rows == 0).then_some(1)) {
            let fraction = f64::from(row) / f64::from(rows.max(1));
            let at = |a: f64, b: f64| a + fraction * (b - a);
            let (z, radius) = (at(before.0, height), at(before.1, radius));
            rings.push((z, square_ring(&mut mesh, QUARTER, radius, z - half)));
        }
    }
    for (z, ring) in &rings {
        if (CAP_M.0..=CAP_M.1).contains(z) {
            for vertex in ring {
                let position = &mut mesh.vertices[*vertex as usize];
                let phase = RIBS * position.y.atan2(position.x);
                let radius = position.truncate().length();
                let scale = 1.0 - GROOVE_M / radius * (0.5 - 0.5 * phase.cos());
                (position.x, position.y) = (position.x * scale, position.y * scale);
            }
        }
    }
    for pair in rings.windows(2) {
        band(&mut mesh, &pair[0].1, &pair[1].1);
    }
    disc(&mut mesh, &rings[0].1, false);
    disc(&mut mesh, &rings[rings.len() - 1].1, true);
    mesh
}
