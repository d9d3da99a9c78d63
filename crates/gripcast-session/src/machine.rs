//! The state machine itself.

use std::collections::BTreeMap;
use std::fmt;

use serde::Serialize;

use super::command::{Command, CommandResult, Request};
use super::guard::{self, Conditions, Guard, GuardLimits, Objection};
use super::history::Done;
use super::pending::PendingFrame;
use super::store::{Labels, StoreReply, StoreRequest};
use super::view::{Counts, LastGrasp, Message, MessageLevel, Refusal, SessionView, Step, Tone};
use gripcast_base::files::ObjectName;
use gripcast_dataset::{GraspId, Outcome, OverriddenGuard, Stage};

/// Grasps by object and outcome.
pub type OutcomeCounts = BTreeMap<ObjectName, BTreeMap<Outcome, usize>>;

/// What the engine has to do.
#[derive(Clone, Debug, PartialEq)]
pub enum Effect {
    /// Change the dataset; answered by [`Session::completed`].
    Store(StoreRequest),
    /// Make a sound.
    Tone(Tone),
    /// The frame that is subtracted has changed; `None` = there is none.
    UseInitial(Option<GraspId>),
    /// A command has been answered: nothing more follows from it.
    Result {
        /// Number of the request.
        id: u64,
        /// What became of it.
        result: CommandResult,
    },
    /// End.
    Quit,
}

/// What the request under way is for.
#[derive(Clone, Debug)]
pub(crate) enum InFlight {
    Initial,
    DiscardReplaced,
    Grasp,
    Label(Outcome),
    Trash,
    Restore,
    Undo(Done),
    Redo(Done),
    /// Second half of undoing a re-taken initial: the earlier one comes back.
    UndoRestore,
    /// First half of redoing a re-taken initial: the earlier one has gone.
    RedoRestore(Done),
}

/// The collection session; see the module's documentation.
#[derive(Debug)]
pub struct Session {
    limits: GuardLimits,
    labels: Labels,
    counts: OutcomeCounts,
    pub(crate) pending: Option<PendingFrame>,
    pub(crate) last: Option<LastGrasp>,
    pub(crate) undo: Vec<Done>,
    pub(crate) redo: Vec<Done>,
    in_flight: Option<InFlight>,
    /// Number of the newest command, and what became of it so far.
    command: (u64, CommandResult),
    /// The trigger that guards refused, and why.
    refused: Option<(Stage, Vec<Objection>)>,
    message: Option<Message>,
    pub(crate) summary: Summary,
    /// Time of the last capture, ns; 0 before the first.
    captured_ns: u64,
}

/// What happened, for the closing line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Summary {
    /// Initial frames saved.
    pub initials: u64,
    /// Grasps saved.
    pub saved: u64,
    /// Labels given.
    pub labelled: u64,
    /// Triggers refused by a guard.
    pub refused: u64,
    /// Refusals overridden.
    pub overridden: u64,
    /// Steps taken back.
    pub undone: u64,
    /// Steps done again.
    pub redone: u64,
    /// Requests that failed on disk.
    pub failed: u64,
}

impl Session {
    /// A session on a dataset that holds `counts` and perhaps an initial frame from before.
    #[must_use]
    pub fn new(
        limits: GuardLimits,
        labels: Labels,
        counts: OutcomeCounts,
        pending: Option<PendingFrame>,
    ) -> Self {
        let message = pending.as_ref().map(|frame| Message {
            level: MessageLevel::Warning,
            text: format!(
                "going on with the initial frame of {}; press i to take it again",
                frame.captured_at
            ),
        });
        Self {
            limits,
            labels,
            counts,
            pending,
            last: None,
            undo: Vec::new(),
            redo: Vec::new(),
            in_flight: None,
            command: (0, CommandResult::Accepted),
            refused: None,
            message,
            summary: Summary::default(),
            captured_ns: 0,
        }
    }

    /// Takes other limits of the guards from now on.
    pub fn set_limits(&mut self, limits: GuardLimits) {
        self.limits = limits;
    }

