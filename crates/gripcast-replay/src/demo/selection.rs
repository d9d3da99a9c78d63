//! Which candidates become grasps of the dataset: as many that hold as are lost.
//!
//! Every grasp's outcome is that of reality's mesh. The coarse mesh, with the same real friction and
//! force, only says which candidate to look at next. No engine that will replay the dataset is asked.

use std::collections::BTreeMap;

use super::object::DemoObject;
use super::plan::{DemoSettings, DemoStage, DemoWatch};
use super::reality::{Class, Reality, Simulated, reality, screening};
use super::sampler::{Candidate, Sampler};
use gripcast_base::error::Result;
use gripcast_base::files::BeneathPath;

/// A grasp of the dataset.
#[derive(Clone, Debug)]
pub(super) struct Chosen {
    /// Index of its object.
    pub(super) object: usize,
    /// Where the gripper was.
    pub(super) candidate: Candidate,
    /// What happened.
    pub(super) simulated: Simulated,
}

/// What is known of an object's candidates.
#[derive(Default)]
struct Known {
    /// Candidates that were drawn.
    drawn: usize,
    /// Those that are expected to be of a class, in order, not simulated yet.
    expected: BTreeMap<Class, Vec<Candidate>>,
    /// Those that were taken.
    taken: BTreeMap<Class, Vec<Chosen>>,
}

impl Known {
    /// Nothing, or what the project knows of a plan.
    fn begin(object: &DemoObject, settings: &DemoSettings) -> Result<Self> {
        let mut known = Self::default();
        let Some((_, numbers)) = known_candidates(settings)
            .iter()
            .find(|(name, _)| *name == object.name)
        else {
            return Ok(known);
        };
        let sampler = Sampler::new(object, settings.seed);
        for (class, numbers) in Class::ALL.into_iter().zip(numbers) {
            for &number in *numbers {
                let candidate = sampler.candidate(number)?;
                known.expected.entry(class).or_default().extend(candidate);
                known.drawn = known.drawn.max(number + 1);
            }
        }
        Ok(known)
    }

    fn missing(&self, class: Class, wanted: usize) -> usize {
        wanted.saturating_sub(self.taken.get(&class).map_or(0, Vec::len))
    }

    fn expected(&self, class: Class) -> usize {
        self.expected.get(&class).map_or(0, Vec::len)
    }
}

/// Candidates of an object that are expected to hold, and to be lost.
type Expected = (&'static str, [&'static [usize]; 2]);

/// What screening finds for the quick dataset of seed 0, so that it need not be done again. The
/// outcome is still simulated.
const QUICK: [Expected; 5] = [
    ("jack", [&[0, 1], &[2, 7]]),
    ("star", [&[0, 1], &[11, 13]]),
    ("dented", [&[0, 2], &[1, 3]]),
    ("saddle", [&[0, 1], &[3, 5]]),
    ("lump", [&[1, 2], &[0, 4]]),
];

fn known_candidates(settings: &DemoSettings) -> &'static [Expected] {
    match settings {
        DemoSettings {
            seed: 0,
            quick: true,
            ..
        } => &QUICK,
        _ => &[],
    }
}

/// Chooses the grasps of all objects, by object and number of the candidate. Rounds are the same for any number of threads.
///
/// # Errors
/// `Io`, `DiskFull`; `Stopped`.
pub(super) fn choose(
    objects: &[DemoObject],
    settings: &DemoSettings,
    folder: &BeneathPath,
    watch: &DemoWatch<'_>,
) -> Result<Vec<Chosen>> {
    let wanted = settings.wanted_per_label();
    let mut known = objects
        .iter()
        .map(|object| Known::begin(object, settings))
        .collect::<Result<Vec<Known>>>()?;
    let coarse: Vec<Reality<'_>> = objects
        .iter()
        .map(|object| Reality::new(object, screening(), folder))
        .collect();
    let fine: Vec<Reality<'_>> = objects
        .iter()
        .map(|object| Reality::new(object, reality(settings.quick), folder))
        .collect();
    loop {
        let batch = to_screen(objects, settings, &mut known)?;
        if !batch.is_empty() {
            let look = |(at, candidate): &(usize, Candidate)| coarse[*at].simulate(candidate);
            let stage = DemoStage::Screening;
            let found = watch.for_each(settings.jobs, stage, &batch, &look)?;
            for ((at, candidate), result) in batch.into_iter().zip(found) {
                if let Some(class) = result.class() {
                    known[at].expected.entry(class).or_default().push(candidate);
                }
            }
            continue;
        }
        let batch = to_simulate(&mut known, wanted);
        if batch.is_empty() {
            break;
        }
        let look = |(at, candidate): &(usize, Candidate)| fine[*at].simulate(candidate);
        let found = watch.for_each(settings.jobs, DemoStage::Simulating, &batch, &look)?;
        for ((at, candidate), simulated) in batch.into_iter().zip(found) {
            take(&mut known[at], wanted, at, candidate, simulated);
        }
    }
    Ok(selection(known))
}

