//! What screens and the API show of the session.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use gripcast_base::files::{Label, ObjectName};
use gripcast_dataset::{GraspId, GraspRecord, Outcome, PredictionRecord};

/// Step of the cycle that comes next.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Step {
    /// Gripper open: take the initial frame.
    Initial,
    /// Close the gripper, then take the grasp frame.
    Grasp,
    /// Lift, then say whether it held.
    Label,
}

/// Sounds; distinct enough to work with eyes on the object.
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
    /// A step was taken back or done again.
    Undone,
    /// A guard refused.
    Refused,
    /// A camera failed or a save failed.
    Fault,
}

/// Weight of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum MessageLevel {
    /// Something happened as asked.
    Info,
    /// Something deserves a look.
    Warning,
    /// Something failed.
    Error,
}

/// The line under the gauge.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Message {
    /// Weight.
    pub level: MessageLevel,
    /// One sentence.
    pub text: String,
}

/// A refused trigger; `!` overrides it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Refusal {
    /// `initial` or `grasp`.
    pub stage: String,
    /// Reasons, one a guard.
    pub reasons: Vec<String>,
    /// Whether an override can help (a missing camera cannot be overridden).
    pub can_override: bool,
}

/// Labels so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Counts {
    /// Labelled stable in the dataset.
    pub stable: usize,
    /// Labelled slip in the dataset.
    pub slip: usize,
    /// Not labelled in the dataset.
    pub unlabelled: usize,
    /// Stable with the present object.
    pub object_stable: usize,
    /// Slip with the present object.
    pub object_slip: usize,
}

/// The newest grasp.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct LastGrasp {
    /// Its key.
    #[schema(value_type = String)]
    pub id: GraspId,
    /// Object.
    #[schema(value_type = String)]
    pub object: ObjectName,
    /// Label.
    pub outcome: Outcome,
    /// What was predicted before the lift.
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

/// State of the session, complete for a screen.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SessionView {
    /// Step that comes next.
    pub step: Step,
    /// Present object.
    #[schema(value_type = String)]
    pub object: ObjectName,
    /// Present scene.
    #[schema(value_type = String)]
    pub scene: Label,
    /// Present operator.
    #[schema(value_type = String)]
    pub operator: Label,
    /// When the pending initial frame was taken, RFC 3339 UTC.
    pub initial_at: Option<String>,
    /// Age of the pending initial frame, s.
    pub initial_age_s: Option<f64>,
    /// Labels so far.
    pub counts: Counts,
    /// The newest grasp.
    pub last: Option<LastGrasp>,
    /// What undo would take back.
    pub undo: Option<String>,
    /// What redo would do again.
    pub redo: Option<String>,
    /// The latest message.
    pub message: Option<Message>,
    /// The refused trigger, until the next command.
    pub refusal: Option<Refusal>,
    /// Whether a save is under way.
    pub saving: bool,
}
