//! The writing thread: carries out store requests one after the other and answers each.

use std::collections::BTreeMap;
use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use image::RgbImage;
use jiff::Timestamp;
use tokio::sync::mpsc::UnboundedSender;

use super::decode::model_image;
use super::infer::InferRequest;
use super::tasks::{Beat, TaskState, Tasks};
use super::thread::spawn;
use gripcast_base::catch_panic::catch_panic;
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::ContentKey;
use gripcast_dataset::{
    BoardKeys, DatasetWriter, GraspId, GraspMeta, PendingInitial, PredictionRecord, StageCapture,
};
use gripcast_imaging::{CropProfile, Decoder, Frame, FrameDamage, Role};
use gripcast_session::{Labels, PendingFrame, StoreReply, StoreRequest};

/// Name of the thread.
const TASK: &str = "store";

/// Quiet time after which the index is brought up to date.
const INDEX_PAUSE: Duration = Duration::from_millis(150);

/// How long a save waits for the model; the grasp is saved without a prediction after that.
/// Only a model that hangs takes this long; a loaded machine has needed more than half a second.
const JUDGE_PATIENCE: Duration = Duration::from_secs(5);

/// What the writing thread is asked.
#[derive(Debug)]
pub(super) enum StoreMessage {
    /// Carry out a request and answer it.
    Carry {
        /// The request.
        request: StoreRequest,
        /// Frames, for requests that save some.
        capture: Option<Box<StageCapture>>,
        /// Board files that the external camera's frames were measured with: sheet, tags.
        boards: Option<[String; 2]>,
        /// Latency of the live prediction at the trigger, ms.
        latency_ms: f64,
    },
    /// A pending frame is subtracted from now on.
    UseInitial {
        /// Its key; `None` = there is none.
        id: Option<GraspId>,
        /// Number of the change.
        change: u64,
    },
    /// A line for the log.
    Log(serde_json::Value),
    /// End.
    Stop,
}

/// What every grasp of a session fractions.
#[derive(Debug)]
pub(super) struct StoreContext {
    /// Rig id.
    pub(super) rig: String,
    /// Calibration by role.
    pub(super) calibration: BTreeMap<Role, ContentKey>,
    /// Whether there is a model.
    pub(super) has_model: bool,
    /// Crop of each tactile camera.
    pub(super) crops: BTreeMap<Role, CropProfile>,
}

/// The writing thread.
#[derive(Debug)]
pub(super) struct Store {
    messages: Sender<StoreMessage>,
    thread: JoinHandle<Result<()>>,
}

impl Store {
    /// Starts the thread. `pending` is the initial frame that the session resumes.
    ///
    /// # Errors
    /// When a decoder or the thread cannot be had.
    pub(super) fn start(
        writer: DatasetWriter,
        pending: Option<PendingInitial>,
        context: StoreContext,
        infer: Sender<InferRequest>,
        replies: UnboundedSender<StoreReply>,
        tasks: &Tasks,
    ) -> Result<Self> {
        let (messages, inbox) = channel();
        let beat = tasks.enter(TASK);
        let tasks = tasks.clone();
        let mut worker = Worker {
            beat,
            writer,
            context,
            decoder: Decoder::new()?,
            pending: pending.map(|p| (p.id.clone(), p)).into_iter().collect(),
            infer,
            replies,
        };
        let thread = spawn(TASK.into(), move || {
            let result = worker.run(&inbox);
            tasks.set(TASK, TaskState::Ended, None);
            result
        })?;
        Ok(Self { messages, thread })
    }

    /// Asks the thread; an error means that it has ended.
    pub(super) fn send(&self, message: StoreMessage) -> Result<()> {
        self.messages.send(message).map_err(|_| {
            Error::internal("the writing thread has ended")
                .remedy("what was acknowledged is on disk; restart gripcast")
        })
    }

    /// Finishes what is queued, writes the index and ends.
    ///
    /// # Errors
    /// When the index could not be written; the grasps are safe nevertheless.
    pub(super) fn stop(self) -> Result<()> {
        // Fails only when the thread has ended, which join tells.
        let _ = self.messages.send(StoreMessage::Stop);
        self.thread
            .join()
            .unwrap_or_else(|_| Err(Error::internal("the writing thread panicked")))
    }
}

struct Worker {
    beat: Beat,
    writer: DatasetWriter,
    context: StoreContext,
    decoder: Decoder,
    pending: BTreeMap<GraspId, PendingInitial>,
    infer: Sender<InferRequest>,
    replies: UnboundedSender<StoreReply>,
}

