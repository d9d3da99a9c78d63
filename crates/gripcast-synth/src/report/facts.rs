//! Contents of `report.json`, the only source of the page.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::MergeReport;
use crate::store::CpuSeconds;

/// Name of the format in the file.
pub const SYNTH_REPORT_FORMAT: &str = "gripcast-synth-report";
/// Version of the format.
pub const SYNTH_REPORT_VERSION: u32 = 2;

/// A report on a plan, its results and, if given, its dataset.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SynthReport {
    /// [`SYNTH_REPORT_FORMAT`].
    pub format: String,
    /// [`SYNTH_REPORT_VERSION`].
    pub version: u32,
    /// `gripcast <version>` that created the report.
    pub software: String,
    /// Seed that selects the inspected grasps and renderings.
    pub seed: u64,
    /// The plan.
    pub plan: PlanFacts,
    /// Progress of the plan.
    pub progress: ProgressFacts,
    /// All results by category.
    pub categories: BTreeMap<String, CategoryFacts>,
    /// The dataset, if given.
    pub dataset: Option<DatasetFacts>,
    /// Label counts by attributes that may predict the label.
    pub balance: Vec<BalanceTable>,
    /// Visible contact in the tactile images.
    pub contact: ContactFacts,
    /// CPU time.
    pub costs: CostFacts,
    /// Simulations without a label by outcome and reason, the most frequent first.
    pub unlabelled: Vec<UnlabelledGroup>,
    /// The contact sheet, stable grasps first.
    pub examples: Vec<Example>,
}

/// Summary of a plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlanFacts {
    /// SHA-256 of the plan.
    pub sha256: String,
    /// Preset it is based on.
    pub preset: String,
    /// Seed of the plan.
    pub seed: u64,
    /// Simulator.
    pub engine: String,
    /// What the friction follows from: `soiled` or `material`.
    pub friction_from: String,
    /// `gripcast <version>` that created the plan.
    pub software: String,
    /// Number of objects.
    pub objects: usize,
    /// Number of categories.
    pub categories: usize,
    /// Number of grasps: poses, at any force.
    pub grasps: usize,
    /// Number of simulations.
    pub simulations: usize,
    /// Stopping forces, N.
    pub stop_forces_n: Vec<f64>,
    /// Renderings of each simulation.
    pub renderings: u32,
    /// Samples per pixel (spp) of the colour images.
    pub samples_per_pixel: u32,
    /// Spread of the tactile sensors.
    pub sensor_spread: f64,
    /// Spread of the colour camera and the light.
    pub visual_spread: f64,
}

/// Progress of a plan.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ProgressFacts {
    /// Simulations with a result.
    pub done: usize,
    /// Simulations without one.
    pub open: usize,
    /// Ids of open simulations with a damaged result.
    pub damaged: Vec<String>,
    /// Of those done, the failed ones.
    pub failed: usize,
    /// Labels of the others.
    pub labels: LabelCounts,
    /// Number of renderings.
    pub rows: usize,
    /// Results by outcome.
    pub outcomes: BTreeMap<String, usize>,
}

/// Numbers of stable grasps and slips.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LabelCounts {
    /// Stable grasps.
    pub stable: usize,
    /// Slips.
    pub slip: usize,
}

impl LabelCounts {
    /// Counts one label.
    pub fn add(&mut self, stable: bool) {
        self.stable += usize::from(stable);
        self.slip += usize::from(!stable);
    }

    /// Total.
    pub fn total(self) -> usize {
        self.stable + self.slip
    }

    /// Fraction of stable grasps; none without grasps.
    pub fn stable_fraction(self) -> Option<f64> {
        (self.total() > 0).then(|| self.stable as f64 / self.total() as f64)
    }
}

/// Results of a category.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CategoryFacts {
    /// Number of planned objects.
    pub objects: usize,
    /// Number of grasps with a label at some force.
    pub grasps: usize,
    /// Labels of the simulations.
    pub labels: LabelCounts,
}

/// A dataset.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DatasetFacts {
    /// Description by `synth merge`.
    pub merge: MergeReport,
    /// Number of results that are newer than the dataset.
    pub later_results: usize,
}

/// Label counts by one attribute.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BalanceTable {
    /// The attribute with its unit.
    pub by: String,
    /// Groups in order, without empty ones.
    pub groups: Vec<BalanceGroup>,
}

/// A group of simulations.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BalanceGroup {
    /// Value or range of the attribute.
    pub name: String,
    /// Labels of all results.
    pub results: LabelCounts,
    /// Labels in the dataset, if given.
    pub dataset: Option<LabelCounts>,
}

