//! What a report has: `report.json`. The page is drawn from it and from nothing else.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::MergeReport;
use crate::store::CpuSeconds;

/// Name of the format in the file.
pub const SYNTH_REPORT_FORMAT: &str = "gripcast-synth-report";
/// Version of the format.
pub const SYNTH_REPORT_VERSION: u32 = 1;

/// A report of a plan, its results and, where given, the dataset of them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SynthReport {
    /// [`SYNTH_REPORT_FORMAT`].
    pub format: String,
    /// [`SYNTH_REPORT_VERSION`].
    pub version: u32,
    /// `gripcast <version>` that reported.
    pub software: String,
    /// Decides which grasps and renderings are looked at.
    pub seed: u64,
    /// What was planned.
    pub plan: PlanFacts,
    /// How far it is.
    pub progress: ProgressFacts,
    /// All results by category.
    pub categories: BTreeMap<String, CategoryFacts>,
    /// The dataset, where one was given.
    pub dataset: Option<DatasetFacts>,
    /// Labels by what may decide them.
    pub balance: Vec<BalanceTable>,
    /// What the tactile images show.
    pub contact: ContactFacts,
    /// What it cost.
    pub costs: CostFacts,
    /// Simulations without a label, by outcome and reason, the most frequent first.
    pub unlabelled: Vec<UnlabelledGroup>,
    /// The contact sheet: held grasps first.
    pub examples: Vec<Example>,
}

/// What was planned.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlanFacts {
    /// Hash of the plan.
    pub sha256: String,
    /// Preset that it began with.
    pub preset: String,
    /// Its seed.
    pub seed: u64,
    /// Simulator.
    pub engine: String,
    /// `gripcast <version>` that planned.
    pub software: String,
    /// Objects.
    pub objects: usize,
    /// Their categories.
    pub categories: usize,
    /// Grasps: poses, at any force.
    pub grasps: usize,
    /// Simulations.
    pub simulations: usize,
    /// Forces, N.
    pub stop_forces_n: Vec<f64>,
    /// Renderings of each simulation.
    pub renderings: u32,
    /// Paths for each pixel of a colour image.
    pub samples: u32,
    /// Spread of the tactile sensors.
    pub sensor_spread: f64,
    /// Spread of the colour camera and the light.
    pub visual_spread: f64,
}

/// How far a plan is.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ProgressFacts {
    /// Simulations with a result.
    pub done: usize,
    /// Simulations without one.
    pub open: usize,
    /// Of the open ones, those whose result is damaged, by id.
    pub damaged: Vec<String>,
    /// Of those done, the ones that could not be simulated.
    pub failed: usize,
    /// Labels of the others, where they have one.
    pub labels: Labels,
    /// Renderings.
    pub rows: usize,
    /// Results by outcome.
    pub outcomes: BTreeMap<String, usize>,
}

/// How many simulations of a kind held, and how many were lost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Labels {
    /// The object was held.
    pub held: usize,
    /// It was lost.
    pub lost: usize,
}

impl Labels {
    /// One more.
    pub fn note(&mut self, held: bool) {
        self.held += usize::from(held);
        self.lost += usize::from(!held);
    }

    /// Both.
    pub fn all(self) -> usize {
        self.held + self.lost
    }

    /// Fraction of those that held; none of none.
    pub fn fraction(self) -> Option<f64> {
        (self.all() > 0).then(|| self.held as f64 / self.all() as f64)
    }
}

/// Results of a category.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CategoryFacts {
    /// Planned objects.
    pub objects: usize,
    /// Grasps with a label at some force.
    pub grasps: usize,
    /// Simulations with a label.
    pub labels: Labels,
}

/// A dataset.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DatasetFacts {
    /// What `synth merge` said of it.
    pub merge: MergeReport,
    /// Results that came after it was merged.
    pub later_results: usize,
}

/// Labels by one thing that may decide them.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BalanceTable {
    /// What the groups are made by, with its unit.
    pub by: String,
    /// The groups in their order; those without a label are not there.
    pub groups: Vec<BalanceGroup>,
}

/// A group of simulations.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BalanceGroup {
    /// What they share.
    pub name: String,
    /// Among all results.
    pub results: Labels,
    /// In the dataset, where one was given.
    pub dataset: Option<Labels>,
}

