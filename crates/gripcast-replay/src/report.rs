//! What a replay found: `report.json`. The page is drawn from it and from nothing else.
//!
//! Names ending in `_m`, `_n`, `_s`, `_kg` are in SI units; poses map gripper coordinates into the
//! frame of the object's mesh (`t_object_gripper`) or object coordinates into the world
//! (`t_world_object`: z up, ground z = 0).

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use gripcast_base::statistics::wilson_interval;

/// Name of the format in the file.
pub const REPORT_FORMAT: &str = "gripcast-replay-report";
/// Version of the format.
pub const REPORT_VERSION: u32 = 1;

/// A whole report.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Report {
    /// [`REPORT_FORMAT`].
    pub format: String,
    /// [`REPORT_VERSION`].
    pub version: u32,
    /// `gripcast <version>`.
    pub software: String,
    /// When it was written, RFC 3339 UTC.
    pub written_at: String,
    /// The command that repeats it.
    pub command: String,
    /// Seed of everything that is drawn.
    pub seed: u64,
    /// What was replayed.
    pub dataset: DatasetFacts,
    /// Objects by name.
    pub objects: Vec<ObjectFacts>,
    /// Engines in the order of the tables.
    pub engines: Vec<EngineFacts>,
    /// The finite-element engine against the rigid one, where both ran.
    pub comparison: Option<EngineComparison>,
    /// Every grasp that was replayed, by object and id.
    pub grasps: Vec<GraspFacts>,
    /// What was left out, with the reason.
    pub left_out: Vec<LeftOut>,
    /// What it cost.
    pub cost: Cost,
    /// Against an earlier report.
    pub changes: Option<Changes>,
}

impl Report {
    /// The same without images and curves.
    #[must_use]
    pub fn thinned(&self) -> Self {
        let mut thin = self.clone();
        for object in &mut thin.objects {
            object.image = None;
        }
        for grasp in &mut thin.grasps {
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
        thin
    }
}

/// Where the outcomes come from.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Reality {
    /// People grasped real objects.
    Real,
    /// A simulation that stands in for reality; every page says so.
    Simulated {
        /// How it differs from the engines that replay it.
        how: String,
    },
}

/// The dataset.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DatasetFacts {
    /// Its name.
    pub name: String,
    /// Where it was.
    pub path: String,
    /// Hash of all records that were replayed, 12 hexadecimal digits.
    pub sha256: String,
    /// Grasps in it, of the objects that were asked for.
    pub grasps: usize,
    /// Where its outcomes come from.
    pub reality: Reality,
}

/// An object.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ObjectFacts {
    /// Its name in the dataset.
    pub name: String,
    /// Mesh file or `builtin:NAME`.
    pub mesh: String,
    /// Hash of the mesh as simulated, in metres.
    pub mesh_sha256: String,
    /// Triangles.
    pub triangles: usize,
    /// Extent of the mesh along its axes, m.
    pub size_m: [f64; 3],
    /// Mass, kg.
    pub mass_kg: f64,
    /// Replayed grasps.
    pub grasps: usize,
    /// Of those, stable in reality.
    pub stable: usize,
    /// Image of the object, `data:image/jpeg;base64,…`.
    pub image: Option<String>,
}

/// An engine, what it was asked, and how it did.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EngineFacts {
    /// `fem` or `rigid`.
    pub name: String,
    /// Friction coefficients that were tried.
    pub frictions: Vec<f64>,
    /// Forces that were tried, N: F_stop of the paper, or the closing force of the rigid fingers.
    pub forces_n: Vec<f64>,
    /// All other parameters.
    pub parameters: Value,
    /// Scores.
    pub scores: Scores,
    /// Grasps whose case at the chosen setting has no outcome.
    pub without_outcome: usize,
}