/// Visible contact in the tactile images of one rendering per labelled simulation.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ContactFacts {
    /// Minimum change of a changed pixel, grey levels.
    pub changed_levels: u16,
    /// Minimum fraction of changed pixels of a pair with contact.
    pub min_changed: f64,
    /// By force and label.
    pub groups: Vec<ContactGroup>,
    /// By force: how well the strength of the change alone separates the labels.
    pub separation: Vec<Separation>,
}

/// Tactile images of a force and a label.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ContactGroup {
    /// Stopping force, N.
    pub stop_force_n: f64,
    /// Label: stable or slip.
    pub stable: bool,
    /// Number of image pairs: two sensors per simulation.
    pub pairs: usize,
    /// Number of pairs without visible contact.
    pub without: usize,
    /// Number of simulations without visible contact on both sensors.
    pub both_without: usize,
    /// Mean absolute difference of grasp and initial image, grey levels.
    pub mean_change: Quantiles,
}

/// How well the strength of the change alone separates the labels at one force.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Separation {
    /// Stopping force, N.
    pub stop_force_n: f64,
    /// Probability that a stable grasp changes the images more than a slip; 0.5 means no
    /// separation. None with only one label.
    pub auroc: Option<f64>,
}

/// Quantiles of a set of numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Quantiles {
    /// 5 % quantile.
    pub p05: f64,
    /// Median.
    pub median: f64,
    /// 95 % quantile.
    pub p95: f64,
    /// Maximum.
    pub max: f64,
}

/// CPU time of the results; failed simulations have none.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CostFacts {
    /// Number of simulations with CPU times.
    pub simulations: usize,
    /// Total CPU time by stage, s.
    pub total_s: CpuSeconds,
    /// CPU time per simulation, s: `prepare`, `simulate`, `tactile`, `visual`, `all`.
    pub each_s: BTreeMap<String, Quantiles>,
    /// Simulations per core hour; none without CPU times.
    pub per_core_hour: Option<f64>,
    /// Labelled simulations per core hour.
    pub labelled_per_core_hour: Option<f64>,
    /// By simulator and force.
    pub settings: Vec<SettingCost>,
    /// The plan's estimate compared with the measured CPU time; none without CPU times.
    pub estimate: Option<EstimateFacts>,
}

/// CPU time by simulator and force.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SettingCost {
    /// Simulator.
    pub engine: String,
    /// Stopping force, N.
    pub stop_force_n: f64,
    /// Number of simulations.
    pub simulations: usize,
    /// CPU time of the simulator per simulation, s.
    pub simulate_s: Quantiles,
    /// CPU time of all stages per simulation, s.
    pub all_s: Quantiles,
    /// Total CPU time, s.
    pub total_s: f64,
    /// Newton iterations per simulation.
    pub newton_iterations: Quantiles,
    /// Number of time steps.
    pub steps: usize,
    /// Number of steps that did not converge.
    pub unconverged_steps: usize,
    /// Number of simulations with such a step.
    pub unconverged_simulations: usize,
}

/// Estimated and measured CPU time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EstimateFacts {
    /// Estimated CPU time, s.
    pub estimated_s: f64,
    /// Measured CPU time of the same simulations, s.
    pub measured_s: f64,
    /// Measured over estimated CPU time per simulation.
    pub ratio: Quantiles,
    /// Pearson correlation of both; none if one does not vary.
    pub correlation: Option<f64>,
}

/// Simulations without a label, with the same reason.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UnlabelledGroup {
    /// Outcome.
    pub outcome: String,
    /// Reason, with numbers replaced by `#`.
    pub reason: String,
    /// Number of simulations.
    pub count: usize,
    /// Id of the first one.
    pub example: String,
    /// Full reason of the first one.
    pub example_reason: String,
}

/// A grasp of the contact sheet.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Example {
    /// Id of the simulation.
    pub simulation: String,
    /// Name of the object.
    pub object: String,
    /// Category of the object.
    pub category: String,
    /// Material of the object.
    pub material: String,
    /// Deviation from an antipodal grasp; none for a given grasp.
    pub fault: Option<String>,
    /// Stopping force, N.
    pub stop_force_n: f64,
    /// Coulomb friction coefficient.
    pub friction: f64,
    /// Mass, kg.
    pub mass_kg: f64,
    /// Rise of the object's centre of mass, m.
    pub lifted_m: f64,
    /// Simulation outcome.
    pub outcome: String,
    /// Label: stable or slip.
    pub stable: bool,
    /// Number of the rendering.
    pub rendering: u32,
    /// Description of the object's appearance.
    pub appearance: String,
    /// Images of the rendering.
    pub images: ExampleImages,
}

/// Thumbnails of a rendering as data URIs.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExampleImages {
    /// Colour camera before the lift.
    pub colour: String,
    /// Left and right sensor before the lift.
    pub grasp: [String; 2],
    /// Change by the contact; mid-grey means no change.
    pub change: [String; 2],
}