/// What the tactile images show, of one rendering of each simulation with a label.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ContactFacts {
    /// A pixel counts as changed above this, grey levels.
    pub changed_levels: u16,
    /// A pair with a smaller fraction of changed pixels shows no contact.
    pub least_changed: f64,
    /// By force and label.
    pub groups: Vec<ContactGroup>,
    /// By force: how well the strength of the change alone tells the labels apart.
    pub separation: Vec<Separation>,
}

/// Tactile images of a force and a label.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ContactGroup {
    /// Force, N.
    pub stop_force_n: f64,
    /// Label.
    pub held: bool,
    /// Pairs of images: two sensors of each simulation.
    pub pairs: usize,
    /// Of those, without visible contact.
    pub without: usize,
    /// Simulations whose both sensors show none.
    pub both_without: usize,
    /// Mean absolute difference of grasp and initial image, grey levels.
    pub mean_change: Quantiles,
}

/// How well the strength of the change alone tells the labels of a force apart.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Separation {
    /// Force, N.
    pub stop_force_n: f64,
    /// Probability that a held grasp changed the images more than a lost one: 0.5 tells nothing.
    /// None where there is only one label.
    pub auroc: Option<f64>,
}

/// Some numbers in short.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Quantiles {
    /// 5 % are below.
    pub p05: f64,
    /// Half are below.
    pub median: f64,
    /// 95 % are below.
    pub p95: f64,
    /// The largest.
    pub max: f64,
}

/// What the results cost. Simulations that failed have no times.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CostFacts {
    /// Simulations with times.
    pub simulations: usize,
    /// CPU time of all, s.
    pub total_s: CpuSeconds,
    /// CPU time of each, s: `prepare`, `simulate`, `tactile`, `visual`, `all`.
    pub each_s: BTreeMap<String, Quantiles>,
    /// Simulations in an hour of one core; none without times.
    pub per_core_hour: Option<f64>,
    /// The same for simulations with a label.
    pub labelled_per_core_hour: Option<f64>,
    /// By simulator and force.
    pub settings: Vec<SettingCost>,
    /// The plan's estimate against what was found; none without times.
    pub estimate: Option<EstimateFacts>,
}

/// What simulations of a simulator and a force cost.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SettingCost {
    /// Simulator.
    pub engine: String,
    /// Force, N.
    pub stop_force_n: f64,
    /// Simulations.
    pub simulations: usize,
    /// CPU time of the simulator, s.
    pub simulate_s: Quantiles,
    /// CPU time of all parts, s.
    pub all_s: Quantiles,
    /// CPU time of all, s.
    pub total_s: f64,
    /// Newton iterations of a simulation.
    pub newton_iterations: Quantiles,
    /// Steps of all.
    pub steps: usize,
    /// Steps that did not converge.
    pub unconverged_steps: usize,
    /// Simulations with such a step.
    pub unconverged_simulations: usize,
}

/// An estimate of costs against what was found.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EstimateFacts {
    /// Estimated CPU time, s.
    pub estimated_s: f64,
    /// CPU time found for the same simulations, s.
    pub found_s: f64,
    /// Found over estimated of each simulation.
    pub ratio: Quantiles,
    /// Pearson's correlation of both; none where one does not vary.
    pub correlation: Option<f64>,
}

/// Simulations without a label that have one reason.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UnlabelledGroup {
    /// Their outcome.
    pub outcome: String,
    /// The reason, numbers as `#`.
    pub reason: String,
    /// How many.
    pub count: usize,
    /// The first of them.
    pub example: String,
    /// Its reason in full.
    pub example_reason: String,
}

/// A grasp of the contact sheet.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Example {
    /// Simulation.
    pub simulation: String,
    /// Object.
    pub object: String,
    /// Its category.
    pub category: String,
    /// Its material.
    pub material: String,
    /// How the grasp departs from opposite places; none for one that was given.
    pub fault: Option<String>,
    /// Force, N.
    pub stop_force_n: f64,
    /// Coulomb friction coefficient.
    pub friction: f64,
    /// Mass, kg.
    pub mass_kg: f64,
    /// Rise of the object, m.
    pub lifted_m: f64,
    /// What became of it.
    pub outcome: String,
    /// Whether it held.
    pub held: bool,
    /// Which rendering is shown.
    pub rendering: u32,
    /// What the object looks like, in words.
    pub appearance: String,
    /// The images.
    pub images: ExampleImages,
}

/// Small images of a rendering, each a data URI.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExampleImages {
    /// The colour camera before the lift.
    pub colour: String,
    /// The left and the right sensor before the lift.
    pub grasp: [String; 2],
    /// What the contact changed in them: grey is no change.
    pub change: [String; 2],
}
