//! What tests look at inside the contacts of a gel.

use glam::DVec3;

use super::{GelContact, Situation};
use crate::affine::AffineState;

/// Numbers of active contacts.
#[derive(Debug, Default, PartialEq)]
pub(in super::super) struct Census {
    pub(in super::super) node_triangle: usize,
    pub(in super::super) vertex_triangle: usize,
    pub(in super::super) edge_edge: usize,
    pub(in super::super) mollified: usize,
    /// Largest force on an edge's direction, N.
    pub(in super::super) turning_n: f64,
}

impl GelContact {
    pub(in super::super) fn census(&self) -> Census {
        let mut census = Census::default();
        for contact in &self.contacts {
            match contact.stencil.count {
                1 => census.node_triangle += 1,
                2 => census.edge_edge += 1,
                _ => census.vertex_triangle += 1,
            }
            census.mollified += usize::from(contact.is_mollified);
        }
        let turning = self
            .turning
            .iter()
            .map(|turning| turning.gradient[0].length());
        census.turning_n = turning.fold(0.0, f64::max);
        census
    }

    /// Distances of the active contacts: node-triangle, vertex-triangle, edge-edge.
    pub(in super::super) fn distances(&self) -> [Vec<f64>; 3] {
        let mut found = [Vec::new(), Vec::new(), Vec::new()];
        for contact in &self.contacts {
            let kind = [0, 2, 1][usize::from(contact.stencil.count) - 1];
            found[kind].push(contact.distance);
        }
        found
    }

    /// Numbers of contacts whose friction sticks and of those whose friction slides.
    pub(in super::super) fn rubbing(
        &self,
        now: &Situation<'_>,
        start: &[DVec3],
        from: &AffineState,
    ) -> [usize; 2] {
        let mut counts = [0; 2];
        for rubbing in &self.rubbing {
            let slip = rubbing.stencil.slip(now.x, start, now.object, from);
            let slip = rubbing.friction.tangential(slip).length();
            counts[usize::from(slip > rubbing.friction.epsilon)] += 1;
        }
        counts
    }
}
