//! What the API tells of the running engine. The names are a contract with pages and programs, so
//! they are types of their own and not those of the engine.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::daemon::{
    BlackBoxStatus, CameraState, CameraStatus, EngineStatus, PredictionStatus, Preview,
};
use gripcast_base::files::{Label, ObjectName};
use gripcast_dataset::{GraspId, Outcome};
use gripcast_imaging::Role;
use gripcast_nn::predict::Verdict;
use gripcast_session::{
    Counts, LastGrasp, Message, MessageLevel, Predicted, Refusal, SessionView, Step, Tone,
};

/// The engine at one moment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub(crate) struct State {
    /// Name of the dataset.
    dataset: String,
    /// Id of the rig.
    rig: String,
    /// Local wall clock, `HH:MM:SS`.
    clock: String,
    /// Free space on the dataset's disk, bytes.
    disk_free_bytes: Option<u64>,
    session: SessionState,
    /// Cameras: left, right, rgb, depth, external.
    cameras: Vec<CameraReading>,
    /// The newest prediction.
    prediction: Option<Prediction>,
    /// Why there is none.
    prediction_absent: Option<String>,
    contact: ContactReading,
    /// The continuous log, where it is on.
    black_box: Option<BlackBoxReading>,
}

/// How the continuous log does.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub(crate) struct BlackBoxReading {
    /// Directory of its files.
    directory: String,
    /// Written in this collection, bytes.
    bytes: u64,
    /// Frames left out because the disk could not keep up.
    dropped: u64,
    /// Older files that were removed to keep the total limit.
    removed_files: u64,
    /// Why nothing is logged any more.
    stopped: Option<String>,
}

/// Mean absolute difference of each gel to the initial frame, grey levels of 255.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub(crate) struct ContactReading {
    left: Option<f64>,
    right: Option<f64>,
}

/// The collection session.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub(crate) struct SessionState {
    step: StepName,
    /// What is grasped.
    #[schema(value_type = String)]
    object: ObjectName,
    /// Where.
    #[schema(value_type = String)]
    scene: Label,
    /// Who holds the gripper.
    #[schema(value_type = String)]
    operator: Label,
    /// When the pending initial frame was taken, RFC 3339 UTC.
    initial_at: Option<String>,
    /// Its age, s.
    initial_age_s: Option<f64>,
    counts: LabelCounts,
    /// The newest grasp of this session.
    last: Option<LastGraspState>,
    /// What undo would take back.
    undo: Option<String>,
    /// What redo would do again.
    redo: Option<String>,
    message: Option<SessionMessage>,
    /// The trigger that was refused, until the next command.
    refusal: Option<RefusalState>,
    /// Whether a save is under way.
    saving: bool,
}

/// What comes next.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum StepName {
    /// Gripper open: take the initial frame.
    Initial,
    /// Close the gripper, then take the grasp frame.
    Grasp,
    /// Lift, then say whether it held.
    Label,
}

/// Labels in the dataset, and with the present object.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub(crate) struct LabelCounts {
    stable: usize,
    slip: usize,
    unlabelled: usize,
    object_stable: usize,
    object_slip: usize,
}

/// The newest grasp.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub(crate) struct LastGraspState {
    #[schema(value_type = String)]
    id: GraspId,
    #[schema(value_type = String)]
    object: ObjectName,
    outcome: OutcomeName,
    /// What was predicted before the lift.
    predicted: Option<PredictedState>,
}

/// A prediction that was saved with a grasp.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub(crate) struct PredictedState {
    p_stable: f64,
    threshold: f64,
    /// Distance from the pictures of the training, over what counts as known.
    novelty: Option<f64>,
}

/// Outcome of a lift.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum OutcomeName {
    /// It held.
    Stable,
    /// It slipped or fell.
    Slip,
    /// Not said yet.
    Unlabelled,
}

/// A line for the operator.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub(crate) struct SessionMessage {
    level: LevelName,
    text: String,
}