impl Worker {
    fn run(&mut self, inbox: &Receiver<StoreMessage>) -> Result<()> {
        loop {
            match inbox.recv_timeout(INDEX_PAUSE) {
                Ok(StoreMessage::Carry {
                    request,
                    capture,
                    boards,
                    latency_ms,
                }) => {
                    self.beat.busy();
                    let work = AssertUnwindSafe(|| {
                        self.carry_out(request, capture.as_deref(), boards, latency_ms)
                    });
                    // A panic must not leave the session waiting for its answer for ever; the
                    // order of the writer's steps keeps what is on disk whole.
                    let reply = catch_panic(work)
                        .unwrap_or_else(|panic| Err(panicked(&panic)))
                        .unwrap_or_else(|error| StoreReply::Failed {
                            message: error.to_string().replace("\n  → ", " → "),
                        });
                    self.beat.idle();
                    // The engine has gone: everything asked for before is on disk.
                    if self.replies.send(reply).is_err() {
                        return self.writer.flush_index();
                    }
                }
                Ok(StoreMessage::UseInitial { id, change }) => {
                    self.use_initial(id.as_ref(), change)
                }
                // A log line that cannot be written must not stop the collection.
                Ok(StoreMessage::Log(event)) => drop(self.writer.log_event(&event)),
                Err(RecvTimeoutError::Timeout) => drop(self.writer.flush_index()),
                Ok(StoreMessage::Stop) | Err(RecvTimeoutError::Disconnected) => {
                    return self.writer.flush_index();
                }
            }
        }
    }

    fn carry_out(
        &mut self,
        request: StoreRequest,
        capture: Option<&StageCapture>,
        boards: Option<[String; 2]>,
        latency_ms: f64,
    ) -> Result<StoreReply> {
        match request {
            StoreRequest::SaveInitial { overridden } => {
                let pending = self.writer.save_initial(needed(capture)?, overridden)?;
                Ok(self.now_pending(pending))
            }
            StoreRequest::SaveGrasp {
                initial,
                labels,
                overridden,
            } => {
                let capture = needed(capture)?;
                let pending = self.pending(&initial)?;
                let meta = self.grasp_meta(capture, labels, boards, latency_ms)?;
                let meta = GraspMeta {
                    overridden_guards: overridden,
                    ..meta
                };
                let record = self.writer.save_grasp(&pending, capture, meta)?;
                self.pending.remove(&initial);
                Ok(StoreReply::Grasp(record.into()))
            }
            StoreRequest::SetOutcome { id, outcome } => {
                let before = self.writer.outcome(&id).map(|(_, outcome)| outcome);
                let record = self.writer.set_outcome(&id, outcome, Timestamp::now())?;
                Ok(StoreReply::Labelled {
                    id,
                    object: record.object,
                    before: before.unwrap_or_default(),
                })
            }
            StoreRequest::TrashGrasp { id } => {
                Ok(StoreReply::Trashed(self.writer.trash_grasp(&id)?.into()))
            }
            StoreRequest::RestoreGrasp { id } => {
                self.check_not_reopened(&id)?;
                Ok(StoreReply::Grasp(self.writer.redo_grasp(&id, None)?.into()))
            }
            StoreRequest::DiscardInitial { id } => {
                let pending = self.pending(&id)?;
                self.writer.discard_initial(&pending)?;
                self.pending.remove(&id);
                Ok(StoreReply::Done)
            }
            StoreRequest::RestoreInitial { id } => {
                let pending = self.writer.restore_initial(&id)?;
                Ok(self.now_pending(pending))
            }
            StoreRequest::UndoGrasp { id } => {
                let pending = self.writer.undo_grasp(&id)?;
                Ok(self.now_pending(pending))
            }
            StoreRequest::RedoGrasp { id, reopened } => {
                let reopened = reopened.map(|id| self.pending(&id)).transpose()?;
                let record = self.writer.redo_grasp(&id, reopened.as_ref())?;
                if let Some(reopened) = reopened {
                    self.pending.remove(&reopened.id);
                }
                Ok(StoreReply::Grasp(record.into()))
            }
        }
    }

    /// What a grasp record holds besides its frames and the guards that were overridden.
    fn grasp_meta(
        &mut self,
        capture: &StageCapture,
        labels: Labels,
        boards: Option<[String; 2]>,
        latency_ms: f64,
    ) -> Result<GraspMeta> {
        Ok(GraspMeta {
            object: labels.object,
            scene: labels.scene,
            operator: labels.operator,
            rig: self.context.rig.clone(),
            boards: boards.map(|texts| self.board_keys(&texts)).transpose()?,
            prediction: self.predict(capture, latency_ms),
            calibration: self.context.calibration.clone(),
            ..GraspMeta::default()
        })
    }