/// How often an engine ends as reality did. See `docs/replay.md` for the definitions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Scores {
    /// The paper's way: the best friction for all objects, then the best force for each object;
    /// chosen on the grasps that are scored.
    pub paper: Score,
    /// The same choice without the grasp that is scored.
    pub leave_one_out: Score,
    /// The best friction and force for all objects together, chosen on the grasps that are scored.
    pub one_setting: Score,
    /// The same choice without the object that is scored.
    pub leave_object_out: Score,
    /// Friction of [`Self::paper`].
    pub friction: f64,
    /// Force of [`Self::paper`] by object, N.
    pub force_n: BTreeMap<String, f64>,
    /// Friction and force of [`Self::one_setting`].
    pub one: Setting,
    /// Stable is positive; of [`Self::paper`].
    pub confusion: Confusion,
    /// Every setting.
    pub cells: Vec<CellScore>,
}

/// Friction and force.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
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

/// A fraction of grasps with its 95 % Wilson interval; cases without outcome are not counted.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Proportion {
    /// Grasps that agree.
    pub agree: usize,
    /// Grasps with an outcome.
    pub n: usize,
    /// `agree / n`; 0 where n is 0.
    pub fraction: f64,
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

impl Proportion {
    /// Of some grasps that agree among those with an outcome.
    pub(crate) fn of(agree: usize, n: usize) -> Self {
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

/// Counts by outcome in simulation and reality; stable is positive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Confusion {
    /// Stable in both.
    pub true_stable: usize,
    /// Stable in simulation, slipped in reality.
    pub false_stable: usize,
    /// Lost in both.
    pub true_slip: usize,
    /// Lost in simulation, stable in reality.
    pub false_slip: usize,
}

/// Agreement of one object at one setting.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CellScore {
    /// Object.
    pub object: String,
    /// Friction and force.
    #[serde(flatten)]
    pub setting: Setting,
    /// Grasps that agree.
    pub agree: usize,
    /// Grasps with an outcome.
    pub n: usize,
    /// Grasps without.
    pub without_outcome: usize,
}

/// Two engines on the same grasps, each at its paper's choice.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EngineComparison {
    /// Grasps where both agree with reality.
    pub both: usize,
    /// Only the finite elements do.
    pub only_fem: usize,
    /// Only the rigid engine does.
    pub only_rigid: usize,
    /// Neither.
    pub neither: usize,
    /// Two-sided p of the exact McNemar test.
    pub mcnemar_p: f64,
    /// The same counts with the leave-one-out choice: only finite elements, only rigid.
    pub leave_one_out: [usize; 2],
    /// Two-sided p of the exact McNemar test on those.
    pub leave_one_out_p: f64,
}

/// A grasp.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GraspFacts {
    /// Its id in the dataset.
    pub id: String,
    /// Object.
    pub object: String,
    /// Stable in reality.
    pub stable: bool,
    /// The gripper in the object's frame: x, y, z in m, then the quaternion w, x, y, z.
    pub t_object_gripper: [f64; 7],
    /// Standard deviation of the position along the gripper's axes, m; none where not known.
    pub pose_sd_m: Option<[f64; 3]>,
    /// The same of the rotation, rad.
    pub pose_sd_rad: Option<[f64; 3]>,
    /// What each engine made of it, in the order of the report's engines.
    pub replays: Vec<GraspReplay>,
    /// Camera's image before the lift, and the simulation's, `data:image/jpeg;base64,…`.
    pub view: Option<ImagePair>,
    /// Left and right sensor.
    pub tactile: Vec<TactilePair>,
}

/// A grasp in one engine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GraspReplay {
    /// Engine.
    pub engine: String,
    /// Friction and force of the paper's choice for its object.
    pub chosen: Setting,
    /// The case at that setting.
    pub case: CaseFacts,
    /// Whether that agrees with reality; none without outcome.
    pub agrees: Option<bool>,
    /// All settings.
    pub cells: Vec<GraspCell>,
    /// Of all settings with an outcome, the share that disagrees with reality.
    pub disagreement: f64,
    /// With poses drawn from the covariance, at the chosen setting.
    pub pose_samples: Option<PoseSamples>,
    /// Forces and heights at the chosen setting.
    pub curves: Option<Curves>,
}

