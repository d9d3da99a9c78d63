//! The store thread: executes and answers store requests in order.

use std::collections::BTreeMap;
use std::panic::AssertUnwindSafe;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use image::RgbImage;
use jiff::Timestamp;
use tokio::sync::mpsc::UnboundedSender;

use super::decode::model_image;
use super::infer::{InferRequest, SavedAnalysis};
use super::report::LiftReport;
use super::tasks::{Heartbeat, TaskState, Tasks};
use super::thread::{lock, spawn};
use gripcast_base::catch_panic;
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::ContentKey;
use gripcast_dataset::{
    BoardKeys, Dataset, DatasetWriter, FieldArray, GraspId, GraspMeta, LiftVerdict, PendingInitial,
    PredictionRecord, Stage, StageCapture,
};
use gripcast_imaging::{CropProfile, Decoder, Depth, Frame, FrameDamage, Role};
use gripcast_session::{Labels, PendingFrame, StoreReply, StoreRequest};
use gripcast_shear::ShearFrame;

/// Name of the thread.
const TASK: &str = "store";

/// Idle time after which the index is written, and its increase for each grasp: the whole file is
/// written, and a command that comes meanwhile waits.
const INDEX_DELAY: Duration = Duration::from_millis(150);
const INDEX_DELAY_PER_GRASP: Duration = Duration::from_micros(500);

/// Wait for the model and the tracker during a save; afterwards the grasp is saved without their
/// results. Only a
/// hanging model takes this long; loaded machines have needed more than half a second.
const ANALYSIS_TIMEOUT: Duration = Duration::from_secs(5);

/// Messages to the store thread.
#[derive(Debug)]
pub(super) enum StoreMessage {
    /// Execute a request and send its reply.
    Execute(StoreJob),
    /// Use a pending initial frame for inference.
    UseInitial {
        /// Id of the frame; `None` for no initial frame.
        id: Option<GraspId>,
        /// Revision of the initial frame.
        revision: u64,
    },
    /// Add lift frames to a grasp.
    AppendLift {
        /// The grasp.
        id: GraspId,
        /// Frames of the gels, by time.
        frames: BTreeMap<Role, Vec<Frame>>,
        /// Time that was to be kept, s.
        requested_s: f64,
    },
    /// Write a line to the log.
    Log(serde_json::Value),
    /// End the thread.
    Stop,
}

/// A store request with the data to save.
#[derive(Debug)]
pub(super) struct StoreJob {
    /// The request.
    pub(super) request: StoreRequest,
    /// Frames of a save request.
    pub(super) capture: Option<Box<StageCapture>>,
    /// Texts of the board files used for the pre-grasp frames: sheet, tags.
    pub(super) boards: Option<[String; 2]>,
    /// Latency of the live prediction at the trigger, ms.
    pub(super) latency_ms: f64,
    /// Verdict in the lift of the grasp that is labelled.
    pub(super) verdict: Option<LiftVerdict>,
}

/// Data common to all grasps of a session.
#[derive(Debug)]
pub(super) struct StoreContext {
    /// Rig id.
    pub(super) rig: String,
    /// Content key of the calibration, by role.
    pub(super) calibration: BTreeMap<Role, ContentKey>,
    /// Crop profile of each tactile camera.
    pub(super) crops: BTreeMap<Role, CropProfile>,
}

/// Handle of the store thread.
#[derive(Debug)]
pub(super) struct Store {
    messages: Sender<StoreMessage>,
    thread: JoinHandle<Result<()>>,
    lifts: Arc<Mutex<LiftReport>>,
    /// Mean size of a grasp, bytes; 0 if unknown.
    grasp_bytes: Arc<AtomicU64>,
}

