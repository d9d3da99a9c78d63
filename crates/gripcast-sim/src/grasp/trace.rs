//! Trace of a grasp: every time step, and snapshots at the ends of the stages.

use serde::{Deserialize, Serialize};

use crate::fields::FieldSeries;
use crate::solver::StepReport;
use gripcast_geometry::Pose;

/// Stage of the grasp protocol.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StageName {
    /// Finger closure.
    Closure,
    /// Force adjustment.
    Adjustment,
    /// Lift of the gripper.
    Lift,
}

impl StageName {
    /// All stages in order.
    pub const ALL: [Self; 3] = [Self::Closure, Self::Adjustment, Self::Lift];

    /// Name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Closure => "closure",
            Self::Adjustment => "adjustment",
            Self::Lift => "lift",
        }
    }
}

/// Contact force on the passive (not driven) nodes of a gel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct GelForce {
    /// Force of contact and friction against the closing direction, N: f_c of the paper.
    pub normal_n: f64,
    /// Force on the gel along the gripper's y and z axes, N.
    pub shear_n: [f64; 2],
    /// Torque on the gel about the closing direction through the pad's centre, N m.
    pub torque_n_m: f64,
}

/// State at the end of a time step.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TraceStep {
    /// Stage of the protocol.
    pub stage: StageName,
    /// Time since the start, s.
    pub t_s: f64,
    /// Force on the left and right gel.
    pub force: [GelForce; 2],
    /// Pose of the object in the world.
    pub t_world_object: Pose,
    /// Distance between the undeformed gel faces, m.
    pub opening_m: f64,
    /// Lift of the gripper so far, m.
    pub lifted_m: f64,
    /// Smallest distance between each gel and the object, m; `None` beyond `d_hat`.
    pub min_gap_m: [Option<f64>; 2],
    /// Work of the solver; `None` for steps of free motion.
    pub solver: Option<StepReport>,
}

/// State at the end of a stage, for renderers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Snapshot {
    /// Stage that has ended.
    pub stage: StageName,
    /// Time since the start, s.
    pub t_s: f64,
    /// Pose of the object in the world.
    pub t_world_object: Pose,
    /// Pose of the gripper in the world.
    pub t_world_gripper: Pose,
    /// Distance between the undeformed gel faces, m.
    pub opening_m: f64,
    /// Node positions of both gels in the world, m.
    pub gels: [Vec<[f64; 3]>; 2],
}

/// Trace of a whole grasp.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Trace {
    /// All time steps.
    pub steps: Vec<TraceStep>,
    /// States at the ends of the stages.
    pub snapshots: Vec<Snapshot>,
    /// States in the first millimetres of the lift, at the frame rate of a sensor
    /// ([`GraspRecord`](super::GraspRecord)); in no file of a trace.
    #[serde(skip)]
    pub lift_snapshots: Vec<Snapshot>,
    /// Fields of the gels' faces, if they were recorded; only in the binary form of a file.
    #[serde(skip)]
    pub fields: Option<FieldSeries>,
}

impl TraceStep {
    /// Mean of both gels' normal forces, N.
    pub fn mean_force_n(&self) -> f64 {
        0.5 * (self.force[0].normal_n + self.force[1].normal_n)
    }
}

impl Trace {
    /// The steps of a stage, in order.
    pub fn stage(&self, stage: StageName) -> impl DoubleEndedIterator<Item = &TraceStep> {
        self.steps.iter().filter(move |step| step.stage == stage)
    }

    /// Mean of both gels' normal forces in each of the last `count` steps of a stage, N.
    pub(super) fn last_forces(&self, stage: StageName, count: usize) -> Vec<f64> {
        let forces: Vec<f64> = self.stage(stage).map(TraceStep::mean_force_n).collect();
        forces[forces.len().saturating_sub(count)..].to_vec()
    }

    /// Mean of both gels' normal forces over the last `count` steps of a stage, N.
    pub fn mean_force(&self, stage: StageName, count: usize) -> Option<f64> {
        mean(&self.last_forces(stage, count))
    }
}

/// Mean of values; `None` without values.
pub(super) fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}
