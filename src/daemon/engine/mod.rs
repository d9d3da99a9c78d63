//! The engine: connects cameras, inference, session and dataset. All slow work has its own thread.

mod adapt;
mod commands;
#[cfg(test)]
mod engine_test;
mod frames;
mod lift;
mod monitor;
mod script;
mod start;

use std::collections::{BTreeMap, VecDeque};
use std::future::Future;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use jiff::Timestamp;
use serde::Serialize;
use tokio::sync::{mpsc, watch};

use self::adapt::RigAdaptation;
use self::commands::Pending;
use self::lift::KeptLift;
use self::script::ScriptCommand;
use super::black_box::{BlackBox, BlackBoxSettings, Topic};
use super::boards::Boards;
use super::capture::CaptureThreads;
use super::command_request::CommandRequest;
use super::hub::Hub;
use super::infer::{Inference, ModelInfo};
use super::pre_grasp::PreGraspRecorder;
use super::report::{
    CollectReport, EndReason, GraspReport, PredictionReport, camera_report, cameras_json,
};
use super::shear::{GelForces, GelScale};
use super::start_report::{StartFinding, StartSubject};
use super::status::{EngineStatus, disk_free_bytes};
use super::store::{Store, StoreMessage};
use super::tasks::Tasks;
use super::thread::lock;
use gripcast_base::error::Result;
use gripcast_base::files::GraspId;
use gripcast_capture::calibration::{RigFile, SourceKind};
use gripcast_capture::camera::{CameraOpener, SupervisionPolicy, monotonic_ns};
use gripcast_capture::trigger::{Script, ScriptRunner};
use gripcast_dataset::{GraspIndex, NewDataset, Provenance};
use gripcast_imaging::{Intrinsics, Role};
use gripcast_nn::predict::Model;
use gripcast_session::{
    GuardLimits, Labels, OutcomeCounts, Session, Step, StoreReply, StoreRequest, Tone,
};
use gripcast_tactile::force::ForceCalibration;
use gripcast_virtual_rig::{HandTarget, VirtualHand};

/// Interval of status updates and script steps.
const TICK: Duration = Duration::from_millis(50);

/// Interval of free-space checks, ticks.
const DISK_TICKS: u64 = 20;

/// Inputs of the engine.
pub struct EngineSetup {
    /// Rig file.
    pub rig: RigFile,
    /// Known intrinsics of the colour cameras.
    pub intrinsics: BTreeMap<Role, Intrinsics>,
    /// Scale and gel markers of the tactile cameras where they are known.
    pub gel_scales: BTreeMap<Role, GelScale>,
    /// Force estimators of the tactile cameras.
    pub gel_forces: GelForces,
    /// Force calibrations of the tactile cameras that have one.
    pub force_calibrations: BTreeMap<Role, ForceCalibration>,
    /// Camera openers.
    pub openers: Vec<Box<dyn CameraOpener>>,
    /// Camera supervision.
    pub supervision: SupervisionPolicy,
    /// Dataset directory.
    pub dataset: PathBuf,
    /// Index of the dataset, which the engine fills and readers share.
    pub index: GraspIndex,
    /// Metadata of a new dataset.
    pub new_dataset: NewDataset,
    /// Initial labels.
    pub labels: Labels,
    /// Guard limits.
    pub guards: GuardLimits,
    /// Model; `None` disables predictions.
    pub model: Option<Model>,
    /// What is added to the model's probability.
    pub decision: DecisionSettings,
    /// Scripted commands.
    pub script: Option<Script>,
    /// Printed boards in view of the external camera.
    pub boards: Option<Boards>,
    /// Hand of the virtual rig, which follows the session's steps.
    pub hand: Option<Arc<VirtualHand>>,
    /// Labelled grasps wanted per object; 0: no target.
    pub target_per_object: u32,
    /// Time after the grasp trigger for which the frames of the gels are stored; 0: none.
    pub keep_lift: Duration,
    /// Settings of the black box, if enabled.
    pub black_box: Option<BlackBoxSettings>,
}

/// What is added to a model's probability.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DecisionSettings {
    /// Error rate of prediction sets; none: no sets.
    pub error_rate: Option<f64>,
    /// Weight of the prior, in labels, with which predictions are adapted to the base rate of the
    /// rig's labels; none: no adaptation.
    pub adapt_strength: Option<f64>,
}

