//! What the tactile images show, by force and label.
//!
//! A dataset whose lost grasps show no contact would give its labels away.

use super::facts::{ContactFacts, ContactGroup, Quantiles, Separation};
use super::gather::{Done, different};
use super::look::{CHANGED_LEVELS, Look, MIN_CHANGED};
use super::numbers::auroc;

/// A simulation with a label that was looked at.
pub(super) struct Seen<'a> {
    pub(super) done: &'a Done<'a>,
    pub(super) held: bool,
    pub(super) look: Look,
}

impl Seen<'_> {
    fn without(&self) -> usize {
        let changed = self.look.changed.iter();
        changed.filter(|fraction| **fraction < MIN_CHANGED).count()
    }

    fn strength(&self) -> f64 {
        self.look.mean_change.iter().sum()
    }
}

/// The facts of what was looked at.
pub(super) fn contact(seen: &[Seen<'_>]) -> ContactFacts {
    let forces = different(seen.iter().map(|one| one.done.simulation.stop_force_n));
    let mut facts = ContactFacts {
        changed_levels: CHANGED_LEVELS,
        least_changed: MIN_CHANGED,
        ..ContactFacts::default()
    };
    for stop_force_n in forces {
        let mut strengths = [Vec::new(), Vec::new()];
        for held in [true, false] {
            let of_group = |one: &&Seen<'_>| {
                one.held == held && one.done.simulation.stop_force_n == stop_force_n
            };
            let group: Vec<&Seen<'_>> = seen.iter().filter(of_group).collect();
            strengths[usize::from(held)] = group.iter().map(|one| one.strength()).collect();
            if !group.is_empty() {
                facts.groups.push(of(stop_force_n, held, &group));
            }
        }
        facts.separation.push(Separation {
            stop_force_n,
            auroc: auroc(&strengths[1], &strengths[0]),
        });
    }
    facts
}

fn of(stop_force_n: f64, held: bool, group: &[&Seen<'_>]) -> ContactGroup {
    let without = group.iter().map(|one| one.without());
    ContactGroup {
        stop_force_n,
        held,
        pairs: 2 * group.len(),
        without: without.clone().sum(),
        both_without: without.filter(|without| *without == 2).count(),
        mean_change: Quantiles::of(group.iter().flat_map(|one| one.look.mean_change)),
    }
}

#[cfg(test)]
mod tests {
    use super::super::sample::{Sample, labelled};
    use super::*;

    #[test]
    fn pairs_without_contact_and_what_strength_tells_are_counted() {
        let sample = Sample::new(8);
        // At 10 N the held ones are stronger, at 40 N all are alike.
        let held = [true, true, true, false, false, true, false, false];
        let gathered = labelled(&sample, &held);
        let seen = gathered.labelled().enumerate().map(|(k, (done, held))| {
            let is_weak = k % 2 == 0 && !held;
            Seen {
                done,
                held,
                look: Look {
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
            .map(|g| (g.stop_force_n, g.held, g.pairs, g.without, g.both_without))
            .collect();
        let expected = [
            (10.0, true, 4, 0, 0),
            (10.0, false, 4, 3, 1),
            (40.0, true, 4, 0, 0),
            (40.0, false, 4, 0, 0),
        ];
        assert_eq!(counts, expected);
        assert_eq!(facts.groups[1].mean_change.max, 0.2);
        let told: Vec<_> = facts.separation.iter().map(|s| s.auroc).collect();
        assert_eq!(told, [Some(1.0), Some(0.5)]);
    }
}
