//! Selects the grasps of the dataset: as many stable ones as slips.
//!
//! Every outcome is that of reality's mesh. The coarse mesh, with the same true friction and force,
//! only decides which candidate to simulate next. No engine of the replay is involved.

use std::collections::BTreeMap;

use super::object::DemoObject;
use super::plan::{DemoSettings, DemoStage, DemoWatch};
use super::reality::{CandidateSimulator, GraspLabel, SimulatedCandidate, reality, screening};
use gripcast_base::error::Result;
use gripcast_base::files::BeneathPath;
use gripcast_sim::FemEngine;
use gripcast_sim::grasp::GripperState;
use gripcast_synth::grasp::{FaultRanges, GraspSampler};

/// Range of a person's squeezing force, N.
const FORCE_N: [f64; 2] = [25.0, 50.0];

/// A sampled grasp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Candidate {
    /// Number of the sample.
    pub(super) number: usize,
    /// Pose and opening of the gripper.
    pub(super) placed: GripperState,
    /// Squeezing force of the person, N.
    pub(super) stop_force_n: f64,
}

fn sampler(object: &DemoObject, seed: u64) -> GraspSampler<'_> {
    let (mesh, pose) = (&object.mesh, object.t_world_object);
    GraspSampler::new(&object.name, mesh, pose, FaultRanges::COLLECTED, seed)
}

fn candidate(sampler: &GraspSampler<'_>, number: usize) -> Result<Option<Candidate>> {
    let drawn = sampler.candidate(number)?;
    Ok(drawn.map(|drawn| Candidate {
        number,
        placed: drawn.placed,
        stop_force_n: FORCE_N[0] + (FORCE_N[1] - FORCE_N[0]) * drawn.squeeze,
    }))
}

/// A grasp of the dataset.
#[derive(Clone, Debug)]
pub(super) struct SelectedGrasp {
    /// Index of the object.
    pub(super) object: usize,
    /// Gripper pose and force.
    pub(super) candidate: Candidate,
    /// Simulated result.
    pub(super) simulated: SimulatedCandidate,
}

/// Candidates of one object.
#[derive(Default)]
struct CandidatePool {
    /// Number of sampled candidates.
    drawn: usize,
    /// Candidates by expected label, not simulated yet.
    expected: BTreeMap<GraspLabel, Vec<Candidate>>,
    /// Selected grasps by label.
    selected: BTreeMap<GraspLabel, Vec<SelectedGrasp>>,
}

impl CandidatePool {
    /// Creates a pool, with the known candidates of the quick dataset.
    fn new(object: &DemoObject, settings: &DemoSettings) -> Result<Self> {
        let mut pool = Self::default();
        let Some((_, numbers)) = known_candidates(settings)
            .iter()
            .find(|(name, _)| *name == object.name)
        else {
            return Ok(pool);
        };
        let sampler = sampler(object, settings.seed);
        for (label, numbers) in GraspLabel::ALL.into_iter().zip(numbers) {
            for &number in *numbers {
                let candidate = candidate(&sampler, number)?;
                pool.expected.entry(label).or_default().extend(candidate);
                pool.drawn = pool.drawn.max(number + 1);
            }
        }
        Ok(pool)
    }

    fn missing(&self, label: GraspLabel, wanted: usize) -> usize {
        wanted.saturating_sub(self.selected.get(&label).map_or(0, Vec::len))
    }

    /// Adds a grasp if more grasps with its label are wanted.
    fn add(&mut self, grasp: SelectedGrasp, wanted: usize) {
        if let Some(label) = grasp.simulated.label()
            && grasp.simulated.pre_lift.is_some()
            && self.missing(label, wanted) > 0
        {
            self.selected.entry(label).or_default().push(grasp);
        }
    }

    fn expected(&self, label: GraspLabel) -> usize {
        self.expected.get(&label).map_or(0, Vec::len)
    }
}

/// Object name, and its candidates that are expected to be stable and to slip.
type Expected = (&'static str, [&'static [usize]; 2]);

/// Results of screening for the quick dataset with seed 0. The outcomes are still simulated.
const QUICK: [Expected; 5] = [
    ("jack", [&[0, 1], &[2, 7]]),
    ("star", [&[0, 1], &[11, 13]]),
    ("dented", [&[0, 2], &[1, 3]]),
    ("saddle", [&[0, 1], &[3, 5]]),
    ("lump", [&[1, 2], &[0, 4]]),
];

fn known_candidates(settings: &DemoSettings) -> &'static [Expected] {
    let has_known = settings.quick && settings.seed == 0;
    if has_known { &QUICK } else { &[] }
}

