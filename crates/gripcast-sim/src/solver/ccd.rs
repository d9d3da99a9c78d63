//! How far a step may go before a gel touches the object.

use glam::DVec3;

use super::gel_contact::GelContact;
use crate::affine::AffineState;
use crate::contact::ccd::{edge_edge_toi, point_triangle_toi};
use crate::fem::Surface;

/// Room for the curvature of paths in the object's frame when its matrix turns within a step.
const CURVATURE: f64 = 1.05;

fn vector(flat: &[f64], node: usize) -> DVec3 {
    DVec3::new(flat[3 * node], flat[3 * node + 1], flat[3 * node + 2])
}

/// Bound of each surface node's motion in the object's frame over the whole step; the largest.
pub(super) fn relative_motion(
    surface: &Surface,
    x: &[DVec3],
    direction: &[f64],
    object: &AffineState,
    object_direction: &AffineState,
    motion: &mut [f64],
) -> f64 {
    let inverse = object.a.inverse();
    let mut longest = 0.0_f64;
    for &node in surface.vertices() {
        let node = node as usize;
        let material = inverse * (x[node] - object.p);
        let relative = vector(direction, node) - object_direction.point(material);
        motion[node] = CURVATURE * relative.length();
        longest = longest.max(motion[node]);
    }
    longest
}

/// Largest fraction, at most `fraction`, of the step without contact. `motion` bounds the nodes' motion
/// over the whole step; `contact.moved` is of the present positions.
pub(super) fn free_fraction(
    contact: &GelContact,
    x: &[DVec3],
    direction: &[f64],
    object: &AffineState,
    object_direction: &AffineState,
    motion: &[f64],
    (fraction, slack): (f64, f64),
) -> f64 {
    let candidates = &contact.candidates;
    let gel = |node: u32| {
        let node = node as usize;
        (x[node], x[node] + vector(direction, node) * fraction)
    };
    let body = |vertex: u32| {
        let material = candidates.material[vertex as usize];
        let from = object.point(material);
        (from, from + object_direction.point(material) * fraction)
    };
    // The distance is at least `gathered - moved` now and shrinks by at most `motion`.
    let can_touch = |gathered: f64, nodes: &[u32]| {
        let bound = |node: &u32| contact.moved[*node as usize] + motion[*node as usize] * fraction;
        gathered <= nodes.iter().map(bound).fold(0.0, f64::max)
    };
    let mut limit = 1.0_f64;
    for pair in &candidates.node_triangles {
        if can_touch(pair.gathered, &[pair.node]) {
            let [a, b, c] = pair.triangle.map(body);
            limit = limit.min(time(point_triangle_toi, [gel(pair.node), a, b, c], slack));
        }
    }
    for pair in &candidates.vertex_triangles {
        if can_touch(pair.gathered, &pair.nodes) {
            let [a, b, c] = pair.nodes.map(gel);
            let points = [body(pair.vertex), a, b, c];
            limit = limit.min(time(point_triangle_toi, points, slack));
        }
    }
    for pair in &candidates.edge_edges {
        if can_touch(pair.gathered, &pair.nodes) {
            let [a0, a1] = pair.nodes.map(gel);
            let [b0, b1] = pair.vertices.map(body);
            limit = limit.min(time(edge_edge_toi, [a0, a1, b0, b1], slack));
        }
    }
    fraction * limit
}

fn time(
    toi: impl Fn(&[DVec3; 4], &[DVec3; 4], f64) -> Option<f64>,
    points: [(DVec3, DVec3); 4],
    slack: f64,
) -> f64 {
    let (from, to) = (points.map(|p| p.0), points.map(|p| p.1));
    toi(&from, &to, slack).unwrap_or(1.0)
}
