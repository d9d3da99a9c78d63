//! Visible contact in the tactile images, by force and label.
//!
//! If slips showed no contact, a model could predict the label from that alone.

use super::facts::{ContactFacts, ContactGroup, Quantiles, Separation};
use super::inspect::{CHANGED_LEVELS, MIN_CHANGED, TactileChange};
use super::numbers::auroc;
use super::results::{FinishedSimulation, distinct};

/// A labelled simulation whose images were inspected.
pub(super) struct InspectedSimulation<'a> {
    pub(super) done: &'a FinishedSimulation<'a>,
    pub(super) stable: bool,
    pub(super) change: TactileChange,
}

impl InspectedSimulation<'_> {
    fn without_contact(&self) -> usize {
        let changed = self.change.changed.iter();
        changed.filter(|fraction| **fraction < MIN_CHANGED).count()
    }

    fn strength(&self) -> f64 {
        self.change.mean_change.iter().sum()
    }
}

/// Summarises the inspected simulations.
pub(super) fn contact(inspected: &[InspectedSimulation<'_>]) -> ContactFacts {
    let forces = distinct(inspected.iter().map(|one| one.done.simulation.stop_force_n));
    let mut facts = ContactFacts {
        changed_levels: CHANGED_LEVELS,
        min_changed: MIN_CHANGED,
        ..ContactFacts::default()
    };
    for stop_force_n in forces {
        let mut strengths = [Vec::new(), Vec::new()];
        for stable in [true, false] {
            let of_group = |one: &&InspectedSimulation<'_>| {
                one.stable == stable && one.done.simulation.stop_force_n == stop_force_n
            };
            let group: Vec<&InspectedSimulation<'_>> = inspected.iter().filter(of_group).collect();
            strengths[usize::from(stable)] = group.iter().map(|one| one.strength()).collect();
            if !group.is_empty() {
                facts
                    .groups
                    .push(contact_group(stop_force_n, stable, &group));
            }
        }
        facts.separation.push(Separation {
            stop_force_n,
            auroc: auroc(&strengths[1], &strengths[0]),
        });
    }
    facts
}

fn contact_group(
    stop_force_n: f64,
    stable: bool,
    group: &[&InspectedSimulation<'_>],
) -> ContactGroup {
    let without = group.iter().map(|one| one.without_contact());
    ContactGroup {
        stop_force_n,
        stable,
        pairs: 2 * group.len(),
        without: without.clone().sum(),
        both_without: without.filter(|without| *without == 2).count(),
        mean_change: Quantiles::of(group.iter().flat_map(|one| one.change.mean_change)),
    }
}

#[cfg(test)]
mod tests {
    use super::super::sample::{Sample, labelled};
    use super::*;

    #[test]
    fn pairs_without_contact_and_separation_are_counted() {
        let sample = Sample::new(8);
        // At 10 N stable grasps have stronger contact, at 40 N all are alike.
        let stable = [true, true, true, false, false, true, false, false];
        let plan_results = labelled(&sample, &stable);
        let seen = plan_results
            .labelled()
            .enumerate()
            .map(|(k, (done, stable))| {
                let is_weak = k % 2 == 0 && !stable;
                InspectedSimulation {
                    done,
                    stable,
                    change: TactileChange {
                        rendering: 0,
                        appearance: String::new(),
                        mean_change: if is_weak { [0.1, 0.2] } else { [3.0, 4.0] },
                        changed: [
                            if is_weak { 0.0 } else { 0.2 },
                            if k == 4 { 0.0 } else { 0.1 },
                        ],
                        images: None,
                    },
                }
            });
        let facts = contact(&seen.collect::<Vec<_>>());
        let counts: Vec<_> = facts
            .groups
            .iter()
            .map(|g| (g.stop_force_n, g.stable, g.pairs, g.without, g.both_without))
            .collect();
        let expected = [
            (10.0, true, 4, 0, 0),
            (10.0, false, 4, 3, 1),
            (40.0, true, 4, 0, 0),
            (40.0, false, 4, 0, 0),
        ];
        assert_eq!(counts, expected);
        assert_eq!(facts.groups[1].mean_change.max, 0.2);
        let auroc: Vec<_> = facts.separation.iter().map(|s| s.auroc).collect();
        assert_eq!(auroc, [Some(1.0), Some(0.5)]);
    }
}
