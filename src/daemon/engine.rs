//! The engine: joins cameras, inference, session and dataset; everything slow has its own thread.

use std::collections::{BTreeMap, VecDeque};
use std::future::Future;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::channel;
use std::time::Duration;

use jiff::Timestamp;
use serde::Serialize;
use tokio::sync::{mpsc, oneshot, watch};

use super::approach::{Approach, ApproachWatch};
use super::asked::{Answered, Asked};
use super::black_box::{BlackBox, BlackBoxSettings, Tap, Topic};
use super::calibration::store_calibration;
use super::capture::CaptureThreads;
use super::decode;
use super::hub::{Hub, Soundness};
use super::infer::{Inference, Live};
use super::pairing::{Paired, pair};
use super::report::{
    CollectReport, Ended, GraspReport, PredictionReport, camera_report, camera_status,
    cameras_note, fault_text,
};
use super::sheets::Boards;
use super::status::{CameraStatus, EngineStatus, PredictionStatus};
use super::store::{Store, StoreContext, StoreMessage, pending_frame};
use super::tasks::{TaskState, Tasks};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_capture::calibration::{RigFile, SourceKind};
use gripcast_capture::camera::{CameraOpener, Health, SupervisionPolicy, monotonic_ns};
use gripcast_capture::trigger::{self, Answer, Script, ScriptAction, ScriptRunner};
use gripcast_dataset::{CapturedCamera, DatasetWriter, NewDataset, StageCapture};
use gripcast_imaging::{CropProfile, Frame, Intrinsics, Role};
use gripcast_nn::predict::Model;
use gripcast_session::{
    CameraCondition, Command, CommandSource, Conditions, Effect, GuardLimits, Labels, Session,
    Step, StoreReply, StoreRequest, Tone,
};
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
    /// Who waits for the answer to the command that is being carried out.
    asker: Option<oneshot::Sender<Answered>>,
    script: Option<ScriptRunner>,
    script_command: ScriptCommand,
    /// How often the initial frame that is subtracted has changed.
    initial_change: u64,
    /// Whether the command that is being carried out is a label.
    labelling: bool,
    /// The request that the store is carrying out.
    request: Option<StoreRequest>,
    /// Frames of the trigger that is being carried out.
    capture_now: Option<StageCapture>,
    /// Board files that belong to them.
    boards_now: Option<[String; 2]>,
    grasps: Vec<GraspReport>,
    /// Those of this session that are in the trash.
    taken_back: BTreeMap<String, GraspReport>,
    disk_free_bytes: Option<u64>,
    was_live: BTreeMap<Role, bool>,
    /// Whether each thread was stuck, and how often it was started again.
    tasks_were: BTreeMap<String, (bool, u64)>,
    ticks: u64,
}

/// The script's newest command and its answer.
#[derive(Debug, Default)]
struct ScriptCommand {
    /// Given and not answered yet.
    open: Option<oneshot::Receiver<Answered>>,
    answer: Option<Answer>,
}

impl ScriptCommand {
    /// The answer, once it has come.
    fn answer(&mut self) -> Option<Answer> {
        let answered = self.open.as_mut().and_then(|open| open.try_recv().ok());
        if let Some(answered) = answered {
            self.open = None;
            self.answer = Some(match answered.complaint() {
                Some(complaint) => Answer::Refused(complaint),
                None => Answer::Saved,
            });
        }
        self.answer.clone()
    }
}

