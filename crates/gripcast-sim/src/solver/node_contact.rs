//! Stick or slip of a gel's nodes.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::{ContactState, GelContact, Obstacle};

/// Whether a node of a gel touches the object, and whether it slides on it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NodeContact {
    /// No contact at the end of the step. Where the contact ended within the step, friction lagged
    /// from its start may still act on the node.
    #[default]
    Open,
    /// The tangential speed is below `eps_v`, so that friction is below its limit.
    Stick,
    /// The tangential speed is `eps_v` or more, so that friction is at its limit.
    Slip,
}

impl NodeContact {
    /// All states, by their code in files.
    pub const ALL: [Self; 3] = [Self::Open, Self::Stick, Self::Slip];
}

impl GelContact {
    /// Stick or slip of each node over the step that has ended.
    ///
    /// A node's tangential displacement is the mean over its contacts, weighted by the normal force
    /// that each puts on it; `epsilon` is `eps_v dt` (m), as in [`crate::contact::friction`].
    pub(in super::super) fn node_contacts(
        &self,
        state: &ContactState<'_>,
        epsilon: f64,
    ) -> Vec<NodeContact> {
        let mut sums = vec![(0.0, DVec3::ZERO); state.x.len()];
        for contact in &self.contacts {
            let u = contact.stencil.slip(state);
            let tangential = u - contact.normal * contact.normal.dot(u);
            for (node, weight) in contact.stencil.gel() {
                let load = -contact.first * weight;
                sums[node].0 += load;
                sums[node].1 += tangential * load;
            }
        }
        let state = |(load, moment): (f64, DVec3)| match load > 0.0 {
            false => NodeContact::Open,
            true if moment.length() < epsilon * load => NodeContact::Stick,
            true => NodeContact::Slip,
        };
        sums.into_iter().map(state).collect()
    }
}

impl super::super::Gel {
    /// Stick or slip of each node over the step that has ended.
    pub(in super::super) fn node_contacts(
        &self,
        obstacle: Obstacle<'_>,
        epsilon: f64,
    ) -> Vec<NodeContact> {
        let state = ContactState {
            obstacle,
            x: &self.x,
            start: &self.start,
        };
        let mut contacts = self.contact.node_contacts(&state, epsilon);
        // Contacts are not searched for in steps of free motion.
        for (contact, force) in contacts.iter_mut().zip(self.contact_forces()) {
            if force == DVec3::ZERO {
                *contact = NodeContact::Open;
            }
        }
        contacts
    }
}
