//! The engine: joins cameras, inference, session and dataset; everything slow has its own thread.

mod commands;
#[cfg(test)]
mod engine_test;
mod frames;
mod script;
mod start;
mod watching;

use std::collections::{BTreeMap, VecDeque};
use std::future::Future;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use jiff::Timestamp;
use serde::Serialize;
use tokio::sync::{mpsc, watch};

use self::commands::Pending;
use self::script::ScriptCommand;
use super::approach::ApproachWatch;
use super::asked::Asked;
use super::black_box::{BlackBox, BlackBoxSettings, Topic};
use super::capture::CaptureThreads;
use super::hub::Hub;
use super::infer::Inference;
use super::report::{
    CollectReport, Ended, GraspReport, PredictionReport, camera_report, cameras_note,
};
use super::sheets::Boards;
use super::status::EngineStatus;
use super::store::{Store, StoreMessage};
use super::tasks::Tasks;
use gripcast_base::error::Result;
use gripcast_capture::calibration::RigFile;
use gripcast_capture::camera::{CameraOpener, SupervisionPolicy, monotonic_ns};
use gripcast_capture::trigger::{Script, ScriptRunner};
use gripcast_dataset::NewDataset;
use gripcast_imaging::{Intrinsics, Role};
use gripcast_nn::predict::Model;
use gripcast_session::{GuardLimits, Labels, Session, Step, StoreReply, StoreRequest, Tone};
use gripcast_virtual_rig::{HandGoal, VirtualHand};

/// How often the status is renewed and the script asked.
const TICK: Duration = Duration::from_millis(50);

/// How often the disk is asked for its free space, in ticks.
const DISK_TICKS: u64 = 20;

/// All that the engine works with.
pub struct EngineSetup {
    /// The rig.
    pub rig: RigFile,
    /// Intrinsics of its colour cameras, where known.
    pub intrinsics: BTreeMap<Role, Intrinsics>,
    /// Its cameras.
    pub openers: Vec<Box<dyn CameraOpener>>,
    /// How cameras are supervised.
    pub supervision: SupervisionPolicy,
    /// Dataset directory.
    pub dataset: PathBuf,
    /// What a new dataset is told about itself.
    pub new_dataset: NewDataset,
    /// Names at the start.
    pub labels: Labels,
    /// Limits of the guards.
    pub guards: GuardLimits,
    /// Model; without one there is no prediction.
    pub model: Option<Model>,
    /// Timed commands.
    pub script: Option<Script>,
    /// The printed markers that the external camera sees, where they are known.
    pub boards: Option<Boards>,
    /// The hand of the virtual rig, which follows the session's steps like an operator.
    pub hand: Option<Arc<VirtualHand>>,
    /// The continuous log, where one is wanted.
    pub black_box: Option<BlackBoxSettings>,
}

/// The engine's ends of the channels to screens and triggers.
pub struct EngineLinks {
    /// What operators ask for.
    pub commands: mpsc::Receiver<Asked>,
    /// Limits of the guards from then on.
    pub limits: mpsc::Receiver<GuardLimits>,
    /// The board of its threads.
    pub tasks: Tasks,
    /// The newest status.
    pub status: watch::Sender<Arc<EngineStatus>>,
    /// Sounds to give.
    pub tones: mpsc::UnboundedSender<Tone>,
    /// Is told every answered change of the dataset, when it is answered.
    pub stored: Box<dyn FnMut(&Stored) + Send>,
}

/// A change of the dataset that was asked for and its answer; unless it failed, it is durable.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Stored {
    /// Wall clock of the answer, RFC 3339 UTC.
    pub at: String,
    /// What was asked for.
    pub request: StoreRequest,
    /// The answer.
    pub reply: StoreReply,
}

/// Runs until the operator quits, the script ends, or `stop` resolves.
///
/// # Errors
/// When the dataset cannot be opened, a thread cannot be had, or a script step does not hold. What
/// was acknowledged is on disk in every case.
pub async fn run(
    setup: EngineSetup,
    links: EngineLinks,
    stop: impl Future<Output = Ended>,
) -> Result<CollectReport> {
    let mut engine = Engine::start(setup, links)?;
    let ended = engine.turn(stop).await;
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
    approach: Option<ApproachWatch>,
    black_box: Option<BlackBox>,
    store: Store,
    replies: mpsc::UnboundedReceiver<StoreReply>,
    links: EngineLinks,
    session: Session,
    waiting: VecDeque<Asked>,
    /// Number of the newest command.
    last_command: u64,
    pending: Option<Pending>,
    script: Option<ScriptRunner>,
    script_command: ScriptCommand,
    /// How often the initial frame that is subtracted has changed.
    initial_change: u64,
    grasps: Vec<GraspReport>,
    /// Those of this session that are in the trash.
    taken_back: BTreeMap<String, GraspReport>,
    disk_free_bytes: Option<u64>,
    was_live: BTreeMap<Role, bool>,
    /// Whether each thread was stuck, and how often it was started again.
    tasks_were: BTreeMap<String, (bool, u64)>,
    ticks: u64,
}