impl Engine {
    fn start(setup: EngineSetup, links: EngineLinks) -> Result<Self> {
        let crops = crop_profiles(&setup.rig)?;
        if let Some(model) = &setup.model {
            for (role, crop) in &crops {
                model
                    .contract()
                    .check_crop_profile(crop.name())
                    .map_err(|e| e.at(format!("camera {role}")))?;
            }
        }
        let (mut writer, opened) =
            DatasetWriter::open_or_create(&setup.dataset, &setup.new_dataset)?;
        let calibration = store_calibration(&mut writer, &setup.rig, &setup.intrinsics)?;
        if let Some(model) = &setup.model {
            writer.put_model(&model_card(model)?)?;
        }
        let pending = opened.pending.clone();
        let resumed = pending.as_ref().map(|pending| {
            let mut frame = pending_frame(pending);
            // The monotonic clock of an earlier run may have been another boot's.
            frame.trigger_time_ns = 0;
            frame
        });
        let dataset_name = writer.descriptor().name.clone();
        let counts = writer.counts().by_object.clone();

        let black_box = setup
            .black_box
            .map(|settings| {
                let origin = origin(&dataset_name, &setup.rig, setup.model.as_ref());
                BlackBox::start(settings, setup.dataset.clone(), origin)
            })
            .transpose()?;
        let tap = black_box.as_ref().map_or_else(Tap::default, BlackBox::tap);
        let hub = Hub::tapped(setup.rig.cameras.keys().copied(), tap);
        let (infer_requests, infer_inbox) = channel();
        let decoders = decode::start(
            &hub,
            |role| crops.get(&role).copied(),
            &infer_requests,
            &links.tasks,
        )?;
        let infer_channel = (infer_requests.clone(), infer_inbox);
        let inference = Inference::start(&hub, setup.model, infer_channel, &links.tasks)?;
        let external = setup.intrinsics.get(&Role::External).copied();
        let approach = ApproachWatch::start(&hub, setup.boards, external)?;
        let context = StoreContext {
            rig: setup.rig.id.clone(),
            calibration,
            model: inference.model.clone(),
            crops,
        };
        let (answers, replies) = mpsc::unbounded_channel();
        let store = Store::start(
            writer,
            pending,
            context,
            infer_requests,
            answers,
            &links.tasks,
        )?;
        let session = Session::new(setup.guards.clone(), setup.labels, counts, resumed);
        let initial_change = 0;
        if let Some(frame) = session.pending() {
            store.send(StoreMessage::UseInitial {
                id: Some(frame.id.clone()),
                change: initial_change,
            })?;
        }
        let capture = CaptureThreads::start(setup.openers, &hub, &setup.supervision, &links.tasks)?;
        Ok(Self {
            rig: setup.rig,
            dataset: setup.dataset,
            dataset_name,
            guards: setup.guards,
            hand: setup.hand,
            hub,
            capture,
            decoders,
            inference,
            approach,
            black_box,
            store,
            replies,
            links,
            session,
            waiting: VecDeque::new(),
            asker: None,
            script: setup.script.map(ScriptRunner::new),
            script_command: ScriptCommand::default(),
            initial_change,
            labelling: false,
            request: None,
            capture_now: None,
            boards_now: None,
            grasps: Vec::new(),
            taken_back: BTreeMap::new(),
            disk_free_bytes: None,
            was_live: BTreeMap::new(),
            tasks_were: BTreeMap::new(),
            ticks: 0,
        })
    }

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
                self.asker = asked.answer;
                if let Some(ended) = self.handle(asked.command, asked.source)? {
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

    fn advance_script(&mut self) -> Result<Option<Ended>> {
        let conditions = trigger::Conditions {
            all_live: self.all_live(),
            contact: self.touched(),
            fresh: self.fresh(),
            saving: self.session.is_storing(),
            last_answer: self.script_command.answer(),
        };
        let Some(script) = &mut self.script else {
            return Ok(None);
        };
        match script.next(monotonic_ns(), &conditions) {
            ScriptAction::Wait => Ok(None),
            ScriptAction::Done => Ok(Some(Ended::ScriptDone)),
            ScriptAction::Failed(error) => Err(error),
            ScriptAction::Command(text) => {
                let command: Command = text.parse().map_err(|e| {
                    Error::new(ErrorKind::Internal, "the script was not checked").because(e)
                })?;
                let (asked, answer) = Asked::with_answer(command, CommandSource::Script);
                self.script_command = ScriptCommand {
                    open: Some(answer),
                    answer: None,
                };
                self.waiting.push_back(asked);
                Ok(None)
            }
        }
    }

    /// Every camera delivers, and what it delivers can be used.
    fn all_live(&self) -> bool {
        self.hub.slots().all(|slot| {
            slot.facts(|facts| facts.health == Health::Live)
                && slot.frames().iter().any(|(_, s)| *s == Soundness::Sound)
        })
    }

    /// Every camera has a good frame newer than the last capture, and than the last change of what
    /// a virtual rig shows.
    fn fresh(&self) -> bool {
        let changed_ns = self.hand.as_ref().map_or(0, |hand| hand.since_ns());
        let since_ns = self.session.captured_ns().max(changed_ns);
        let frames = self.pair(monotonic_ns()).frames;
        self.hub.slots().all(|slot| {
            let frame = frames.get(&slot.role());
            frame.is_some_and(|frame| frame.driver_time_ns > since_ns)
        })
    }

    /// Whether something touches a gel, against the pending initial frame or else the last one;
    /// `None` until every gel was held against it in a frame newer than the last capture.
    fn touched(&self) -> Option<bool> {
        let findings = self.inference.findings();
        let change = match (self.session.pending(), findings.change) {
            // Before the first initial frame nothing is known to touch.
            (None, None) => return Some(false),
            (None, last) => last,
            (Some(_), _) => Some(self.initial_change),
        };
        let since_ns = self.session.captured_ns();
        let gels = self.hub.slots().filter(|slot| slot.role().is_tactile());
        let contacts = gels
            .map(|slot| findings.changed_fraction(slot.role(), change, since_ns))
            .collect::<Option<Vec<f64>>>()?;
        let limit = self.guards.min_contact_fraction;
        Some(contacts.iter().any(|changed| *changed >= limit))
    }

    /// A fault tone and a line of the log for every thread that had to be started again or is stuck.
    fn watch_tasks(&mut self) {
        for task in self.links.tasks.report() {
            let now = (task.state == TaskState::Stuck, task.restarts);
            let before = self.tasks_were.insert(task.name.clone(), now);
            if before.unwrap_or_default() != now {
                // Without a screen nobody hears it; the log has it.
                let _ = self.links.tones.send(Tone::Fault);
                self.log("task", &task);
            }
        }
    }

    /// A fault tone for every camera that falls out.
    fn watch_cameras(&mut self) {
        let hub = self.hub.clone();
        for slot in hub.slots() {
            let (live, reason) = slot.facts(|facts| {
                let live = facts.health == Health::Live;
                (live, format!("{:?}", facts.health))
            });
            let before = self.was_live.insert(slot.role(), live);
            if before == Some(true) && !live {
                // Without a screen nobody hears it; the log has it.
                let _ = self.links.tones.send(Tone::Fault);
            }
            if before.is_some_and(|before| before != live) {
                let event = if live { "camera_live" } else { "camera_fault" };
                let role = slot.role();
                let warnings = slot.facts(|facts| facts.warnings.clone());
                let what = serde_json::json!({
                    "role": role,
                    "health": reason,
                    "warnings": warnings,
                });
                self.log(event, &what);
            }
        }
    }

    fn handle(&mut self, command: Command, source: CommandSource) -> Result<Option<Ended>> {
        let now_ns = monotonic_ns();
        let paired = self.pair(now_ns);
        let conditions = self.conditions(&paired, now_ns);
        self.log(
            "command",
            &serde_json::json!({"command": command.to_string(), "source": source.name()}),
        );
        // The frame that is stored with the grasp is none of the approach.
        let external = paired.frames.get(&Role::External);
        let until_ns = external.map_or(now_ns, |frame| frame.driver_time_ns);
        let mut approach = self.approach_of_grasp(until_ns);
        self.boards_now = approach.boards.take();
        if let Some(why) = &approach.absence {
            self.log("no_pose", &serde_json::json!({"reason": why}));
        }
        self.capture_now = Some(self.stage_capture(paired, now_ns, source, approach));
        self.labelling = matches!(command, Command::Label(_));
        let effects = self.session.handle(command, &conditions);
        if !self.session.is_storing() {
            self.answer(&effects);
        }
        self.carry_out(effects)
    }

    fn take_reply(&mut self, reply: StoreReply) -> Vec<Effect> {
        self.tell_stored(&reply);
        let labelled_before = self.session.step() == Step::Label;
        let effects = self.session.completed(reply);
        if !self.session.is_storing() {
            self.answer(&effects);
        }
        // Undo and redo of a label stay with the object that is on the virtual table.
        if self.labelling
            && labelled_before
            && self.session.step() == Step::Initial
            && let Some(hand) = &self.hand
        {
            hand.next_object();
        }
        effects
    }

    fn tell_stored(&mut self, reply: &StoreReply) {
        let Some(request) = self.request.take() else {
            return;
        };
        self.note_grasp(&request, reply);
        let stored = Stored {
            at: Timestamp::now().to_string(),
            request,
            reply: reply.clone(),
        };
        (self.links.stored)(&stored);
        self.hub.tap().note(Topic::Stored, || &stored);
        self.log("stored", &stored);
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

    /// Keeps the list of this session's grasps in line with the dataset.
    fn note_grasp(&mut self, request: &StoreRequest, reply: &StoreReply) {
        match (request, reply) {
            (_, StoreReply::Failed { .. }) => {}
            (
                StoreRequest::SaveGrasp { .. },
                StoreReply::Grasp {
                    id,
                    object,
                    outcome,
                    predicted,
                },
            ) => self.grasps.push(GraspReport {
                id: id.to_string(),
                object: object.to_string(),
                outcome: *outcome,
                p_stable: predicted.map(|said| said.p_stable),
            }),
            (StoreRequest::SetOutcome { id, outcome }, _) => {
                if let Some(grasp) = self.grasps.iter_mut().find(|g| g.id == **id) {
                    grasp.outcome = *outcome;
                }
            }
            (StoreRequest::UndoGrasp { id } | StoreRequest::TrashGrasp { id }, _) => {
                if let Some(place) = self.grasps.iter().position(|g| g.id == **id) {
                    self.taken_back
                        .insert(id.to_string(), self.grasps.remove(place));
                }
            }
            (StoreRequest::RedoGrasp { id, .. } | StoreRequest::RestoreGrasp { id }, _) => {
                if let Some(grasp) = self.taken_back.remove(id.as_str()) {
                    let place = self.grasps.partition_point(|g| g.id < grasp.id);
                    self.grasps.insert(place, grasp);
                }
            }
            _ => {}
        }
    }

    /// Answers the command that is done.
    fn answer(&mut self, effects: &[Effect]) {
        let Some(asker) = self.asker.take() else {
            return;
        };
        // The status that follows from the command is there before its answer.
        self.send_status();
        let answered = Answered::of(effects, &self.session.view(monotonic_ns()));
        // Who asked may have gone.
        let _ = asker.send(answered);
    }

    fn send_status(&self) {
        // Nobody looks when the screen has left; the report tells the rest.
        let _ = self.links.status.send(Arc::new(self.status()));
    }

    fn carry_out(&mut self, effects: Vec<Effect>) -> Result<Option<Ended>> {
        for effect in effects {
            match effect {
                Effect::Store(request) => {
                    let saves = matches!(
                        request,
                        StoreRequest::SaveInitial { .. } | StoreRequest::SaveGrasp { .. }
                    );
                    let latency_ms = self.live().map_or(0.0, |live| live.latency_ms);
                    self.request = Some(request.clone());
                    self.store.send(StoreMessage::Carry {
                        request,
                        capture: self.capture_now.take().filter(|_| saves).map(Box::new),
                        boards: self.boards_now.take(),
                        latency_ms,
                    })?;
                }
                Effect::Tone(tone) => {
                    // Without a screen nobody listens.
                    let _ = self.links.tones.send(tone);
                }
                Effect::UseInitial(id) => {
                    self.initial_change += 1;
                    let change = self.initial_change;
                    self.store.send(StoreMessage::UseInitial { id, change })?;
                }
                Effect::Quit => return Ok(Some(Ended::Quit)),
            }
        }
        Ok(None)
    }

    fn live(&self) -> Option<Live> {
        self.inference.findings().live
    }

    fn pair(&self, now_ns: u64) -> Paired {
        let since_ns = self.session.captured_ns();
        let good: BTreeMap<Role, Vec<Frame>> = self
            .hub
            .slots()
            .filter(|slot| slot.facts(|facts| usable(&facts.health)))
            .map(|slot| {
                let sound = slot
                    .frames()
                    .into_iter()
                    .filter(|(_, s)| *s == Soundness::Sound)
                    .map(|(frame, _)| frame);
                let (new, old): (Vec<Frame>, Vec<Frame>) =
                    sound.partition(|frame| frame.driver_time_ns > since_ns);
                // Where there is none since the last capture, a guard tells.
                (slot.role(), if new.is_empty() { old } else { new })
            })
            .filter(|(_, frames)| !frames.is_empty())
            .collect();
        pair(&good, now_ns)
    }

    fn conditions(&self, paired: &Paired, now_ns: u64) -> Conditions {
        let findings = self.inference.findings();
        let change = Some(self.initial_change);
        let since_ns = self.session.captured_ns();
        let cameras = self
            .hub
            .slots()
            .map(|slot| {
                let role = slot.role();
                let frame = paired.frames.get(&role);
                let (fault, controls) =
                    slot.facts(|facts| (fault_text(&facts.health, now_ns), facts.controls.clone()));
                CameraCondition {
                    role,
                    age_ms: frame.map(|frame| age_ms(frame, now_ns)),
                    frame_time_ns: frame.map_or(0, |frame| frame.driver_time_ns),
                    fault,
                    controls,
                    contact_fraction: findings.changed_fraction(role, change, since_ns),
                }
            })
            .collect();
        Conditions {
            now_ns,
            cameras,
            skew_ms: paired.skew_ms,
            disk_free_bytes: disk_free_bytes(&self.dataset),
        }
    }

    /// What the external camera saw since the initial frame, while there is one.
    fn approach_of_grasp(&self, until_ns: u64) -> Approach {
        let pending = self.session.pending();
        let Some((watch, pending)) = self.approach.as_ref().zip(pending) else {
            return Approach::default();
        };
        watch.take(pending.trigger_time_ns, until_ns, pending.external.as_ref())
    }

    fn stage_capture(
        &self,
        paired: Paired,
        now_ns: u64,
        source: CommandSource,
        approach: Approach,
    ) -> StageCapture {
        let seen_ns = [Role::Left, Role::Right]
            .iter()
            .find_map(|role| paired.frames.get(role))
            .map_or(now_ns, |frame| frame.driver_time_ns);
        let captured = |role: Role, frame: Frame| {
            let slot = self.hub.slot(role)?;
            let (info, controls) = slot.facts(|facts| (facts.info.clone(), facts.controls.clone()));
            let info = info?;
            let config = self.rig.cameras.get(&role);
            Some(CapturedCamera {
                age_ms: age_ms(&frame, now_ns),
                frame,
                product: info.identity.product,
                serial: info.identity.serial,
                interface: info.identity.interface,
                port: info.identity.port,
                controls,
                crop_profile: config.and_then(|c| c.crop_profile.clone()),
                depth_unit_m: info.depth_unit_m,
            })
        };
        let Approach { frames, pose, .. } = approach;
        let approach: Vec<CapturedCamera> = frames
            .into_iter()
            .filter_map(|frame| captured(Role::External, frame))
            .collect();
        let cameras = paired
            .frames
            .into_iter()
            .filter_map(|(role, frame)| Some((role, captured(role, frame)?)))
            .collect();
        StageCapture {
            captured_at: Timestamp::now(),
            trigger_time_ns: now_ns,
            trigger: source.name().to_owned(),
            cameras,
            approach,
            pose: pose.map(Box::new),
            truth: self
                .hand
                .as_ref()
                .filter(|_| self.gels_are_virtual())
                .map(|hand| Box::new(hand.truth(seen_ns))),
        }
    }

    /// What the gels feel is what the simulator knows.
    fn gels_are_virtual(&self) -> bool {
        [Role::Left, Role::Right].iter().all(|role| {
            let camera = self.rig.cameras.get(role);
            camera.is_some_and(|camera| camera.source == SourceKind::Virtual)
        })
    }

    fn status(&self) -> EngineStatus {
        let now_ns = monotonic_ns();
        let findings = self.inference.findings();
        let prediction = findings.live.zip(self.inference.model.as_ref());
        EngineStatus {
            dataset: self.dataset_name.clone(),
            rig: self.rig.id.clone(),
            clock: jiff::Zoned::now().strftime("%H:%M:%S").to_string(),
            disk_free_bytes: self.disk_free_bytes,
            black_box: self.black_box.as_ref().map(BlackBox::status),
            session: self.session.view(now_ns),
            cameras: self
                .hub
                .slots()
                .map(|slot| {
                    let approach = self.approach.as_ref();
                    let approach = approach.filter(|_| slot.role() == Role::External);
                    CameraStatus {
                        markers: approach.and_then(ApproachWatch::newest),
                        ..camera_status(slot, &self.rig, now_ns)
                    }
                })
                .collect(),
            prediction: prediction.map(|(live, model)| PredictionStatus {
                p_stable: live.p_stable,
                novelty: live.novelty,
                threshold: model.threshold,
                model: model.name.clone(),
                frame_age_ms: now_ns.saturating_sub(live.frame_time_ns) as f64 * 1e-6,
                latency_ms: live.latency_ms,
                engine_ms: live.engine_ms,
                heuristic: model.heuristic,
            }),
            prediction_absent: findings.absent.clone(),
            previews: findings.previews.clone(),
        }
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
        let model = self.inference.model.clone().map(|model| model.name);
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
            for effect in self.take_reply(reply) {
                if let Effect::Store(request) = effect {
                    let message = StoreMessage::Carry {
                        request,
                        capture: None,
                        boards: None,
                        latency_ms: 0.0,
                    };
                    if self.store.send(message).is_err() {
                        return;
                    }
                }
            }
        }
    }
}

/// Crop profile of every tactile camera.
fn crop_profiles(rig: &RigFile) -> Result<BTreeMap<Role, CropProfile>> {
    rig.cameras
        .iter()
        .filter_map(|(role, camera)| Some((*role, camera.crop_profile.as_deref()?)))
        .map(|(role, name)| {
            let crop = CropProfile::by_name(name).map_err(|e| e.at(format!("camera {role}")))?;
            Ok((role, crop))
        })
        .collect()
}

fn model_card(model: &Model) -> Result<String> {
    let card = serde_json::json!({
        "name": model.contract().name,
        "sha256": model.sha256(),
        "threshold": model.contract().threshold,
        "heuristic": model.contract().is_heuristic(),
    });
    serde_json::to_string_pretty(&card)
        .map_err(|e| Error::new(ErrorKind::Internal, "cannot write the model card").because(e))
}

/// What the files of the black box say about themselves.
fn origin(dataset: &str, rig: &RigFile, model: Option<&Model>) -> BTreeMap<String, String> {
    let model = model.map(|model| {
        [
            ("model", model.contract().name.clone()),
            ("model_sha256", model.sha256().to_owned()),
            ("threshold", model.contract().threshold.to_string()),
        ]
    });
    [("dataset", dataset.to_owned()), ("rig", rig.id.clone())]
        .into_iter()
        .chain(model.into_iter().flatten())
        .map(|(key, value)| (key.to_owned(), value))
        .collect()
}

fn disk_free_bytes(path: &std::path::Path) -> Option<u64> {
    let disk = rustix::fs::statvfs(path).ok()?;
    Some(disk.f_bavail.saturating_mul(disk.f_frsize))
}

fn age_ms(frame: &Frame, now_ns: u64) -> f64 {
    now_ns.saturating_sub(frame.driver_time_ns) as f64 * 1e-6
}

/// Whether frames of a camera in this state may be saved; age is another matter.
fn usable(health: &Health) -> bool {
    matches!(health, Health::Live | Health::Silent { .. } | Health::Ended)
}