/// Selects the grasps of all objects, sorted by object and candidate. The result does not depend on
/// the number of threads.
///
/// # Errors
/// `Io`, `DiskFull`; `Stopped`.
pub(super) fn select(
    objects: &[DemoObject],
    settings: &DemoSettings,
    folder: &BeneathPath,
    watch: &DemoWatch<'_>,
) -> Result<Vec<SelectedGrasp>> {
    let wanted = settings.wanted_per_label();
    let mut pools = objects
        .iter()
        .map(|object| CandidatePool::new(object, settings))
        .collect::<Result<Vec<CandidatePool>>>()?;
    let simulators = |engine: &dyn Fn() -> FemEngine| -> Vec<CandidateSimulator<'_>> {
        let simulator = |object| CandidateSimulator::new(object, engine(), folder);
        objects.iter().map(simulator).collect()
    };
    let (coarse, fine) = (
        simulators(&screening),
        simulators(&|| reality(settings.quick)),
    );
    let simulate = |simulators: &[CandidateSimulator<'_>], stage, batch: &[(usize, Candidate)]| {
        watch.for_each(settings.jobs, stage, batch, &|(object, candidate)| {
            simulators[*object].simulate(candidate)
        })
    };
    loop {
        let batch = to_screen(objects, settings, &mut pools)?;
        if !batch.is_empty() {
            let results = simulate(&coarse, DemoStage::Screening, &batch)?;
            for ((object, candidate), result) in batch.into_iter().zip(results) {
                if let Some(label) = result.label() {
                    let expected = pools[object].expected.entry(label);
                    expected.or_default().push(candidate);
                }
            }
            continue;
        }
        let batch = to_simulate(&mut pools, wanted);
        if batch.is_empty() {
            return Ok(selection(pools));
        }
        let results = simulate(&fine, DemoStage::Simulating, &batch)?;
        for ((object, candidate), simulated) in batch.into_iter().zip(results) {
            let grasp = SelectedGrasp {
                object,
                candidate,
                simulated,
            };
            pools[object].add(grasp, wanted);
        }
    }
}

/// Samples the next candidates of objects with too few expected grasps of a label.
fn to_screen(
    objects: &[DemoObject],
    settings: &DemoSettings,
    pools: &mut [CandidatePool],
) -> Result<Vec<(usize, Candidate)>> {
    let wanted = settings.wanted_per_label();
    let mut batch = Vec::new();
    for (index, (object, pool)) in objects.iter().zip(pools).enumerate() {
        let is_short = |label: &GraspLabel| pool.expected(*label) < pool.missing(*label, wanted);
        if !GraspLabel::ALL.iter().any(is_short) {
            continue;
        }
        let sampler = sampler(object, settings.seed);
        let end = settings.max_candidates().min(pool.drawn + 2 * wanted);
        for number in pool.drawn..end {
            let candidate = candidate(&sampler, number)?;
            batch.extend(candidate.map(|candidate| (index, candidate)));
        }
        pool.drawn = end;
    }
    Ok(batch)
}

/// Takes as many expected candidates of each label as are missing.
fn to_simulate(pools: &mut [CandidatePool], wanted: usize) -> Vec<(usize, Candidate)> {
    let mut batch = Vec::new();
    for (index, pool) in pools.iter_mut().enumerate() {
        for label in GraspLabel::ALL {
            let missing = pool.missing(label, wanted);
            let expected = pool.expected.entry(label).or_default();
            let count = missing.min(expected.len());
            batch.extend(expected.drain(..count).map(|candidate| (index, candidate)));
        }
    }
    batch.sort_by_key(|(index, candidate)| (*index, candidate.number));
    batch
}

fn selection(pools: Vec<CandidatePool>) -> Vec<SelectedGrasp> {
    let by_label = pools
        .into_iter()
        .flat_map(|pool| pool.selected.into_values());
    let mut grasps: Vec<SelectedGrasp> = by_label.flatten().collect();
    grasps.sort_by_key(|grasp| (grasp.object, grasp.candidate.number));
    grasps
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_geometry::Pose;
    use gripcast_sim::grasp::{GraspOutcome, Snapshot, StageName};

    fn candidate(number: usize) -> Candidate {
        Candidate {
            number,
            placed: GripperState {
                t_world_gripper: Pose::IDENTITY,
                opening_m: 0.05,
            },
            stop_force_n: 30.0,
        }
    }

    fn simulated(outcome: GraspOutcome) -> SimulatedCandidate {
        SimulatedCandidate {
            key: String::new(),
            outcome,
            lifted_m: 0.0,
            force_n: [30.0; 2],
            pre_lift: Some(Snapshot {
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
    fn squeezing_forces_are_25_to_50_n() {
        let settings = DemoSettings {
            seed: 4,
            quick: true,
            shared: None,
            jobs: 1,
        };
        for object in crate::demo::object::objects(&settings).unwrap() {
            let drawn = super::candidate(&sampler(&object, 4), 1).unwrap().unwrap();
            assert!((25.0..=50.0).contains(&drawn.stop_force_n));
        }
    }

    #[test]
    fn fine_outcome_decides_and_complete_labels_are_closed() {
        use GraspOutcome::{Eject, Miss, NotConverged, Slip, Success};
        let mut pool = CandidatePool::default();
        for number in 0..6 {
            pool.expected
                .entry(GraspLabel::Stable)
                .or_default()
                .push(candidate(number));
        }
        let mut all = [pool];
        let first = to_simulate(&mut all, 2);
        assert_eq!(
            first.iter().map(|(_, c)| c.number).collect::<Vec<_>>(),
            [0, 1]
        );
        for (number, outcome) in [Slip, Success, Miss, NotConverged, Eject, Slip, Success]
            .into_iter()
            .enumerate()
        {
            let grasp = SelectedGrasp {
                object: 0,
                candidate: candidate(number),
                simulated: simulated(outcome),
            };
            all[0].add(grasp, 2);
        }
        assert!(to_simulate(&mut all, 2).is_empty());
        let selected = selection(all.into());
        let numbers: Vec<usize> = selected.iter().map(|g| g.candidate.number).collect();
        assert_eq!(numbers, [0, 1, 4, 6]);
    }
}
