//! Internals of a gel's contacts for tests.

use super::{ContactState, GelContact};

/// Numbers of active contacts.
#[derive(Debug, Default, PartialEq)]
pub(in super::super) struct ContactCounts {
    pub(in super::super) node_triangle: usize,
    pub(in super::super) vertex_triangle: usize,
    pub(in super::super) edge_edge: usize,
    pub(in super::super) mollified: usize,
}

impl GelContact {
    pub(in super::super) fn counts(&self) -> ContactCounts {
        let mut counts = ContactCounts::default();
        for contact in &self.contacts {
            match contact.stencil.count {
                1 => counts.node_triangle += 1,
                2 => counts.edge_edge += 1,
                _ => counts.vertex_triangle += 1,
            }
            counts.mollified += usize::from(contact.is_mollified);
        }
        counts
    }

    /// Largest force of a mollifier on an edge's direction, N.
    pub(in super::super) fn max_rotation_force_n(&self) -> f64 {
        let rotations = self.mollifier_rotations.iter();
        rotations
            .map(|rotation| rotation.gradient[0].length())
            .fold(0.0, f64::max)
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
    pub(in super::super) fn sticking_and_sliding(&self, state: &ContactState<'_>) -> [usize; 2] {
        let mut counts = [0; 2];
        for contact in &self.friction_contacts {
            let slip = contact.friction.tangential(contact.stencil.slip(state));
            counts[usize::from(slip.length() > contact.friction.epsilon)] += 1;
        }
        counts
    }
}