    /// Whether a request is under way; commands have to wait until it is answered.
    #[must_use]
    pub fn is_storing(&self) -> bool {
        self.in_flight.is_some()
    }

    /// What happened so far.
    #[must_use]
    pub fn summary(&self) -> Summary {
        self.summary
    }

    /// The initial frame that waits for its grasp.
    #[must_use]
    pub fn pending(&self) -> Option<&PendingFrame> {
        self.pending.as_ref()
    }

    /// Time of the last capture, `CLOCK_MONOTONIC`, ns; only newer frames can be captured.
    #[must_use]
    pub fn captured_ns(&self) -> u64 {
        self.captured_ns
    }

    /// Names that go into the next grasp.
    #[must_use]
    pub fn labels(&self) -> &Labels {
        &self.labels
    }

    /// Step that comes next.
    #[must_use]
    pub fn step(&self) -> Step {
        match (&self.pending, &self.last) {
            (Some(_), _) => Step::Grasp,
            (None, Some(last)) if last.outcome == Outcome::Unlabelled => Step::Label,
            (None, _) => Step::Initial,
        }
    }

    /// Whether the latest trigger was refused and not followed by another command.
    #[must_use]
    pub fn is_refused(&self) -> bool {
        self.refused.is_some()
    }

    /// Whether a command would take frames now; the cameras are looked at for these alone.
    #[must_use]
    pub fn is_trigger(&self, command: &Command) -> bool {
        match command {
            Command::Initial | Command::Grasp => true,
            Command::Trigger => self.step() != Step::Label,
            Command::Override => self
                .refused
                .as_ref()
                .is_some_and(|(_, objections)| can_override(objections)),
            _ => false,
        }
    }

    /// Takes a command; `now` is what the cameras show where it [is a trigger](Self::is_trigger).
    /// Must not be called while [`Session::is_storing`].
    pub fn handle(&mut self, request: Request, now: Option<&Conditions>) -> Vec<Effect> {
        self.command = (request.id, CommandResult::Accepted);
        let refused = self.refused.take();
        self.message = None;
        let effects = match request.command {
            Command::Override => match refused {
                Some((stage, objections)) => self.override_guards(stage, objections, now),
                None => self.nothing("there is nothing to override"),
            },
            Command::Trigger => match self.step() {
                Step::Initial => self.capture(Stage::Initial, now, false),
                Step::Grasp => self.capture(Stage::Grasp, now, false),
                Step::Label => self.nothing("lift, then label the grasp: s stable, f slip"),
            },
            Command::Initial => self.capture(Stage::Initial, now, false),
            Command::Grasp => self.capture(Stage::Grasp, now, false),
            Command::Label(outcome) => self.label(outcome),
            Command::Relabel(id, outcome) => self.set_outcome(id, outcome),
            Command::Trash(id) => self.store(InFlight::Trash, StoreRequest::TrashGrasp { id }),
            Command::Restore(id) => {
                self.store(InFlight::Restore, StoreRequest::RestoreGrasp { id })
            }
            Command::Undo => self.undo(),
            Command::Redo => self.redo(),
            Command::Object(name) => self.rename(name, |labels| &mut labels.object, "object"),
            Command::Scene(name) => self.rename(name, |labels| &mut labels.scene, "scene"),
            Command::Operator(name) => self.rename(name, |labels| &mut labels.operator, "operator"),
            Command::Quit => vec![Effect::Quit],
        };
        self.concluded(effects)
    }

    /// Takes the answer to the request under way.
    pub fn completed(&mut self, reply: StoreReply) -> Vec<Effect> {
        let Some(in_flight) = self.in_flight.take() else {
            return Vec::new();
        };
        let effects = match (in_flight, reply) {
            (in_flight, StoreReply::Failed { message }) => self.store_failed(in_flight, &message),
            (InFlight::Initial, StoreReply::Initial(frame)) => self.initial_saved(frame),
            (InFlight::Grasp, StoreReply::Grasp(grasp)) => self.grasp_saved(grasp),
            (InFlight::Label(outcome), StoreReply::Labelled { id, object, before }) => {
                self.labelled(id, object, before, outcome)
            }
            (InFlight::Trash, StoreReply::Trashed(grasp)) => self.trashed(grasp),
            (InFlight::Restore, StoreReply::Grasp(grasp)) => self.restored(grasp),
            (InFlight::Undo(done), reply) => self.undone(done, reply),
            (InFlight::Redo(done), reply) => self.redone(done, reply),
            (InFlight::UndoRestore, StoreReply::Initial(frame)) => {
                self.pending = Some(frame);
                self.finish_undo("the initial frame before is back")
            }
            (InFlight::RedoRestore(done), _) => self.redo_restore(done),
            _ => Vec::new(),
        };
        self.concluded(effects)
    }