/// Channels between the engine and screens, triggers and API.
pub struct EngineLinks {
    /// Incoming commands.
    pub commands: mpsc::Receiver<CommandRequest>,
    /// Updated guard limits.
    pub limits: mpsc::Receiver<GuardLimits>,
    /// Registry of the engine's threads.
    pub tasks: Tasks,
    /// Outgoing status.
    pub status: watch::Sender<Arc<EngineStatus>>,
    /// Outgoing tones.
    pub tones: mpsc::UnboundedSender<Tone>,
    /// Called after every store request.
    pub on_stored: Box<dyn FnMut(&StoreEvent) + Send>,
}

/// A store request and its reply; unless it failed, the change is durable.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StoreEvent {
    /// Wall clock time of the reply, RFC 3339 UTC.
    pub at: String,
    /// The request.
    pub request: StoreRequest,
    /// The reply.
    pub reply: StoreReply,
}

/// Runs the engine until the operator quits, the script ends, or `stop` resolves.
///
/// # Errors
/// If the dataset cannot be opened, a thread cannot be started, or a script step fails.
/// Acknowledged changes are on disk in every case.
pub async fn run(
    setup: EngineSetup,
    links: EngineLinks,
    stop: impl Future<Output = EndReason>,
) -> Result<CollectReport> {
    let mut engine = Engine::start(setup, links)?;
    let ended = engine.run_until_end(stop).await;
    engine.finish(ended).await
}

struct Engine {
    rig: RigFile,
    dataset: PathBuf,
    dataset_name: String,
    guards: GuardLimits,
    hand: Option<Arc<VirtualHand>>,
    hub: Hub,
    capture: CaptureThreads,
    decoders: Vec<std::thread::JoinHandle<()>>,
    inference: Inference,
    pre_grasp: Option<PreGraspRecorder>,
    black_box: Option<BlackBox>,
    store: Store,
    replies: mpsc::UnboundedReceiver<StoreReply>,
    links: EngineLinks,
    session: Session,
    queued: VecDeque<CommandRequest>,
    /// Set by `quit` and by the end of the script.
    ended: Option<EndReason>,
    /// Number of the newest command.
    last_command: u64,
    pending: Option<Pending>,
    script: Option<ScriptRunner>,
    script_command: ScriptCommand,
    /// Revision of the initial frame used for inference.
    initial_revision: u64,
    grasps: Vec<GraspReport>,
    /// Grasps of this session that are in the trash.
    undone: BTreeMap<String, GraspReport>,
    disk_free_bytes: Option<u64>,
    target_per_object: u32,
    keep_lift: Duration,
    /// The lift whose frames are being kept.
    lift: Option<KeptLift>,
    /// The grasp that was saved last, which the verdict in the lift is about; stays where it is undone.
    lifted: Option<GraspId>,
    /// Number of grasps by object and outcome, as of the last second.
    objects: Arc<OutcomeCounts>,
    /// What opening the dataset found, one sentence each.
    opening: Vec<String>,
    /// What the dataset's grasps were taken with, at the start.
    provenance: Provenance,
    /// The model.
    model: Option<ModelInfo>,
    /// Adaptation to the rig's labels.
    adaptation: Option<RigAdaptation>,
    /// Source of the newest grasp's frames, at the start.
    newest_source: Option<SourceKind>,
    /// Wall clock and `CLOCK_MONOTONIC` (ns) at the start.
    started: (Timestamp, u64),
    /// What differs from them now.
    start_report: Vec<StartFinding>,
    /// All findings of this session.
    start_findings: BTreeMap<StartSubject, StartFinding>,
    was_live: BTreeMap<Role, bool>,
    /// Whether each thread was stuck, and its restarts.
    last_task_states: BTreeMap<String, (bool, u64)>,
    ticks: u64,
}

