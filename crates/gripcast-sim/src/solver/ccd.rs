//! Continuous collision detection of one gel with the object.

use glam::DVec3;

use super::gel_contact::GelContact;
use crate::affine::AffineState;
use crate::contact::ccd::{edge_edge_toi, point_triangle_toi};
use crate::fem::Surface;

/// Allowance for curved paths in the object's frame when its matrix rotates within a step.
const CURVATURE: f64 = 1.05;

/// A search direction of gel and object from the object's current state.
pub(super) struct Motion<'a> {
    /// Of the gel nodes, three entries each.
    pub(super) direction: &'a [f64],
    pub(super) object: &'a AffineState,
    pub(super) object_direction: &'a AffineState,
}

impl Motion<'_> {
    fn of_node(&self, node: usize) -> DVec3 {
        DVec3::from_slice(&self.direction[3 * node..3 * node + 3])
    }

    /// Bounds the motion of each surface node in the object's frame over the whole step, m;
    /// returns the largest.
    pub(super) fn bound(&self, surface: &Surface, x: &[DVec3], bounds: &mut [f64]) -> f64 {
        let inverse = self.object.a.inverse();
        let mut longest = 0.0_f64;
        for &node in surface.vertices() {
            let node = node as usize;
            let material = inverse * (x[node] - self.object.p);
            let relative = self.of_node(node) - self.object_direction.point(material);
            bounds[node] = CURVATURE * relative.length();
            longest = longest.max(bounds[node]);
        }
        longest
    }

    /// Largest step size, at most `max_step`, without collision. `bounds` are those of
    /// [`Motion::bound`]; `contact.displacements` must be up to date. At least the fraction `slack`
    /// of each distance remains.
    pub(super) fn collision_free_step(
        &self,
        contact: &GelContact,
        x: &[DVec3],
        bounds: &[f64],
        max_step: f64,
        slack: f64,
    ) -> f64 {
        let candidates = &contact.candidates;
        let gel = |node: u32| {
            let node = node as usize;
            (x[node], x[node] + self.of_node(node) * max_step)
        };
        let body = |vertex: u32| {
            let material = candidates.material(vertex);
            let from = self.object.point(material);
            (
                from,
                from + self.object_direction.point(material) * max_step,
            )
        };
        // The distance is at least `build_distance - displacement` and shrinks by at most the
        // bound.
        let can_touch = |build_distance: f64, nodes: &[u32]| {
            let bound = |node: &u32| {
                contact.displacements[*node as usize] + bounds[*node as usize] * max_step
            };
            build_distance <= nodes.iter().map(bound).fold(0.0, f64::max)
        };
        let mut limit = 1.0_f64;
        for pair in &candidates.node_triangles {
            if can_touch(pair.build_distance, &[pair.node]) {
                let [a, b, c] = pair.triangle.map(body);
                let points = [gel(pair.node), a, b, c];
                limit = limit.min(time_of_impact(point_triangle_toi, points, slack));
            }
        }
        for pair in &candidates.vertex_triangles {
            if can_touch(pair.build_distance, &pair.nodes) {
                let [a, b, c] = pair.nodes.map(gel);
                let points = [body(pair.vertex), a, b, c];
                limit = limit.min(time_of_impact(point_triangle_toi, points, slack));
            }
        }
        for pair in &candidates.edge_edges {
            if can_touch(pair.build_distance, &pair.nodes) {
                let [a0, a1] = pair.nodes.map(gel);
                let [b0, b1] = pair.vertices.map(body);
                limit = limit.min(time_of_impact(edge_edge_toi, [a0, a1, b0, b1], slack));
            }
        }
        max_step * limit
    }
}

/// Time of impact of a stencil whose points move from the first to the second position; 1 if none.
fn time_of_impact(
    toi: impl Fn(&[DVec3; 4], &[DVec3; 4], f64) -> Option<f64>,
    points: [(DVec3, DVec3); 4],
    slack: f64,
) -> f64 {
    let (from, to) = (points.map(|p| p.0), points.map(|p| p.1));
    toi(&from, &to, slack).unwrap_or(1.0)
}