impl Engine {
    async fn turn(&mut self, stop: impl Future<Output = Ended>) -> Result<Ended> {
        tokio::pin!(stop);
        let mut ticks = tokio::time::interval(TICK);
        ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        let (mut commands_open, mut limits_open) = (true, true);
        loop {
            tokio::select! {
                biased;
                Some(reply) = self.replies.recv() => {
                    let effects = self.take_reply(reply);
                    if let Some(ended) = self.carry_out(effects)? {
                        return Ok(ended);
                    }
                    if let Some(ended) = self.advance_script()? {
                        return Ok(ended);
                    }
                }
                ended = &mut stop => return Ok(ended),
                command = self.links.commands.recv(), if commands_open => match command {
                    Some(command) => self.waiting.push_back(command),
                    None => commands_open = false,
                },
                limits = self.links.limits.recv(), if limits_open => match limits {
                    Some(limits) => self.take_limits(limits),
                    None => limits_open = false,
                },
                _ = ticks.tick() => {
                    if let Some(ended) = self.tick()? {
                        return Ok(ended);
                    }
                }
            }
            while !self.session.is_storing()
                && let Some(asked) = self.waiting.pop_front()
            {
                if let Some(ended) = self.handle(asked)? {
                    return Ok(ended);
                }
            }
        }
    }

    fn take_limits(&mut self, limits: GuardLimits) {
        self.log("guards", &limits);
        self.guards = limits.clone();
        self.session.set_limits(limits);
    }

    fn tick(&mut self) -> Result<Option<Ended>> {
        if self.ticks.is_multiple_of(DISK_TICKS) {
            self.disk_free_bytes = disk_free_bytes(&self.dataset);
            self.hub.tap().note(Topic::Cameras, || {
                cameras_note(&self.hub, &self.rig, monotonic_ns())
            });
        }
        self.ticks += 1;
        self.watch_cameras();
        self.watch_tasks();
        if let Some(hand) = &self.hand {
            hand.go(match self.session.step() {
                Step::Initial => HandGoal::Open,
                Step::Grasp => HandGoal::Closed,
                Step::Label => HandGoal::Lifted,
            });
        }
        if let Some(approach) = &self.approach {
            approach.set_object(&self.session.view(monotonic_ns()).object);
        }
        self.send_status();
        self.advance_script()
    }

    /// A line of the log; it explains and must not stop the collection.
    fn log(&self, event: &str, what: &impl Serialize) {
        let line = serde_json::json!({
            "at": Timestamp::now().to_string(),
            "event": event,
            "what": what,
        });
        self.hub.tap().note(Topic::Events, || &line);
        let _ = self.store.send(StoreMessage::Log(line));
    }

    /// Ends all threads in the order of the data flow; what was asked for is carried out first.
    async fn finish(mut self, ended: Result<Ended>) -> Result<CollectReport> {
        self.drain_replies().await;
        let session = self.session.summary();
        self.links.tasks.close();
        self.hub.close();
        self.capture.stop();
        // The capture threads have told their last counts.
        let cameras = self
            .hub
            .slots()
            .map(|slot| (slot.role(), camera_report(slot, &self.rig)))
            .collect::<BTreeMap<_, _>>();
        self.log(
            "end",
            &serde_json::json!({"session": session, "cameras": cameras}),
        );
        let stored = self.store.stop();
        for decoder in self.decoders {
            // A decoder that panicked has nothing left to give back.
            let _ = decoder.join();
        }
        if let Some(approach) = self.approach {
            approach.join();
        }
        let model = self.inference.model().map(str::to_owned);
        let findings = self.inference.stop();
        // Last: the grasps are durable, and nobody puts anything in any more.
        let black_box = self.black_box.map(BlackBox::stop);
        let findings = findings
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner);
        let ended = ended?;
        stored?;
        Ok(CollectReport {
            dataset: self.dataset.display().to_string(),
            rig: self.rig.id,
            ended,
            session,
            grasps: self.grasps,
            cameras,
            prediction: PredictionReport {
                model,
                predictions: findings.predictions,
                failures: findings.failures,
                latency_p50_ms: findings.latency.quantile_ms(0.5),
                latency_p99_ms: findings.latency.quantile_ms(0.99),
            },
            black_box,
        })
    }

    /// Waits for the request under way, so that the report is true.
    async fn drain_replies(&mut self) {
        while self.session.is_storing() {
            let Some(reply) = self.replies.recv().await else {
                return;
            };
            let effects = self.take_reply(reply);
            if self.carry_out(effects).is_err() {
                return;
            }
        }
    }
}

fn disk_free_bytes(path: &Path) -> Option<u64> {
    let disk = rustix::fs::statvfs(path).ok()?;
    Some(disk.f_bavail.saturating_mul(disk.f_frsize))
}
