//! What the session asks of the dataset, and the answers.

use serde::Serialize;

use super::pending::PendingFrame;
use super::view::LastGrasp;
use gripcast_base::files::{Label, ObjectName};
use gripcast_dataset::{GraspId, Outcome, OverriddenGuard};

/// Names that go into every grasp.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Labels {
    /// What is grasped.
    pub object: ObjectName,
    /// Where.
    pub scene: Label,
    /// Who holds the gripper.
    pub operator: Label,
}

/// A change of the dataset. At most one is under way.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum StoreRequest {
    /// Save the present frames as initial.
    SaveInitial {
        /// Guards that the operator overrode.
        overridden: Vec<OverriddenGuard>,
    },
    /// Save the present frames as the grasp that `initial` began.
    SaveGrasp {
        /// The pending initial frame.
        initial: GraspId,
        /// Names.
        labels: Labels,
        /// Guards that the operator overrode.
        overridden: Vec<OverriddenGuard>,
    },
    /// Set the outcome of a grasp.
    SetOutcome {
        /// Which.
        id: GraspId,
        /// To what.
        outcome: Outcome,
    },
    /// Move a grasp to the trash.
    TrashGrasp {
        /// Which.
        id: GraspId,
    },
    /// Take a grasp back from the trash.
    RestoreGrasp {
        /// Which.
        id: GraspId,
    },
    /// Move a pending initial frame to the trash.
    DiscardInitial {
        /// Which.
        id: GraspId,
    },
    /// Take it back from the trash.
    RestoreInitial {
        /// Which.
        id: GraspId,
    },
    /// Move a grasp to the trash; its initial frame becomes pending again under a new key.
    UndoGrasp {
        /// Which.
        id: GraspId,
    },
    /// Take it back from the trash; `reopened` is the pending frame that goes away.
    RedoGrasp {
        /// Which.
        id: GraspId,
        /// The pending frame that the undo made.
        reopened: Option<GraspId>,
    },
}

/// Answer to a [`StoreRequest`].
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum StoreReply {
    /// An initial frame is durable (saved, restored, or reopened by an undone grasp).
    Initial(PendingFrame),
    /// A grasp is durable (saved, or taken back from the trash).
    Grasp(LastGrasp),
    /// An outcome is durable.
    Labelled {
        /// Its key.
        id: GraspId,
        /// The grasp's object.
        object: ObjectName,
        /// Its outcome before.
        before: Outcome,
    },
    /// A grasp is in the trash.
    Trashed(LastGrasp),
    /// Done; nothing to tell.
    Done,
    /// Nothing changed on disk.
    Failed {
        /// Why, and how to fix it.
        message: String,
    },
}