    /// Adds the command's result once nothing more follows from it.
    fn concluded(&mut self, mut effects: Vec<Effect>) -> Vec<Effect> {
        if !self.is_storing() {
            let (id, result) = self.command.clone();
            effects.push(Effect::Result { id, result });
        }
        effects
    }

    /// The session for a screen; `now_ns` is `CLOCK_MONOTONIC`.
    #[must_use]
    pub fn view(&self, now_ns: u64) -> SessionView {
        let initial_age_s = self
            .pending
            .as_ref()
            .filter(|frame| frame.trigger_time_ns > 0)
            .map(|frame| now_ns.saturating_sub(frame.trigger_time_ns) as f64 * 1e-9);
        let mut message = self.message.clone();
        if message.is_none()
            && initial_age_s.is_some_and(|age| age > self.limits.initial_warn_age_s)
        {
            message = Some(Message {
                level: MessageLevel::Warning,
                text: format!(
                    "the initial frame is {:.0} min old: take it again with i",
                    initial_age_s.unwrap_or(0.0) / 60.0
                ),
            });
        }
        SessionView {
            step: self.step(),
            object: self.labels.object.clone(),
            scene: self.labels.scene.clone(),
            operator: self.labels.operator.clone(),
            initial_at: self.pending.as_ref().map(|frame| frame.captured_at.clone()),
            initial_age_s,
            counts: self.counts(),
            last: self.last.clone(),
            undo: self.undo.last().map(Done::describe),
            redo: self.redo.last().map(Done::describe),
            message,
            refusal: self.refused.as_ref().map(|(stage, objections)| Refusal {
                stage: stage.name().into(),
                reasons: reasons(objections),
                can_override: can_override(objections),
            }),
            saving: self.in_flight.is_some(),
        }
    }

    fn counts(&self) -> Counts {
        let mut counts = Counts::default();
        let of = |object: &BTreeMap<Outcome, usize>, outcome| object.get(&outcome).copied();
        for object in self.counts.values() {
            counts.stable += of(object, Outcome::Stable).unwrap_or(0);
            counts.slip += of(object, Outcome::Slip).unwrap_or(0);
            counts.unlabelled += of(object, Outcome::Unlabelled).unwrap_or(0);
        }
        if let Some(here) = self.counts.get(&self.labels.object) {
            counts.object_stable = of(here, Outcome::Stable).unwrap_or(0);
            counts.object_slip = of(here, Outcome::Slip).unwrap_or(0);
        }
        counts
    }

    pub(crate) fn say(&mut self, level: MessageLevel, text: impl Into<String>) {
        self.message = Some(Message {
            level,
            text: text.into(),
        });
    }

    /// Refuses because there is nothing to do.
    pub(crate) fn nothing(&mut self, why: &str) -> Vec<Effect> {
        self.say(MessageLevel::Info, why);
        self.refuse(vec![why.to_owned()], false)
    }

    fn refuse(&mut self, reasons: Vec<String>, can_override: bool) -> Vec<Effect> {
        self.command.1 = CommandResult::Refused {
            reasons,
            can_override,
        };
        vec![Effect::Tone(Tone::Refused)]
    }

    pub(crate) fn store(&mut self, in_flight: InFlight, request: StoreRequest) -> Vec<Effect> {
        self.in_flight = Some(in_flight);
        vec![Effect::Store(request)]
    }