/// Weight of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum LevelName {
    /// As asked.
    Info,
    /// Deserves a look.
    Warning,
    /// Failed.
    Error,
}

/// A refused trigger.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub(crate) struct RefusalState {
    /// `initial` or `grasp`.
    stage: String,
    /// One a guard.
    reasons: Vec<String>,
    can_override: bool,
}

/// How a camera does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum CameraStateName {
    /// Being opened for the first time.
    Opening,
    /// Frames arrive.
    Live,
    /// No frames, the device is there.
    Silent,
    /// The picture does not change.
    Frozen,
    /// Unplugged or refused; tried again.
    Lost,
    /// A recording has ended.
    Ended,
}

/// One camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub(crate) struct CameraReading {
    role: RoleName,
    product: String,
    serial: String,
    /// Path of USB ports.
    port: String,
    state: CameraStateName,
    /// Since when it is silent or frozen, s.
    for_s: Option<f64>,
    /// Why it is lost.
    reason: Option<String>,
    measured_fps: f64,
    nominal_fps: f64,
    /// Age of the newest frame, ms.
    frame_age_ms: Option<f64>,
    received: u64,
    /// Frames lost before they reached us.
    sequence_gaps: u64,
    damaged: u64,
    /// Frames later than twice the nominal interval.
    late: u64,
    reconnects: u64,
    /// What the external camera's newest frame shows of sheet and tags.
    markers: Option<MarkerReading>,
}

/// Whether sheet and tags can be measured.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub(crate) struct MarkerReading {
    ok: bool,
    text: String,
}

/// Which camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum RoleName {
    /// Left gel.
    Left,
    /// Right gel.
    Right,
    /// Colour picture between the fingers.
    Rgb,
    /// Depth picture of the same camera.
    Depth,
    /// Camera that sees the markers.
    External,
}

/// The newest live prediction.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub(crate) struct Prediction {
    /// Probability that the grasp is stable, steadied over the frames.
    p_stable: f64,
    verdict: VerdictName,
    /// Distance from the pictures of the training, over what counts as known.
    novelty: Option<f64>,
    threshold: f64,
    model: String,
    /// Whether the model is a heuristic and not trained.
    heuristic: bool,
    /// Age of the tactile frame that it was made from, ms.
    frame_age_ms: f64,
    /// Frame to prediction, ms.
    latency_ms: f64,
    /// Model alone, ms.
    engine_ms: f64,
}

/// What a prediction claims.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum VerdictName {
    /// It will hold.
    Stable,
    /// It will not.
    Slip,
    /// The pictures are unlike those of the training.
    Unsure,
}

/// A sound of the session.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum ToneName {
    /// The initial frame is on disk.
    InitialSaved,
    /// The grasp is on disk.
    GraspSaved,
    /// Labelled stable.
    Stable,
    /// Labelled slip.
    Slip,
    /// A step was taken back or done again.
    Undone,
    /// A guard refused.
    Refused,
    /// A camera or a save failed.
    Fault,
}

/// Two enums that name the same things: conversions both ways.
macro_rules! same {
    ($ours:ty, $theirs:ty, $($name:ident),+) => {
        impl From<$theirs> for $ours {
            fn from(theirs: $theirs) -> Self {
                match theirs {
                    $(<$theirs>::$name => Self::$name,)+
                }
            }
        }

        impl From<$ours> for $theirs {
            fn from(ours: $ours) -> Self {
                match ours {
                    $(<$ours>::$name => Self::$name,)+
                }
            }
        }
    };
}

same!(StepName, Step, Initial, Grasp, Label);
same!(OutcomeName, Outcome, Stable, Slip, Unlabelled);
same!(LevelName, MessageLevel, Info, Warning, Error);
same!(RoleName, Role, Left, Right, Rgb, Depth, External);
same!(VerdictName, Verdict, Stable, Slip, Unsure);
same!(
    ToneName,
    Tone,
    InitialSaved,
    GraspSaved,
    Stable,
    Slip,
    Undone,
    Refused,
    Fault
);