/// Takes a grasp whose class has room.
fn take(
    known: &mut Known,
    wanted: usize,
    object: usize,
    candidate: Candidate,
    simulated: Simulated,
) {
    if let Some(class) = simulated.class()
        && simulated.grasped.is_some()
        && known.missing(class, wanted) > 0
    {
        known.taken.entry(class).or_default().push(Chosen {
            object,
            candidate,
            simulated,
        });
    }
}

/// The next candidates of the objects for which too few are expected to be of a class.
fn to_screen(
    objects: &[DemoObject],
    settings: &DemoSettings,
    known: &mut [Known],
) -> Result<Vec<(usize, Candidate)>> {
    let wanted = settings.wanted_per_label();
    let mut batch = Vec::new();
    for (at, (object, known)) in objects.iter().zip(known).enumerate() {
        let is_short = |class: &Class| known.expected(*class) < known.missing(*class, wanted);
        if !Class::ALL.iter().any(is_short) {
            continue;
        }
        let sampler = Sampler::new(object, settings.seed);
        let end = settings.max_candidates().min(known.drawn + 2 * wanted);
        for number in known.drawn..end {
            batch.extend(sampler.candidate(number)?.map(|candidate| (at, candidate)));
        }
        known.drawn = end;
    }
    Ok(batch)
}

/// Of each class as many of the expected candidates as are missing.
fn to_simulate(known: &mut [Known], wanted: usize) -> Vec<(usize, Candidate)> {
    let mut batch = Vec::new();
    for (at, known) in known.iter_mut().enumerate() {
        for class in Class::ALL {
            let missing = known.missing(class, wanted);
            let expected = known.expected.entry(class).or_default();
            let count = missing.min(expected.len());
            batch.extend(expected.drain(..count).map(|candidate| (at, candidate)));
        }
    }
    batch.sort_by_key(|(at, candidate)| (*at, candidate.number));
    batch
}

fn selection(known: Vec<Known>) -> Vec<Chosen> {
    let taken = known
        .into_iter()
        .flat_map(|known| known.taken.into_values());
    let mut grasps: Vec<Chosen> = taken.flatten().collect();
    grasps.sort_by_key(|chosen| (chosen.object, chosen.candidate.number));
    grasps
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_geometry::Pose;
    use gripcast_sim::grasp::{GraspOutcome, Placed, Snapshot, StageName};

    fn candidate(number: usize) -> Candidate {
        Candidate {
            number,
            placed: Placed {
                t_world_gripper: Pose::IDENTITY,
                opening_m: 0.05,
            },
            stop_force_n: 30.0,
        }
    }

    fn simulated(outcome: GraspOutcome) -> Simulated {
        Simulated {
            key: String::new(),
            outcome,
            lifted_m: 0.0,
            force_n: [30.0; 2],
            grasped: Some(Snapshot {
                stage: StageName::Adjustment,
                t_s: 0.0,
                t_world_object: Pose::IDENTITY,
                t_world_gripper: Pose::IDENTITY,
                opening_m: 0.04,
                gels: [Vec::new(), Vec::new()],
            }),
            cpu_s: 1.0,
        }
    }

    #[test]
    fn the_fine_outcome_counts_and_a_full_class_takes_no_more() {
        use GraspOutcome::{Eject, Miss, NotConverged, Slip, Success};
        let mut known = Known::default();
        for number in 0..6 {
            known
                .expected
                .entry(Class::Stable)
                .or_default()
                .push(candidate(number));
        }
        let mut all = [known];
        let first = to_simulate(&mut all, 2);
        assert_eq!(
            first.iter().map(|(_, c)| c.number).collect::<Vec<_>>(),
            [0, 1]
        );
        for (number, outcome) in [Slip, Success, Miss, NotConverged, Eject, Slip, Success]
            .into_iter()
            .enumerate()
        {
            take(&mut all[0], 2, 0, candidate(number), simulated(outcome));
        }
        assert!(to_simulate(&mut all, 2).is_empty());
        let chosen = selection(all.into());
        let numbers: Vec<usize> = chosen.iter().map(|g| g.candidate.number).collect();
        assert_eq!(numbers, [0, 1, 4, 6]);
    }
}