    /// The frame that is subtracted now.
    pub(crate) fn use_initial(&self) -> Effect {
        Effect::UseInitial(self.pending.as_ref().map(|frame| frame.id.clone()))
    }

    fn rename<T: fmt::Display>(
        &mut self,
        name: T,
        field: fn(&mut Labels) -> &mut T,
        what: &str,
    ) -> Vec<Effect> {
        self.say(MessageLevel::Info, format!("{what}: {name}"));
        *field(&mut self.labels) = name;
        Vec::new()
    }

    fn override_guards(
        &mut self,
        stage: Stage,
        objections: Vec<Objection>,
        now: Option<&Conditions>,
    ) -> Vec<Effect> {
        let Some(firm) = objections.iter().find(|o| !o.can_override) else {
            self.summary.overridden += 1;
            return self.capture(stage, now, true);
        };
        let text = format!("this cannot be overridden: {}", firm.reason);
        self.refused = Some((stage, objections));
        self.say(MessageLevel::Warning, text.as_str());
        self.refuse(vec![text], false)
    }

    fn capture(&mut self, stage: Stage, now: Option<&Conditions>, overriding: bool) -> Vec<Effect> {
        let Some(now) = now else {
            return self.nothing("the cameras were not looked at");
        };
        let mut objections = guard::check_frames(&self.limits, now, self.captured_ns);
        if stage == Stage::Grasp {
            match &self.pending {
                Some(initial) => {
                    objections.extend(guard::check_against_initial(&self.limits, now, initial))
                }
                None => objections.push(Objection {
                    guard: Guard::NoInitial,
                    reason: "there is no initial frame: open the gripper and take one".into(),
                    can_override: false,
                }),
            }
        }
        let can_override = can_override(&objections);
        if !can_override || (!objections.is_empty() && !overriding) {
            self.summary.refused += 1;
            let reasons = reasons(&objections);
            self.refused = Some((stage, objections));
            return self.refuse(reasons, can_override);
        }
        self.captured_ns = now.now_ns;
        let overridden = objections
            .into_iter()
            .map(|o| OverriddenGuard {
                guard: o.guard.name().into(),
                stage: stage.name().into(),
                reason: o.reason,
            })
            .collect();
        match &self.pending {
            Some(initial) if stage == Stage::Grasp => {
                let request = StoreRequest::SaveGrasp {
                    initial: initial.id.clone(),
                    labels: self.labels.clone(),
                    overridden,
                };
                self.store(InFlight::Grasp, request)
            }
            _ => self.store(InFlight::Initial, StoreRequest::SaveInitial { overridden }),
        }
    }

    fn initial_saved(&mut self, frame: PendingFrame) -> Vec<Effect> {
        self.summary.initials += 1;
        let id = frame.id.clone();
        let replaced = self.pending.replace(frame);
        let replaced_id = replaced.as_ref().map(|r| r.id.clone());
        self.record(Done::Initial { id, replaced });
        self.say(
            MessageLevel::Info,
            "initial frame saved: close the gripper, then trigger",
        );
        let mut effects = vec![self.use_initial(), Effect::Tone(Tone::InitialSaved)];
        if let Some(id) = replaced_id {
            effects.extend(self.store(
                InFlight::DiscardReplaced,
                StoreRequest::DiscardInitial { id },
            ));
        }
        effects
    }

    fn grasp_saved(&mut self, last: LastGrasp) -> Vec<Effect> {
        self.summary.saved += 1;
        self.count(&last.object, last.outcome, 1);
        let before = self.last.replace(last.clone());
        self.pending = None;
        self.say(
            MessageLevel::Info,
            format!("grasp {} saved: lift, then label it", last.id.short()),
        );
        self.record(Done::Grasp {
            last,
            before,
            reopened: None,
        });
        vec![self.use_initial(), Effect::Tone(Tone::GraspSaved)]
    }

    fn label(&mut self, outcome: Outcome) -> Vec<Effect> {
        let Some(last) = &self.last else {
            return self.nothing("there is no grasp to label yet");
        };
        if last.outcome == outcome {
            let text = format!("grasp {} is labelled {outcome} already", last.id.short());
            return self.nothing(&text);
        }
        self.set_outcome(last.id.clone(), outcome)
    }

