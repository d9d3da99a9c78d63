//! Contents of `report.json`, the only source of the page.
//!
//! Keys ending in `_m`, `_n`, `_s`, `_kg` are in SI units; poses map gripper coordinates into the
//! frame of the object's mesh (`t_object_gripper`) or object coordinates into the world
//! (`t_world_object`: z up, ground z = 0).

use std::collections::BTreeMap;

use schemars::{JsonSchema, schema_for};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use gripcast_base::statistics::wilson_interval;

/// Name of the format in the file.
pub const REPORT_FORMAT: &str = "gripcast-replay-report";
/// Version of the format.
pub const REPORT_VERSION: u32 = 2;

/// Report of a replay.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Report {
    /// [`REPORT_FORMAT`].
    pub format: String,
    /// [`REPORT_VERSION`].
    pub version: u32,
    /// `gripcast <version>`.
    pub software: String,
    /// Creation time, RFC 3339 UTC.
    pub written_at: String,
    /// Command that repeats the replay.
    pub command: String,
    /// Random seed.
    pub seed: u64,
    /// The replayed dataset.
    pub dataset: DatasetFacts,
    /// Objects by name.
    pub objects: Vec<ObjectFacts>,
    /// Engines in the order of the tables.
    pub engines: Vec<EngineFacts>,
    /// Paired comparison of the finite-element and the rigid engine, if both ran.
    pub comparison: Option<EngineComparison>,
    /// Replayed grasps, sorted by object and id.
    pub grasps: Vec<GraspFacts>,
    /// Grasps and cases that are not in the scores.
    pub left_out: Vec<ExcludedGrasp>,
    /// Computing time.
    pub cost: Cost,
    /// Changes since an earlier report.
    pub changes: Option<Changes>,
}

impl Report {
    /// Returns a copy without images and curves.
    #[must_use]
    pub fn without_media(&self) -> Self {
        let mut copy = self.clone();
        for object in &mut copy.objects {
            object.image = None;
        }
        for grasp in &mut copy.grasps {
            grasp.view = None;
            for replay in &mut grasp.replays {
                replay.curves = None;
            }
            for pair in &mut grasp.tactile {
                pair.difference.clear();
                pair.images.real.clear();
                pair.images.sim.clear();
            }
        }
        copy
    }
}

/// Returns the JSON Schema (draft 2020-12) of [`Report`].
pub fn report_schema() -> Value {
    schema_for!(Report).to_value()
}

/// Source of the real outcomes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Reality {
    /// Real grasps.
    Real,
    /// A simulation that stands in for reality; every page says so.
    Simulated {
        /// How it differs from the engines of the replay.
        description: String,
    },
}

/// A replayed dataset.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DatasetFacts {
    /// Name.
    pub name: String,
    /// Path.
    pub path: String,
    /// Hash of the replayed records, 12 hexadecimal digits.
    pub sha256: String,
    /// Number of grasps of the selected objects.
    pub grasps: usize,
    /// Source of its outcomes.
    pub reality: Reality,
}

/// A grasped object.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ObjectFacts {
    /// Name in the dataset.
    pub name: String,
    /// Mesh file or `builtin:NAME`.
    pub mesh: String,
    /// Hash of the simulated mesh in metres.
    pub mesh_sha256: String,
    /// Number of triangles.
    pub triangles: usize,
    /// Extent of the mesh along its axes, m.
    pub size_m: [f64; 3],
    /// Mass, kg.
    pub mass_kg: f64,
    /// Number of replayed grasps.
    pub grasps: usize,
    /// Number of those that are stable in reality.
    pub stable: usize,
    /// Image of the object, `data:image/jpeg;base64,…`.
    pub image: Option<String>,
}

/// An engine with its settings and scores.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EngineFacts {
    /// `fem` or `rigid`.
    pub name: String,
    /// Simulated friction coefficients.
    pub frictions: Vec<f64>,
    /// Simulated forces, N: F_stop, or the closing force of the rigid fingers.
    pub forces_n: Vec<f64>,
    /// All other parameters.
    pub parameters: Value,
    /// Scores.
    pub scores: Scores,
    /// Number of grasps without an outcome at the chosen setting.
    pub without_outcome: usize,
}

/// How often an engine agrees with reality; `docs/how-to/replay.md` has the definitions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Scores {
    /// The paper's choice: the best friction for all objects, then the best force for each object;
    /// chosen on the scored grasps.
    pub paper: Score,
    /// The same choice without the scored grasp.
    pub leave_one_out: Score,
    /// The best friction and force for all objects together, chosen on the scored grasps.
    pub one_setting: Score,
    /// The same choice without the scored object.
    pub leave_object_out: Score,
    /// Friction of [`Self::paper`].
    pub friction: f64,
    /// Force of [`Self::paper`] by object, N.
    pub force_n: BTreeMap<String, f64>,
    /// Friction and force of [`Self::one_setting`].
    pub best_setting: Setting,
    /// Confusion matrix of [`Self::paper`]; stable is positive.
    pub confusion: Confusion,
    /// Agreement by object and setting.
    pub cells: Vec<CellScore>,
}

