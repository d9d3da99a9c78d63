//! Requests of the session to the dataset, and replies.

use serde::Serialize;

use super::pending::PendingFrame;
use super::view::LastGrasp;
use gripcast_base::files::{Label, ObjectName};
use gripcast_dataset::{GraspId, NameChange, Outcome, OverriddenGuard};

/// Object, scene and operator of the next grasps.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Labels {
    /// Object to grasp.
    pub object: ObjectName,
    /// Scene.
    pub scene: Label,
    /// Operator of the gripper.
    pub operator: Label,
}

/// A change of the dataset. At most one is in progress.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum StoreRequest {
    /// Save the current frames as initial frame.
    SaveInitial {
        /// Overridden guards.
        overridden: Vec<OverriddenGuard>,
    },
    /// Save the current frames as the grasp of `initial`.
    SaveGrasp {
        /// The pending initial frame.
        initial: GraspId,
        /// Object, scene and operator.
        labels: Labels,
        /// Overridden guards.
        overridden: Vec<OverriddenGuard>,
    },
    /// Set the outcome of a grasp.
    SetOutcome {
        /// Id.
        id: GraspId,
        /// New outcome.
        outcome: Outcome,
    },
    /// Change object, scene or operator of a grasp.
    SetNames {
        /// Id.
        id: GraspId,
        /// New names.
        names: NameChange,
    },
    /// Move a grasp to the trash.
    TrashGrasp {
        /// Id.
        id: GraspId,
    },
    /// Restore a grasp from the trash.
    RestoreGrasp {
        /// Id.
        id: GraspId,
    },
    /// Move a pending initial frame to the trash.
    DiscardInitial {
        /// Id.
        id: GraspId,
    },
    /// Restore an initial frame from the trash.
    RestoreInitial {
        /// Id.
        id: GraspId,
    },
    /// Move a grasp to the trash; its initial frame becomes pending again under a new id.
    UndoGrasp {
        /// Id.
        id: GraspId,
    },
    /// Restore an undone grasp; `reopened` is discarded.
    RedoGrasp {
        /// Id.
        id: GraspId,
        /// The pending frame reopened by the undo.
        reopened: Option<GraspId>,
    },
}

/// Reply to a [`StoreRequest`].
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum StoreReply {
    /// An initial frame is durable (saved, restored, or reopened by an undone grasp).
    Initial(PendingFrame),
    /// A grasp is durable (saved or restored).
    Grasp(LastGrasp),
    /// An outcome is durable.
    Labelled {
        /// Id of the grasp.
        id: GraspId,
        /// Object of the grasp.
        object: ObjectName,
        /// Previous outcome.
        before: Outcome,
    },
    /// The names of a grasp are durable.
    Renamed {
        /// The grasp with its new names.
        grasp: LastGrasp,
        /// Previous names of the fields that differ.
        before: NameChange,
    },
    /// A grasp was moved to the trash.
    Trashed(LastGrasp),
    /// The request succeeded.
    Done,
    /// The request failed; nothing changed on disk.
    Failed {
        /// Error with remedy.
        message: String,
    },
}