    /// A grasp whose initial frame is pending again comes back by redo alone.
    fn check_not_reopened(&self, id: &GraspId) -> Result<()> {
        let is_from = |pending: &PendingInitial| pending.reopened_from.as_ref() == Some(id);
        if !self.pending.values().any(is_from) {
            return Ok(());
        }
        let what = format!("{id} was undone and its initial frame waits for a grasp again");
        Err(Error::new(ErrorKind::Busy, what).remedy("redo brings it back"))
    }

    fn board_keys(&mut self, [sheet, tags]: &[String; 2]) -> Result<BoardKeys> {
        Ok(BoardKeys {
            sheet: self.writer.put_calibration(sheet)?,
            tags: self.writer.put_calibration(tags)?,
        })
    }

    fn pending(&self, id: &GraspId) -> Result<PendingInitial> {
        self.pending
            .get(id)
            .cloned()
            .ok_or_else(|| Error::internal(format!("no initial frame {id} is pending")))
    }

    fn now_pending(&mut self, pending: PendingInitial) -> StoreReply {
        let frame = pending_frame(&pending);
        self.pending.insert(pending.id.clone(), pending);
        StoreReply::Initial(frame)
    }

    /// Hands the images of a pending initial frame to inference. Where that fails there is no
    /// prediction, and the reason stands in its place.
    fn use_initial(&mut self, id: Option<&GraspId>, change: u64) {
        let images = match id {
            Some(id) => self.initial_images(id),
            None => Err(Error::not_found("no initial frame")),
        };
        let request = match images {
            Ok([left, right]) => InferRequest::SetInitial {
                change,
                left: Arc::new(left),
                right: Arc::new(right),
            },
            Err(error) => InferRequest::ClearInitial(error.what().to_owned()),
        };
        // Inference ends after this thread; its absence means the process is ending.
        let _ = self.infer.send(request);
    }

    /// The images of both gels of a pending initial frame.
    fn initial_images(&mut self, id: &GraspId) -> Result<[RgbImage; 2]> {
        let frames = self.writer.pending_frames(&self.pending(id)?)?;
        let mut image = |role| -> Result<RgbImage> {
            let frame = frames.get(&role).ok_or_else(|| {
                let what = format!("the initial frame has no image of {role}");
                Error::not_found(what)
            })?;
            Ok(self.image(frame, role)?)
        };
        Ok([image(Role::Left)?, image(Role::Right)?])
    }

    fn image(&mut self, frame: &Frame, role: Role) -> std::result::Result<RgbImage, FrameDamage> {
        let crop = self.context.crops.get(&role).copied();
        model_image(&mut self.decoder, frame, crop.as_ref())
    }

    /// The prediction on exactly the frames that are being saved, so that it can be repeated from
    /// the files.
    fn predict(&mut self, capture: &StageCapture, latency_ms: f64) -> Option<PredictionRecord> {
        if !self.context.has_model {
            return None;
        }
        let images = [Role::Left, Role::Right, Role::Rgb]
            .into_iter()
            .filter_map(|role| {
                let frame = &capture.cameras.get(&role)?.frame;
                Some((role, self.image(frame, role).ok()?))
            })
            .collect();
        let (reply, answer) = channel();
        self.infer
            .send(InferRequest::Judge { images, reply })
            .ok()?;
        let said = answer.recv_timeout(JUDGE_PATIENCE).ok()??;
        Some(PredictionRecord { latency_ms, ..said })
    }
}

fn panicked(panic: &str) -> Error {
    Error::internal(format!("the writing thread panicked: {panic}"))
        .remedy("what was acknowledged is on disk; restart gripcast if it happens again")
}

fn needed(capture: Option<&StageCapture>) -> Result<&StageCapture> {
    capture.ok_or_else(|| Error::internal("a save was asked for without frames"))
}

/// A pending initial frame as the session sees it.
pub(super) fn pending_frame(pending: &PendingInitial) -> PendingFrame {
    let controls = pending
        .stage
        .cameras
        .iter()
        .map(|(role, camera)| (*role, camera.controls.clone()))
        .collect();
    PendingFrame {
        id: pending.id.clone(),
        captured_at: pending.stage.captured_at.clone(),
        trigger_time_ns: pending.stage.trigger_time_ns,
        external: pending
            .stage
            .cameras
            .get(&Role::External)
            .map(|camera| (camera.driver_time_ns, camera.file.clone())),
        controls,
    }
}