/// Friction and force.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Setting {
    /// Friction coefficient.
    pub friction: f64,
    /// Force, N.
    pub force_n: f64,
}

/// Agreement with reality.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Score {
    /// Over all grasps.
    pub all: Proportion,
    /// Mean of the objects' proportions, as in Table 1.
    pub mean: f64,
    /// By object.
    pub by_object: BTreeMap<String, Proportion>,
}

/// Fraction of agreeing grasps with its 95 % Wilson interval; cases without outcome are not
/// counted.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Proportion {
    /// Number of agreeing grasps.
    pub agree: usize,
    /// Number of grasps with an outcome.
    pub n: usize,
    /// `agree / n`; 0 if n is 0.
    pub fraction: f64,
    /// Lower bound of the interval.
    pub low: f64,
    /// Upper bound of the interval.
    pub high: f64,
}

impl Proportion {
    /// Computes the fraction and its interval.
    pub(crate) fn new(agree: usize, n: usize) -> Self {
        let [low, high] = wilson_interval(agree, n);
        let fraction = if n == 0 { 0.0 } else { agree as f64 / n as f64 };
        Self {
            agree,
            n,
            fraction,
            low,
            high,
        }
    }
}

/// Confusion matrix of simulation and reality; stable is positive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Confusion {
    /// Stable in both.
    pub true_stable: usize,
    /// Stable in simulation, slip in reality.
    pub false_stable: usize,
    /// Slip in both.
    pub true_slip: usize,
    /// Slip in simulation, stable in reality.
    pub false_slip: usize,
}

/// Agreement for one object at one setting.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CellScore {
    /// Name of the object.
    pub object: String,
    /// Friction and force.
    #[serde(flatten)]
    pub setting: Setting,
    /// Number of agreeing grasps.
    pub agree: usize,
    /// Number of grasps with an outcome.
    pub n: usize,
    /// Number of grasps without an outcome.
    pub without_outcome: usize,
}

/// Paired comparison of two engines on the same grasps, each at the paper's choice.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EngineComparison {
    /// Grasps on which both agree with reality.
    pub both: usize,
    /// Only the finite elements agree.
    pub only_fem: usize,
    /// Only the rigid engine agrees.
    pub only_rigid: usize,
    /// Neither agrees.
    pub neither: usize,
    /// Two-sided p of the exact McNemar test.
    pub mcnemar_p: f64,
    /// The same counts with the leave-one-out choice: only finite elements, only rigid.
    pub leave_one_out: [usize; 2],
    /// Two-sided p of the exact McNemar test on those.
    pub leave_one_out_p: f64,
}

/// A replayed grasp.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GraspFacts {
    /// Id in the dataset.
    pub id: String,
    /// Name of the object.
    pub object: String,
    /// Label in reality: stable or slip.
    pub stable: bool,
    /// Pose of the gripper in the object's frame: x, y, z in m, then the quaternion w, x, y, z.
    pub t_object_gripper: [f64; 7],
    /// Standard deviation of the position along the gripper's axes, m; none if unknown.
    pub pose_sd_m: Option<[f64; 3]>,
    /// Standard deviation of the rotation about the gripper's axes, rad.
    pub pose_sd_rad: Option<[f64; 3]>,
    /// Result of each engine, in the order of the report's engines.
    pub replays: Vec<GraspReplay>,
    /// Camera images before the lift.
    pub view: Option<ImagePair>,
    /// Tactile images of the left and the right sensor.
    pub tactile: Vec<TactilePair>,
}

/// Result of one grasp in one engine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GraspReplay {
    /// Name of the engine.
    pub engine: String,
    /// The paper's choice of the setting for its object.
    pub chosen: Setting,
    /// Case at that setting.
    pub case: CaseFacts,
    /// Whether it agrees with reality; none without an outcome.
    pub agrees: Option<bool>,
    /// Outcomes at all settings.
    pub cells: Vec<GraspCell>,
    /// Fraction of the settings with an outcome that disagree with reality.
    pub disagreement: f64,
    /// Results with poses drawn from the covariance, at the chosen setting.
    pub pose_samples: Option<PoseSamples>,
    /// Forces and heights at the chosen setting.
    pub curves: Option<Curves>,
}