    fn set_outcome(&mut self, id: GraspId, outcome: Outcome) -> Vec<Effect> {
        self.store(
            InFlight::Label(outcome),
            StoreRequest::SetOutcome { id, outcome },
        )
    }

    fn labelled(
        &mut self,
        id: GraspId,
        object: ObjectName,
        before: Outcome,
        outcome: Outcome,
    ) -> Vec<Effect> {
        self.relabel(&id, &object, before, outcome);
        self.summary.labelled += 1;
        self.say(
            MessageLevel::Info,
            format!("grasp {} labelled {outcome}", id.short()),
        );
        self.record(Done::Label {
            id,
            object,
            before,
            after: outcome,
        });
        vec![Effect::Tone(match outcome {
            Outcome::Stable => Tone::Stable,
            Outcome::Slip => Tone::Slip,
            Outcome::Unlabelled => Tone::Undone,
        })]
    }

    /// Brings memory in line with a label that was written.
    pub(crate) fn relabel(
        &mut self,
        id: &GraspId,
        object: &ObjectName,
        from: Outcome,
        to: Outcome,
    ) {
        if let Some(last) = self.last.as_mut().filter(|last| last.id == *id) {
            last.outcome = to;
        }
        self.count(object, from, -1);
        self.count(object, to, 1);
    }

    fn trashed(&mut self, grasp: LastGrasp) -> Vec<Effect> {
        let was_last = self.leave_out(&grasp);
        let id = grasp.id.short();
        self.say(
            MessageLevel::Info,
            format!("grasp {id} is in the trash; undo brings it back"),
        );
        self.record(Done::Trash { grasp, was_last });
        vec![Effect::Tone(Tone::Undone)]
    }

    fn restored(&mut self, grasp: LastGrasp) -> Vec<Effect> {
        self.count(&grasp.object, grasp.outcome, 1);
        let id = grasp.id.short();
        self.say(
            MessageLevel::Info,
            format!("grasp {id} is back from the trash"),
        );
        self.record(Done::Restore(grasp));
        vec![Effect::Tone(Tone::Undone)]
    }

    /// A grasp has gone to the trash; returns whether it was the newest of the session.
    pub(crate) fn leave_out(&mut self, grasp: &LastGrasp) -> bool {
        self.count(&grasp.object, grasp.outcome, -1);
        self.last.take_if(|last| last.id == grasp.id).is_some()
    }

    pub(crate) fn count(&mut self, object: &ObjectName, outcome: Outcome, by: isize) {
        let object = self.counts.entry(object.clone()).or_default();
        let n = object.entry(outcome).or_default();
        *n = n.saturating_add_signed(by);
    }

    fn store_failed(&mut self, in_flight: InFlight, message: &str) -> Vec<Effect> {
        self.summary.failed += 1;
        let what = match in_flight {
            InFlight::Initial => "the initial frame was NOT saved",
            InFlight::Grasp => "the grasp was NOT saved; its initial frame still is",
            InFlight::Label(_) => "the label was NOT saved",
            InFlight::Trash => "the grasp was NOT moved to the trash",
            InFlight::Restore => "the grasp was NOT taken back from the trash",
            InFlight::DiscardReplaced => "the initial frame before could not be moved to the trash",
            InFlight::Undo(done) => {
                self.undo.push(done);
                "undo failed"
            }
            InFlight::UndoRestore => "the initial frame before could not be brought back",
            InFlight::Redo(done) | InFlight::RedoRestore(done) => {
                self.redo.push(done);
                "redo failed"
            }
        };
        let error = format!("{what}: {message}");
        self.say(MessageLevel::Error, error.as_str());
        self.command.1 = CommandResult::Failed { error };
        vec![self.use_initial(), Effect::Tone(Tone::Fault)]
    }
}

fn can_override(objections: &[Objection]) -> bool {
    objections.iter().all(|o| o.can_override)
}

fn reasons(objections: &[Objection]) -> Vec<String> {
    objections.iter().map(|o| o.reason.clone()).collect()
}
