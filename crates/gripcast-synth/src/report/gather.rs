//! The results of a plan as far as they are there.

use std::collections::{BTreeMap, BTreeSet};

use super::facts::{CategoryFacts, PlanFacts, ProgressFacts};
use crate::plan::{Plan, PlannedObject, PlannedSimulation};
use crate::store::{ResultStore, SimulationResult};
use gripcast_base::error::Result;

/// A simulation with its result.
#[derive(Clone, Debug)]
pub(super) struct Done<'a> {
    pub(super) simulation: &'a PlannedSimulation,
    pub(super) object: &'a PlannedObject,
    pub(super) result: SimulationResult,
}

impl Done<'_> {
    /// CPU time of all parts, s.
    pub(super) fn cpu_s(&self) -> f64 {
        let cpu = self.result.cpu_s;
        cpu.prepare + cpu.simulate + cpu.tactile + cpu.visual
    }
}

/// The results of a plan, in its order.
#[derive(Clone, Debug, Default)]
pub(super) struct Gathered<'a> {
    pub(super) done: Vec<Done<'a>>,
    pub open: usize,
    pub(super) damaged: Vec<String>,
}

impl<'a> Gathered<'a> {
    /// Reads all results.
    ///
    /// # Errors
    /// `Input` for results of another plan.
    pub(super) fn read(plan: &'a Plan, store: &ResultStore) -> Result<Self> {
        let mut gathered = Self::default();
        for simulation in &plan.simulations {
            let Some(result) = store.find(plan, &simulation.id)? else {
                gathered.open += 1;
                if store.is_begun(&simulation.id) {
                    gathered.damaged.push(simulation.id.to_string());
                }
                continue;
            };
            gathered.done.push(Done {
                simulation,
                object: plan.object(simulation)?,
                result,
            });
        }
        Ok(gathered)
    }

    /// Results with a label, and whether they held.
    pub(super) fn labelled(&self) -> impl Iterator<Item = (&Done<'a>, bool)> {
        let pairs = self.done.iter().map(|done| (done, done.result.stable));
        pairs.filter_map(|(done, held)| Some((done, held?)))
    }

    pub(super) fn progress(&self) -> ProgressFacts {
        let mut facts = ProgressFacts {
            done: self.done.len(),
            open: self.open,
            damaged: self.damaged.clone(),
            ..ProgressFacts::default()
        };
        for done in &self.done {
            let result = &done.result;
            facts.failed += usize::from(result.is_failed());
            facts.rows += result.samples.as_ref().map_or(0, |file| file.rows);
            *facts.outcomes.entry(result.outcome.clone()).or_default() += 1;
        }
        for (_, held) in self.labelled() {
            facts.labels.note(held);
        }
        facts
    }

    /// Results by category; planned ones without results are there too.
    pub(super) fn categories(&self, plan: &Plan) -> BTreeMap<String, CategoryFacts> {
        let mut categories: BTreeMap<String, CategoryFacts> = BTreeMap::new();
        for object in plan.objects.values() {
            let facts = categories.entry(object.category.clone()).or_default();
            facts.objects += 1;
        }
        let mut grasps = BTreeSet::new();
        for (done, held) in self.labelled() {
            let facts = categories.entry(done.object.category.clone()).or_default();
            facts.labels.note(held);
            let is_new = grasps.insert((&done.object.name, done.simulation.grasp));
            facts.grasps += usize::from(is_new);
        }
        categories
    }
}

/// What was planned.
pub(super) fn plan_facts(plan: &Plan) -> PlanFacts {
    let header = &plan.header;
    let categories: BTreeSet<&str> = plan.objects.values().map(|o| &*o.category).collect();
    let simulations = plan.simulations.iter();
    let grasps: BTreeSet<(&str, u32)> = simulations
        .clone()
        .map(|one| (&*one.object, one.grasp))
        .collect();
    PlanFacts {
        sha256: plan.sha256.clone(),
        preset: header.preset.clone(),
        seed: header.seed,
        engine: header.engine.name().to_owned(),
        software: header.software.clone(),
        objects: plan.objects.len(),
        categories: categories.len(),
        grasps: grasps.len(),
        simulations: plan.simulations.len(),
        stop_forces_n: different(simulations.map(|one| one.stop_force_n)),
        renderings: header.rendering.renderings,
        samples: header.rendering.samples,
        sensor_spread: header.rendering.sensor_spread,
        visual_spread: header.rendering.visual_spread,
    }
}

/// Every value once, the least first.
pub(super) fn different(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.dedup();
    values
}