impl Store {
    /// Starts the thread. `pending` is the initial frame of a resumed session.
    ///
    /// # Errors
    /// Errors of creating the decoder or starting the thread.
    pub(super) fn start(
        writer: DatasetWriter,
        pending: Option<PendingInitial>,
        context: StoreContext,
        infer: Sender<InferRequest>,
        replies: UnboundedSender<StoreReply>,
        tasks: &Tasks,
    ) -> Result<Self> {
        let (messages, inbox) = channel();
        let heartbeat = tasks.register(TASK);
        let tasks = tasks.clone();
        let grasp_bytes = Arc::new(AtomicU64::new(writer.mean_grasp_bytes().unwrap_or(0)));
        let lifts = Arc::default();
        let mut worker = Worker {
            heartbeat,
            writer,
            context,
            decoder: Decoder::new()?,
            pending: pending.map(|p| (p.id.clone(), p)).into_iter().collect(),
            infer,
            replies,
            grasp_bytes: Arc::clone(&grasp_bytes),
            lifts: Arc::clone(&lifts),
        };
        let thread = spawn(TASK.into(), move || {
            let result = worker.run(&inbox);
            tasks.set(TASK, TaskState::Ended, None);
            result
        })?;
        Ok(Self {
            messages,
            thread,
            lifts,
            grasp_bytes,
        })
    }

    /// Returns the mean size of the newest grasps, bytes; `None` without grasps.
    pub(super) fn mean_grasp_bytes(&self) -> Option<u64> {
        Some(self.grasp_bytes.load(Ordering::Relaxed)).filter(|bytes| *bytes > 0)
    }

    /// Sends a message; fails if the thread has ended.
    pub(super) fn send(&self, message: StoreMessage) -> Result<()> {
        self.messages.send(message).map_err(|_| {
            Error::internal("the store thread has ended")
                .remedy("what was acknowledged is on disk; restart gripcast")
        })
    }

    /// Finishes queued messages, writes the index and ends the thread. Fails if the index cannot be
    /// written; saved grasps are not affected.
    pub(super) fn stop(self) -> (Result<()>, LiftReport) {
        // Fails only if the thread has ended; `join` reports it.
        let _ = self.messages.send(StoreMessage::Stop);
        let joined = self.thread.join();
        let result = joined.unwrap_or_else(|_| Err(Error::internal("the store thread panicked")));
        (result, *lock(&self.lifts))
    }
}

struct Worker {
    heartbeat: Heartbeat,
    writer: DatasetWriter,
    context: StoreContext,
    decoder: Decoder,
    pending: BTreeMap<GraspId, PendingInitial>,
    infer: Sender<InferRequest>,
    replies: UnboundedSender<StoreReply>,
    grasp_bytes: Arc<AtomicU64>,
    lifts: Arc<Mutex<LiftReport>>,
}

impl Worker {
    fn run(&mut self, inbox: &Receiver<StoreMessage>) -> Result<()> {
        if let Ok(Some(images)) = self.reference_images() {
            let [left, right] = images.map(Arc::new);
            // Fails only while the process is ending.
            let _ = self.infer.send(InferRequest::SetReference { left, right });
        }
        loop {
            let grasps = u32::try_from(self.writer.grasps()).unwrap_or(u32::MAX);
            match inbox.recv_timeout(INDEX_DELAY + INDEX_DELAY_PER_GRASP * grasps) {
                Ok(StoreMessage::Execute(job)) => {
                    self.heartbeat.busy();
                    let work = AssertUnwindSafe(|| self.execute(job));
                    // After a panic the session still gets a reply; the order of the writer's
                    // steps keeps the dataset consistent.
                    let reply = catch_panic::catch_panic(work)
                        .unwrap_or_else(|panic| Err(panicked(&panic)))
                        .unwrap_or_else(|error| StoreReply::Failed {
                            message: error.to_string().replace("\n  → ", " → "),
                        });
                    let mean = self.writer.mean_grasp_bytes().unwrap_or(0);
                    self.grasp_bytes.store(mean, Ordering::Relaxed);
                    self.heartbeat.idle();
                    // The engine has ended; all earlier requests are on disk.
                    if self.replies.send(reply).is_err() {
                        return self.writer.flush_index();
                    }
                }
                Ok(StoreMessage::UseInitial { id, revision }) => {
                    self.use_initial(id.as_ref(), revision)
                }
                Ok(StoreMessage::AppendLift {
                    id,
                    frames,
                    requested_s,
                }) => {
                    self.heartbeat.busy();
                    self.append_lift(&id, &frames, requested_s);
                    self.heartbeat.idle();
                }
                // A failed log line must not stop the collection.
                Ok(StoreMessage::Log(event)) => drop(self.writer.log_event(&event)),
                Err(RecvTimeoutError::Timeout) => drop(self.writer.flush_index()),
                Ok(StoreMessage::Stop) | Err(RecvTimeoutError::Disconnected) => {
                    return self.writer.flush_index();
                }
            }
        }
    }