/// Outcome and computing time of a case.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CaseFacts {
    /// `success`, `slip`, `eject`, `miss`, `closed`, `penetrating_start` `not_converged` or
    /// `refused`.
    pub outcome: String,
    /// Details of the outcome, if any.
    pub detail: Option<String>,
    /// Height of the object's lowest point at the end, m.
    pub min_height_m: f64,
    /// Rise of the object's centre of mass, m.
    pub lifted_m: f64,
    /// Mean force of both fingers before the lift, N.
    pub force_n: Option<f64>,
    /// Number of time steps.
    pub steps: usize,
    /// Number of Newton iterations; 0 for the rigid engine.
    pub newton_iterations: u64,
    /// Number of steps that did not converge.
    pub unconverged_steps: usize,
    /// CPU time of the case, s.
    pub cpu_s: f64,
}

/// Outcome of a grasp at one setting.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GraspCell {
    /// Friction and force.
    #[serde(flatten)]
    pub setting: Setting,
    /// As in [`CaseFacts::outcome`].
    pub outcome: String,
    /// Whether it agrees with reality; none without an outcome.
    pub agrees: Option<bool>,
}

/// Results of one grasp with poses drawn from the covariance of its annotation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PoseSamples {
    /// Number of poses with an outcome.
    pub n: usize,
    /// Number of stable poses.
    pub stable: usize,
}

/// Forces and heights over time, subsampled for the page.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Curves {
    /// Time, s.
    pub t_s: Vec<f64>,
    /// Normal force on the left finger, N.
    pub left_n: Vec<f64>,
    /// Normal force on the right finger, N.
    pub right_n: Vec<f64>,
    /// Rise of the gripper, m.
    pub lifted_m: Vec<f64>,
    /// Height of the object's lowest point, m.
    pub min_height_m: Vec<f64>,
    /// Start of the adjustment and of the lift, s.
    pub stages_s: [f64; 2],
    /// Minimum height of the lowest point of a stable grasp at the end, m.
    pub success_height_m: f64,
}

/// A recorded and a simulated image, `data:image/jpeg;base64,…`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ImagePair {
    /// Recorded.
    pub real: String,
    /// Simulated.
    pub sim: String,
}

/// A tactile difference image (grasp minus initial, mid-grey means no change), real and simulated.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TactilePair {
    /// `left` or `right`.
    pub sensor: String,
    /// Recorded and simulated image.
    pub images: ImagePair,
    /// Real minus simulated.
    pub difference: String,
    /// Intersection over union of both contact masks; none without contact.
    pub contact_iou: Option<f64>,
    /// Fraction of the variance of the real image that the simulated one explains (FVE).
    pub fve: Option<f64>,
    /// Peak signal-to-noise ratio of the difference image, dB.
    pub psnr_db: Option<f64>,
    /// Mean absolute difference, 8-bit levels.
    pub l1: Option<f64>,
}

/// A grasp, or cases of it, that are not in the scores.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ExcludedGrasp {
    /// Id in the dataset.
    pub grasp: String,
    /// Name of the object.
    pub object: String,
    /// Reason and remedy.
    pub reason: String,
}

/// Computing time of the replay.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Cost {
    /// Number of cases.
    pub cases: usize,
    /// Number of cases that this run simulated.
    pub simulated_now: usize,
    /// Wall time of this run, s.
    pub wall_s: f64,
    /// Cases in parallel.
    pub jobs: usize,
    /// Total CPU time by engine, s.
    pub cpu_s: BTreeMap<String, f64>,
    /// Processor name and number of cores.
    pub processor: String,
}

/// Changes since an earlier report.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Changes {
    /// Path of the earlier report.
    pub path: String,
    /// Software of the earlier report.
    pub software: String,
    /// Score of the paper's choice by engine: earlier and current.
    pub scores: BTreeMap<String, [Option<f64>; 2]>,
    /// Changed outcomes.
    pub outcomes: Vec<ChangedOutcome>,
    /// Grasps only in the current report.
    pub added: Vec<String>,
    /// Grasps only in the earlier report.
    pub removed: Vec<String>,
    /// Differences of parameters, objects and settings.
    pub conditions: Vec<String>,
}

/// A changed outcome.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ChangedOutcome {
    /// Id in the dataset.
    pub grasp: String,
    /// Name of the object.
    pub object: String,
    /// Name of the engine.
    pub engine: String,
    /// Earlier outcome at the chosen setting.
    pub before: String,
    /// Current outcome at the chosen setting.
    pub after: String,
    /// Whether the current outcome agrees with reality; none without an outcome.
    pub agrees: Option<bool>,
}

#[cfg(test)]
#[path = "report_test.rs"]
mod tests;