/// Outcome of a case and what it took.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CaseFacts {
    /// `success`, `slip`, `eject`, `miss`, `closed`, `penetrating_start` or `not_converged`.
    pub outcome: String,
    /// Why, where there is more to say.
    pub detail: Option<String>,
    /// Height of the object's lowest point at the end, m.
    pub min_height_m: f64,
    /// Rise of the object's centre of mass, m.
    pub lifted_m: f64,
    /// Mean force of both fingers before the lift, N.
    pub force_n: Option<f64>,
    /// Time steps.
    pub steps: usize,
    /// Newton iterations in all; 0 for the rigid engine.
    pub newton_iterations: u64,
    /// Steps that did not converge.
    pub unconverged_steps: usize,
    /// CPU time of the case, s.
    pub cpu_s: f64,
}

/// A grasp at one setting.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GraspCell {
    /// Friction and force.
    #[serde(flatten)]
    pub setting: Setting,
    /// As in [`CaseFacts::outcome`].
    pub outcome: String,
    /// Whether that agrees with reality; none without outcome.
    pub agrees: Option<bool>,
}

/// Replays of one grasp with poses drawn from the covariance of its annotation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PoseSamples {
    /// Poses with an outcome.
    pub n: usize,
    /// Of those, stable.
    pub stable: usize,
}

/// Forces and heights over time, thinned for the page.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Curves {
    /// Time since contact or since the start, s.
    pub t_s: Vec<f64>,
    /// Normal force on the left finger, N.
    pub left_n: Vec<f64>,
    /// The same of the right one, N.
    pub right_n: Vec<f64>,
    /// Rise of the gripper, m.
    pub lifted_m: Vec<f64>,
    /// Height of the object's lowest point, m.
    pub min_height_m: Vec<f64>,
    /// When the adjustment and the lift begin, s.
    pub stages_s: [f64; 2],
    /// Height that the lowest point must be above at the end, m.
    pub success_height_m: f64,
}

/// Two images of the same, `data:image/jpeg;base64,…`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ImagePair {
    /// As recorded.
    pub real: String,
    /// As simulated.
    pub sim: String,
}

/// A tactile difference image (grasp minus initial, mid-grey is no change), real and simulated.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TactilePair {
    /// `left` or `right`.
    pub sensor: String,
    /// Real and simulated.
    pub images: ImagePair,
    /// Real minus simulated.
    pub difference: String,
    /// Overlap of both contact masks by their union; none where neither touches.
    pub contact_iou: Option<f64>,
    /// Fraction of the real difference's variance that the simulated one explains.
    pub fve: Option<f64>,
    /// Peak signal-to-noise ratio of the difference image, dB.
    pub psnr_db: Option<f64>,
    /// Mean absolute difference, 8-bit levels.
    pub l1: Option<f64>,
}

/// A grasp, or a case of it, that is not in the scores.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LeftOut {
    /// Its id in the dataset.
    pub grasp: String,
    /// Its object.
    pub object: String,
    /// What is missing, and how to fix it.
    pub reason: String,
}

/// What the replay took.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Cost {
    /// Cases in all.
    pub cases: usize,
    /// Of those, simulated by this run and not found finished.
    pub simulated_now: usize,
    /// Wall time of this run, s.
    pub wall_s: f64,
    /// Cases at a time.
    pub jobs: usize,
    /// CPU time of all cases by engine, s.
    pub cpu_s: BTreeMap<String, f64>,
    /// Processor.
    pub processor: String,
}

/// Differences to an earlier report.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Changes {
    /// Where that is.
    pub path: String,
    /// Its software.
    pub software: String,
    /// Score of the paper's way by engine, then and now.
    pub scores: BTreeMap<String, [Option<f64>; 2]>,
    /// Outcomes that changed.
    pub outcomes: Vec<ChangedOutcome>,
    /// Grasps that only the new report has.
    pub added: Vec<String>,
    /// Grasps that only the old one has.
    pub removed: Vec<String>,
    /// Parameters, objects or settings that differ, one sentence each.
    pub conditions: Vec<String>,
}

/// An outcome that is another one now.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ChangedOutcome {
    /// Its id in the dataset.
    pub grasp: String,
    /// Its object.
    pub object: String,
    /// Engine.
    pub engine: String,
    /// At the choice of then.
    pub before: String,
    /// At the choice of now.
    pub after: String,
    /// Whether it agrees with reality now.
    pub agrees: Option<bool>,
}
