//! State of the session for screens and the API.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use gripcast_base::files::{Label, ObjectName};
use gripcast_dataset::{GraspId, GraspRecord, Outcome, PredictionRecord};

/// Next step of the cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Step {
    /// Gripper open: take the initial frame.
    Initial,
    /// Close the gripper, then take the grasp frame.
    Grasp,
    /// Lift, then label the outcome.
    Label,
}

/// Sounds, distinct enough to work without looking at the screen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Tone {
    /// The initial frame is on disk.
    InitialSaved,
    /// The grasp is on disk.
    GraspSaved,
    /// Labelled stable, on disk.
    Stable,
    /// Labelled slip, on disk.
    Slip,
    /// A step was undone or redone.
    Undone,
    /// A command was refused.
    Refused,
    /// A camera or a save failed.
    Fault,
}

/// Severity of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum MessageLevel {
    /// A command succeeded.
    Info,
    /// Something needs attention.
    Warning,
    /// Something failed.
    Error,
}

/// Message line under the gauge.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Message {
    /// Severity.
    pub level: MessageLevel,
    /// One sentence.
    pub text: String,
}

/// A refused trigger; `!` overrides it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Refusal {
    /// `initial` or `grasp`.
    pub stage: String,
    /// Reasons, one per guard violation; those that cannot be overridden first.
    pub reasons: Vec<String>,
    /// Whether it can be overridden (a missing camera cannot).
    pub can_override: bool,
}

/// Number of grasps by label.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Counts {
    /// Stable grasps in the dataset.
    pub stable: usize,
    /// Slip grasps in the dataset.
    pub slip: usize,
    /// Unlabelled grasps in the dataset.
    pub unlabelled: usize,
    /// Stable grasps of the current object.
    pub object_stable: usize,
    /// Slip grasps of the current object.
    pub object_slip: usize,
}

/// The newest grasp.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct LastGrasp {
    /// Grasp id.
    #[schema(value_type = String)]
    pub id: GraspId,
    /// Grasped object.
    #[schema(value_type = String)]
    pub object: ObjectName,
    /// Outcome label.
    pub outcome: Outcome,
    /// Prediction before the lift.
    pub predicted: Option<PredictionRecord>,
}

impl From<GraspRecord> for LastGrasp {
    fn from(record: GraspRecord) -> Self {
        Self {
            id: record.id,
            object: record.object,
            outcome: record.outcome,
            predicted: record.prediction,
        }
    }
}

/// Complete state of the session for a screen.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SessionView {
    /// Number of the state: increases with every change of the session, and across restarts. A
    /// command carries the one that its sender saw.
    pub revision: u64,
    /// Next step.
    pub step: Step,
    /// Current object.
    #[schema(value_type = String)]
    pub object: ObjectName,
    /// Current scene.
    #[schema(value_type = String)]
    pub scene: Label,
    /// Current operator.
    #[schema(value_type = String)]
    pub operator: Label,
    /// Time of the pending initial frame, RFC 3339 UTC.
    pub initial_at: Option<String>,
    /// Age of the pending initial frame, s.
    pub initial_age_s: Option<f64>,
    /// Number of grasps by label.
    pub counts: Counts,
    /// The newest grasp.
    pub last: Option<LastGrasp>,
    /// Step that undo would revert.
    pub undo: Option<String>,
    /// Step that redo would repeat.
    pub redo: Option<String>,
    /// The latest message.
    pub message: Option<Message>,
    /// The refused trigger, until the next command.
    pub refusal: Option<Refusal>,
    /// Whether a save is in progress.
    pub saving: bool,
}