impl State {
    /// What the engine says.
    pub(crate) fn of(status: &EngineStatus) -> Self {
        let contact = |role| {
            status
                .previews
                .get(&role)
                .and_then(|preview| preview.contact)
        };
        Self {
            dataset: status.dataset.clone(),
            rig: status.rig.clone(),
            clock: status.clock.clone(),
            disk_free_bytes: status.disk_free_bytes,
            session: SessionState::of(&status.session),
            cameras: status.cameras.iter().map(CameraReading::of).collect(),
            prediction: status.prediction.as_ref().map(Prediction::of),
            prediction_absent: status.prediction_absent.clone(),
            contact: ContactReading {
                left: contact(Role::Left),
                right: contact(Role::Right),
            },
            black_box: status.black_box.as_ref().map(|log| BlackBoxReading {
                directory: log.directory.display().to_string(),
                bytes: log.bytes,
                dropped: log.dropped,
                removed_files: log.removed_files,
                stopped: log.stopped.clone(),
            }),
        }
    }

    /// The status that it came from, for a screen; pictures come another way.
    pub(crate) fn into_status(self, previews: BTreeMap<Role, Preview>) -> EngineStatus {
        EngineStatus {
            dataset: self.dataset,
            rig: self.rig,
            clock: self.clock,
            disk_free_bytes: self.disk_free_bytes,
            session: self.session.into_view(),
            cameras: self
                .cameras
                .into_iter()
                .map(CameraReading::into_status)
                .collect(),
            prediction: self.prediction.map(Prediction::into_status),
            prediction_absent: self.prediction_absent,
            previews,
            black_box: self.black_box.map(|log| BlackBoxStatus {
                directory: log.directory.into(),
                bytes: log.bytes,
                dropped: log.dropped,
                removed_files: log.removed_files,
                stopped: log.stopped,
            }),
        }
    }

    /// Contact of a gel, grey levels.
    pub(crate) fn contact(&self, role: Role) -> Option<f64> {
        match role {
            Role::Left => self.contact.left,
            Role::Right => self.contact.right,
            Role::Rgb | Role::Depth | Role::External => None,
        }
    }

    /// Whether an initial frame is subtracted from the gels' pictures.
    pub(crate) fn shows_differences(&self) -> bool {
        self.session.initial_at.is_some()
    }
}

impl SessionState {
    fn of(view: &SessionView) -> Self {
        let counts = view.counts;
        Self {
            step: view.step.into(),
            object: view.object.clone(),
            scene: view.scene.clone(),
            operator: view.operator.clone(),
            initial_at: view.initial_at.clone(),
            initial_age_s: view.initial_age_s,
            counts: LabelCounts {
                stable: counts.stable,
                slip: counts.slip,
                unlabelled: counts.unlabelled,
                object_stable: counts.object_stable,
                object_slip: counts.object_slip,
            },
            last: view.last.as_ref().map(|last| LastGraspState {
                id: last.id.clone(),
                object: last.object.clone(),
                outcome: last.outcome.into(),
                predicted: last.predicted.map(|said| PredictedState {
                    p_stable: said.p_stable,
                    threshold: said.threshold,
                    novelty: said.novelty,
                }),
            }),
            undo: view.undo.clone(),
            redo: view.redo.clone(),
            message: view.message.as_ref().map(|message| SessionMessage {
                level: message.level.into(),
                text: message.text.clone(),
            }),
            refusal: view.refusal.as_ref().map(|refusal| RefusalState {
                stage: refusal.stage.clone(),
                reasons: refusal.reasons.clone(),
                can_override: refusal.can_override,
            }),
            saving: view.saving,
        }
    }

