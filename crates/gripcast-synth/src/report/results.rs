//! Results of a plan, as far as they exist.

use std::collections::{BTreeMap, BTreeSet};

use super::facts::{CategoryFacts, PlanFacts, ProgressFacts};
use crate::plan::{Plan, PlannedObject, PlannedSimulation};
use crate::store::{ResultStore, SimulationResult};
use gripcast_base::error::Result;

/// A simulation with its result.
#[derive(Clone, Debug)]
pub(super) struct FinishedSimulation<'a> {
    pub(super) simulation: &'a PlannedSimulation,
    pub(super) object: &'a PlannedObject,
    pub(super) result: SimulationResult,
}

/// Results of a plan, in the order of the plan.
#[derive(Clone, Debug, Default)]
pub(super) struct PlanResults<'a> {
    pub(super) done: Vec<FinishedSimulation<'a>>,
    pub open: usize,
    pub(super) damaged: Vec<String>,
}

impl<'a> PlanResults<'a> {
    /// Reads all results.
    ///
    /// # Errors
    /// `Input` for results of another plan.
    pub(super) fn read(plan: &'a Plan, store: &ResultStore) -> Result<Self> {
        let mut read = Self::default();
        for simulation in &plan.simulations {
            let Some(result) = store.load(plan, &simulation.id)? else {
                read.open += 1;
                if store.has_file(&simulation.id) {
                    read.damaged.push(simulation.id.to_string());
                }
                continue;
            };
            read.done.push(FinishedSimulation {
                simulation,
                object: plan.object(simulation)?,
                result,
            });
        }
        Ok(read)
    }

    /// Results with a label; true is stable.
    pub(super) fn labelled(&self) -> impl Iterator<Item = (&FinishedSimulation<'a>, bool)> {
        let pairs = self.done.iter().map(|done| (done, done.result.stable));
        pairs.filter_map(|(done, stable)| Some((done, stable?)))
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
        for (_, stable) in self.labelled() {
            facts.labels.add(stable);
        }
        facts
    }

    /// Summarises the results by category, including categories without results.
    pub(super) fn categories(&self, plan: &Plan) -> BTreeMap<String, CategoryFacts> {
        let mut categories: BTreeMap<String, CategoryFacts> = BTreeMap::new();
        for object in plan.objects.values() {
            let facts = categories.entry(object.category.clone()).or_default();
            facts.objects += 1;
        }
        let mut grasps = BTreeSet::new();
        for (done, stable) in self.labelled() {
            let facts = categories.entry(done.object.category.clone()).or_default();
            facts.labels.add(stable);
            let is_new = grasps.insert((&done.object.name, done.simulation.grasp));
            facts.grasps += usize::from(is_new);
        }
        categories
    }
}

/// Summarises a plan.
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
        friction_from: header.friction_from.name().to_owned(),
        software: header.software.clone(),
        objects: plan.objects.len(),
        categories: categories.len(),
        grasps: grasps.len(),
        simulations: plan.simulations.len(),
        stop_forces_n: distinct(simulations.map(|one| one.stop_force_n)),
        renderings: header.rendering.renderings,
        samples_per_pixel: header.rendering.samples_per_pixel,
        sensor_spread: header.rendering.sensor_spread,
        visual_spread: header.rendering.visual_spread,
    }
}

/// Returns the distinct values in ascending order.
pub(super) fn distinct(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.dedup();
    values
}
