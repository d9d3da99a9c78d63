//! What happened in a grasp, step by step.

use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};

use crate::solver::StepReport;
use gripcast_geometry::Pose;

/// Stage of a grasp.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StageName {
    /// The fingers close.
    Closure,
    /// The force is adjusted.
    Adjustment,
    /// The gripper is lifted.
    Lift,
}

/// What a gel feels, on its passive (not driven) nodes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct GelForce {
    /// Component of contact and friction against the closing direction, N: f_c of the paper.
    pub normal_n: f64,
    /// Components of the force on the gel along the gripper's y and z axes, N.
    pub shear_n: [f64; 2],
    /// Moment of the force on the gel about the closing direction through the pad's centre, N m.
    pub torque_n_m: f64,
}

/// One time step.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TraceStep {
    /// Stage.
    pub stage: StageName,
    /// Time since the start, s.
    pub t_s: f64,
    /// Left and right gel.
    pub force: [GelForce; 2],
    /// The object in the world.
    pub t_world_object: Pose,
    /// Distance between the undeformed faces, m.
    pub opening_m: f64,
    /// How far the gripper was lifted, m.
    pub lifted_m: f64,
    /// Smallest distance between each gel and the object; none where further than `d_hat`.
    pub min_gap_m: [Option<f64>; 2],
    /// Work of the solver; none for steps of free flight.
    pub solver: Option<StepReport>,
}

/// State that the renderers need.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Snapshot {
    /// End of which stage.
    pub stage: StageName,
    /// Time since the start, s.
    pub t_s: f64,
    /// The object in the world.
    pub t_world_object: Pose,
    /// The gripper in the world.
    pub t_world_gripper: Pose,
    /// Distance between the undeformed faces, m.
    pub opening_m: f64,
    /// Node positions of both gels in the world, m.
    pub gels: [Vec<[f64; 3]>; 2],
}

/// A whole grasp.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Trace {
    /// All steps.
    pub steps: Vec<TraceStep>,
    /// States at the ends of the stages.
    pub snapshots: Vec<Snapshot>,
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

    /// Mean of both gels' normal forces over the last `count` steps of a stage, N.
    pub fn mean_force(&self, stage: StageName, count: usize) -> Option<f64> {
        let forces: Vec<f64> = self.stage(stage).map(TraceStep::mean_force_n).collect();
        let last = &forces[forces.len().saturating_sub(count)..];
        (!last.is_empty()).then(|| last.iter().sum::<f64>() / last.len() as f64)
    }
}

/// The rotation of `a` as a pose with its origin at `position`.
pub(super) fn pose_of(rotation: glam::DMat3, position: DVec3) -> Pose {
    Pose::new(DQuat::from_mat3(&rotation), position)
}