    fn into_view(self) -> SessionView {
        let counts = self.counts;
        SessionView {
            step: self.step.into(),
            object: self.object,
            scene: self.scene,
            operator: self.operator,
            initial_at: self.initial_at,
            initial_age_s: self.initial_age_s,
            counts: Counts {
                stable: counts.stable,
                slip: counts.slip,
                unlabelled: counts.unlabelled,
                object_stable: counts.object_stable,
                object_slip: counts.object_slip,
            },
            last: self.last.map(|last| LastGrasp {
                id: last.id,
                object: last.object,
                outcome: last.outcome.into(),
                predicted: last.predicted.map(|said| Predicted {
                    p_stable: said.p_stable,
                    threshold: said.threshold,
                    novelty: said.novelty,
                }),
            }),
            undo: self.undo,
            redo: self.redo,
            message: self.message.map(|message| Message {
                level: message.level.into(),
                text: message.text,
            }),
            refusal: self.refusal.map(|refusal| Refusal {
                stage: refusal.stage,
                reasons: refusal.reasons,
                can_override: refusal.can_override,
            }),
            saving: self.saving,
        }
    }
}

impl CameraReading {
    fn of(camera: &CameraStatus) -> Self {
        let (state, for_s, reason) = match &camera.state {
            CameraState::Opening => (CameraStateName::Opening, None, None),
            CameraState::Live => (CameraStateName::Live, None, None),
            CameraState::Silent { for_s } => (CameraStateName::Silent, Some(*for_s), None),
            CameraState::Frozen { for_s } => (CameraStateName::Frozen, Some(*for_s), None),
            CameraState::Lost { reason } => (CameraStateName::Lost, None, Some(reason.clone())),
            CameraState::Ended => (CameraStateName::Ended, None, None),
        };
        Self {
            role: camera.role.into(),
            product: camera.product.clone(),
            serial: camera.serial.clone(),
            port: camera.port.clone(),
            state,
            for_s,
            reason,
            measured_fps: camera.measured_fps,
            nominal_fps: camera.nominal_fps,
            frame_age_ms: camera.frame_age_ms,
            received: camera.received,
            sequence_gaps: camera.sequence_gaps,
            damaged: camera.damaged,
            late: camera.late,
            reconnects: camera.reconnects,
            markers: camera.markers.as_ref().map(|markers| MarkerReading {
                ok: markers.is_ok(),
                text: markers.clone().unwrap_or_else(|why| why),
            }),
        }
    }

    fn into_status(self) -> CameraStatus {
        let for_s = self.for_s.unwrap_or_default();
        CameraStatus {
            role: self.role.into(),
            product: self.product,
            serial: self.serial,
            port: self.port,
            state: match self.state {
                CameraStateName::Opening => CameraState::Opening,
                CameraStateName::Live => CameraState::Live,
                CameraStateName::Silent => CameraState::Silent { for_s },
                CameraStateName::Frozen => CameraState::Frozen { for_s },
                CameraStateName::Lost => CameraState::Lost {
                    reason: self.reason.unwrap_or_default(),
                },
                CameraStateName::Ended => CameraState::Ended,
            },
            measured_fps: self.measured_fps,
            nominal_fps: self.nominal_fps,
            frame_age_ms: self.frame_age_ms,
            received: self.received,
            sequence_gaps: self.sequence_gaps,
            damaged: self.damaged,
            late: self.late,
            reconnects: self.reconnects,
            markers: self.markers.map(|markers| {
                if markers.ok {
                    Ok(markers.text)
                } else {
                    Err(markers.text)
                }
            }),
        }
    }
}

impl Prediction {
    fn of(prediction: &PredictionStatus) -> Self {
        Self {
            p_stable: prediction.p_stable,
            verdict: prediction.verdict().into(),
            novelty: prediction.novelty,
            threshold: prediction.threshold,
            model: prediction.model.clone(),
            heuristic: prediction.heuristic,
            frame_age_ms: prediction.frame_age_ms,
            latency_ms: prediction.latency_ms,
            engine_ms: prediction.engine_ms,
        }
    }

    fn into_status(self) -> PredictionStatus {
        PredictionStatus {
            p_stable: self.p_stable,
            novelty: self.novelty,
            threshold: self.threshold,
            model: self.model,
            frame_age_ms: self.frame_age_ms,
            latency_ms: self.latency_ms,
            engine_ms: self.engine_ms,
            heuristic: self.heuristic,
        }
    }
}