impl Engine {
    async fn run_until_end(&mut self, stop: impl Future<Output = EndReason>) -> Result<EndReason> {
        tokio::pin!(stop);
        let mut ticks = tokio::time::interval(TICK);
        ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        let (mut commands_open, mut limits_open) = (true, true);
        loop {
            tokio::select! {
                biased;
                Some(reply) = self.replies.recv() => {
                    let effects = self.handle_reply(reply);
                    self.apply(effects)?;
                    if self.ended.is_none() {
                        self.advance_script()?;
                    }
                }
                ended = &mut stop => return Ok(ended),
                command = self.links.commands.recv(), if commands_open => match command {
                    Some(request) => self.queued.push_back(request),
                    None => commands_open = false,
                },
                limits = self.links.limits.recv(), if limits_open => match limits {
                    Some(limits) => self.set_limits(limits),
                    None => limits_open = false,
                },
                _ = ticks.tick() => self.tick()?,
            }
            while self.ended.is_none()
                && !self.session.is_storing()
                && let Some(request) = self.queued.pop_front()
            {
                self.handle(request)?;
            }
            if let Some(ended) = self.ended {
                return Ok(ended);
            }
        }
    }

    fn set_limits(&mut self, limits: GuardLimits) {
        self.log("guards", &limits);
        self.guards = limits.clone();
        self.session.set_limits(limits);
    }

    fn tick(&mut self) -> Result<()> {
        if self.ticks.is_multiple_of(DISK_TICKS) {
            self.disk_free_bytes = disk_free_bytes(&self.dataset);
            self.objects = Arc::new(self.session.outcome_counts().clone());
            self.adapt();
            self.check_start();
            self.hub.tap.json(Topic::Cameras, || {
                cameras_json(&self.hub, &self.rig, monotonic_ns())
            });
        }
        self.ticks += 1;
        self.store_lift_if_complete()?;
        self.check_cameras();
        self.check_tasks();
        if let Some(hand) = &self.hand {
            hand.move_to(match self.session.step() {
                Step::Initial => HandTarget::Open,
                Step::Grasp => HandTarget::Closed,
                Step::Label => HandTarget::Lifted,
            });
        }
        if let Some(recorder) = &self.pre_grasp {
            recorder.set_object(&self.session.view(monotonic_ns()).object);
        }
        self.send_status();
        self.advance_script()
    }

    /// Writes a log line; failures must not stop the collection.
    fn log(&self, event: &str, what: &impl Serialize) {
        let line = serde_json::json!({
            "at": Timestamp::now().to_string(),
            "event": event,
            "what": what,
        });
        self.hub.tap.json(Topic::Events, || &line);
        let _ = self.store.send(StoreMessage::Log(line));
    }

    /// Finishes pending requests, then ends all threads in the order of the data flow.
    async fn finish(mut self, ended: Result<EndReason>) -> Result<CollectReport> {
        self.drain_replies().await;
        let lift = self.store_lift();
        let session = self.session.summary();
        self.links.tasks.close();
        self.hub.close();
        self.capture.stop();
        // The counts of the capture threads are final.
        let cameras = self
            .hub
            .slots()
            .map(|slot| (slot.role, camera_report(slot, &self.rig)))
            .collect::<BTreeMap<_, _>>();
        self.log(
            "end",
            &serde_json::json!({"session": session, "cameras": cameras}),
        );
        let (stored, lifts) = self.store.stop();
        for decoder in self.decoders {
            // A panic has been reported already.
            let _ = decoder.join();
        }
        if let Some(recorder) = self.pre_grasp {
            recorder.join();
        }
        let model = self.inference.model.clone();
        let state = self.inference.stop();
        // Last: the grasps are durable and all writers to the black box have ended.
        let black_box = self.black_box.map(BlackBox::stop);
        let state = lock(&state);
        let ended = ended?;
        stored?;
        lift?;
        Ok(CollectReport {
            dataset: self.dataset.display().to_string(),
            rig: self.rig.id,
            ended,
            session,
            start_report: self.start_findings.into_values().collect(),
            grasps: self.grasps,
            cameras,
            prediction: PredictionReport {
                model,
                predictions: state.predictions,
                failures: state.failures,
                latency_p50_ms: state.latency.quantile_ms(0.5),
                latency_p99_ms: state.latency.quantile_ms(0.99),
                gel_judge_p50_ms: state.judge_time.quantile_ms(0.5),
                shear_p50_ms: state.shear_time.quantile_ms(0.5),
            },
            lifts,
            black_box,
        })
    }

    /// Waits for the pending store request, so that the report is complete.
    async fn drain_replies(&mut self) {
        while self.session.is_storing() {
            let Some(reply) = self.replies.recv().await else {
                return;
            };
            let effects = self.handle_reply(reply);
            if self.apply(effects).is_err() {
                return;
            }
        }
    }
}