    /// Adds lift frames to a grasp; a failure is logged and leaves the grasp as it is.
    fn append_lift(&mut self, id: &GraspId, frames: &BTreeMap<Role, Vec<Frame>>, requested_s: f64) {
        let work = AssertUnwindSafe(|| self.writer.append_lift(id, frames, requested_s));
        let result = catch_panic::catch_panic(work).unwrap_or_else(|panic| Err(panicked(&panic)));
        let mut lifts = lock(&self.lifts);
        let (count, error) = match result {
            Ok(_) => (&mut lifts.stored, None),
            Err(error) => (&mut lifts.failed, Some(error.to_string())),
        };
        *count += 1;
        drop(lifts);
        let frames: BTreeMap<Role, usize> = frames
            .iter()
            .map(|(role, frames)| (*role, frames.len()))
            .collect();
        let _ = self.writer.log_event(&serde_json::json!({
            "at": Timestamp::now().to_string(),
            "event": "lift",
            "what": {"id": id, "frames": frames, "error": error},
        }));
    }

    fn execute(&mut self, job: StoreJob) -> Result<StoreReply> {
        let mut capture = job.capture;
        let capture = capture.as_deref_mut();
        match job.request {
            StoreRequest::SaveInitial { overridden } => {
                let pending = self
                    .writer
                    .save_initial(&*required_capture(capture)?, overridden)?;
                Ok(self.add_pending(pending))
            }
            StoreRequest::SaveGrasp {
                initial,
                labels,
                overridden,
            } => {
                let capture = required_capture(capture)?;
                let pending = self.pending(&initial)?;
                let analysis = self.analyse(capture);
                add_shear(capture, &analysis.shear);
                capture.force.clone_from(&analysis.force);
                let prediction = analysis.prediction.map(|record| PredictionRecord {
                    latency_ms: job.latency_ms,
                    ..record
                });
                let meta = self.grasp_meta(labels, job.boards, prediction)?;
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
                let now = Timestamp::now();
                let record = self.writer.set_outcome(&id, outcome, now, job.verdict)?;
                Ok(StoreReply::Labelled {
                    id,
                    object: record.object,
                    before: before.unwrap_or_default(),
                })
            }
            StoreRequest::SetNames { id, names } => {
                let (record, before) = self.writer.set_names(&id, &names)?;
                Ok(StoreReply::Renamed {
                    grasp: record.into(),
                    before,
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
                Ok(self.add_pending(pending))
            }
            StoreRequest::UndoGrasp { id } => {
                let pending = self.writer.undo_grasp(&id)?;
                Ok(self.add_pending(pending))
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

    /// Returns the metadata of a grasp, except the overridden guards.
    fn grasp_meta(
        &mut self,
        labels: Labels,
        boards: Option<[String; 2]>,
        prediction: Option<PredictionRecord>,
    ) -> Result<GraspMeta> {
        Ok(GraspMeta {
            object: labels.object,
            scene: labels.scene,
            operator: labels.operator,
            rig: self.context.rig.clone(),
            boards: boards.map(|texts| self.board_keys(&texts)).transpose()?,
            prediction,
            calibration: self.context.calibration.clone(),
            ..GraspMeta::default()
        })
    }

    /// Fails for a grasp whose initial frame is pending again: only redo restores it.
    fn check_not_reopened(&self, id: &GraspId) -> Result<()> {
        let is_from = |pending: &PendingInitial| pending.reopened_from.as_ref() == Some(id);
        if !self.pending.values().any(is_from) {
            return Ok(());
        }
        let what = format!("{id} was undone and its initial frame is pending again");
        Err(Error::new(ErrorKind::Busy, what).remedy("restore it with redo"))
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

    fn add_pending(&mut self, pending: PendingInitial) -> StoreReply {
        let frame = pending_frame(&pending);
        self.pending.insert(pending.id.clone(), pending);
        StoreReply::Initial(frame)
    }

    /// Sends the images of a pending initial frame, or the reason for their absence, to inference.
    fn use_initial(&mut self, id: Option<&GraspId>, revision: u64) {
        let images = match id {
            Some(id) => self.initial_images(id),
            None => Err(Error::not_found("no initial frame")),
        };
        let request = match images {
            Ok([left, right]) => InferRequest::SetInitial {
                revision,
                left: Arc::new(left),
                right: Arc::new(right),
            },
            Err(error) => InferRequest::ClearInitial(error.what().to_owned()),
        };
        // Fails only while the process is ending.
        let _ = self.infer.send(request);
    }

    /// Decodes the images of both gels of a pending initial frame.
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

    /// Decodes the images of both gels with the gripper open of the newest grasp, if it is of this
    /// rig.
    fn reference_images(&mut self) -> Result<Option<[RgbImage; 2]>> {
        let dataset = Dataset::open(self.writer.path())?;
        let Some(id) = dataset.ids()?.pop() else {
            return Ok(None);
        };
        let record = dataset.grasp(&id)?;
        if record.rig != self.context.rig {
            return Ok(None);
        }
        let mut image = |role| -> Result<RgbImage> {
            let frame = dataset.load_frame(&record, Stage::Initial, role)?;
            Ok(self.image(&frame, role)?)
        };
        Ok(Some([image(Role::Left)?, image(Role::Right)?]))
    }

    fn image(&mut self, frame: &Frame, role: Role) -> std::result::Result<RgbImage, FrameDamage> {
        let crop = self.context.crops.get(&role).copied();
        model_image(&mut self.decoder, frame, crop.as_ref())
    }

    /// Predicts and measures shear and force on exactly the saved frames, so that both can be reproduced
    /// from the files.
    fn analyse(&mut self, capture: &StageCapture) -> SavedAnalysis {
        let images = [Role::Left, Role::Right, Role::Rgb]
            .into_iter()
            .filter_map(|role| {
                let frame = &capture.cameras.get(&role)?.frame;
                Some((role, self.image(frame, role).ok()?))
            })
            .collect();
        let depth = capture.cameras.get(&Role::Depth).and_then(|camera| {
            let image = self.decoder.depth(&camera.frame).ok()?;
            let unit_m = camera.depth_unit_m?;
            Some(Depth { image, unit_m })
        });
        let (reply, answer) = channel();
        let request = InferRequest::Analyse {
            images,
            depth,
            reply,
        };
        let sent = self.infer.send(request).is_ok();
        let analysis = sent.then(|| answer.recv_timeout(ANALYSIS_TIMEOUT).ok());
        analysis.flatten().unwrap_or_default()
    }
}

/// Adds the shear of the gels to the frames that are to be stored.
fn add_shear(capture: &mut StageCapture, shear: &BTreeMap<Role, ShearFrame>) {
    for (role, frame) in shear {
        if let Some(summary) = frame.summary {
            capture.shear.insert(*role, summary);
        }
        let Some(field) = &frame.field else { continue };
        let (values, shape) = field.to_array();
        // The size of the array is the product of its shape.
        let array = FieldArray::markers(*role, values, shape, field.m_per_px);
        capture.fields.extend(array.ok());
    }
}

fn panicked(panic: &str) -> Error {
    Error::internal(format!("the store thread panicked: {panic}"))
        .remedy("what was acknowledged is on disk; restart gripcast if this happens again")
}

fn required_capture(capture: Option<&mut StageCapture>) -> Result<&mut StageCapture> {
    capture.ok_or_else(|| Error::internal("a save request has no frames"))
}

/// Converts a pending initial frame for the session.
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
