//! Number of grasps by outcome and object.

use std::collections::BTreeMap;

use super::grasp::Outcome;
use gripcast_base::files::ObjectName;

/// Number of grasps by outcome, and by object and outcome.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct GraspCounts {
    /// Grasps by outcome.
    pub by_outcome: BTreeMap<Outcome, usize>,
    /// Grasps by object and outcome.
    pub by_object: BTreeMap<ObjectName, BTreeMap<Outcome, usize>>,
}

impl GraspCounts {
    /// Adds one grasp.
    pub(super) fn add(&mut self, object: &ObjectName, outcome: Outcome) {
        *self.by_outcome.entry(outcome).or_default() += 1;
        *self
            .by_object
            .entry(object.clone())
            .or_default()
            .entry(outcome)
            .or_default() += 1;
    }

    /// All grasps.
    #[must_use]
    pub fn total(&self) -> usize {
        self.by_outcome.values().sum()
    }

    /// Grasps with an outcome.
    #[must_use]
    pub fn outcome(&self, outcome: Outcome) -> usize {
        self.by_outcome.get(&outcome).copied().unwrap_or(0)
    }
}
