//! The state machine of the session. One file, because all transitions share the state.

use std::collections::BTreeMap;
use std::fmt;

use serde::Serialize;

use super::command::{Command, CommandResult, Request};
use super::guard::{self, Conditions, Guard, GuardLimits, GuardViolation};
use super::history::HistoryStep;
use super::pending::PendingFrame;
use super::seen::{Change, CurrentCommand};
use super::store::{Labels, StoreReply, StoreRequest};
use super::view::{Counts, LastGrasp, Message, MessageLevel, Refusal, SessionView, Step, Tone};
use gripcast_base::files::ObjectName;
use gripcast_dataset::{GraspId, NameChange, Outcome, OverriddenGuard, Stage};

/// Number of grasps by object and outcome.
pub type OutcomeCounts = BTreeMap<ObjectName, BTreeMap<Outcome, usize>>;

/// An action for the engine.
#[derive(Clone, Debug, PartialEq)]
pub enum Effect {
    /// Change the dataset; the engine replies with [`Session::completed`].
    Store(StoreRequest),
    /// Play a sound.
    Tone(Tone),
    /// Use this initial frame for tactile differences; `None` for no frame.
    UseInitial(Option<GraspId>),
    /// Final result of a command.
    Result {
        /// Id of the request.
        id: u64,
        /// Its result.
        result: CommandResult,
    },
    /// End the session.
    Quit,
}

/// Purpose of the store request in progress.
#[derive(Clone, Debug)]
pub(crate) enum InFlight {
    Initial,
    DiscardReplaced,
    Grasp,
    Label(Outcome),
    Names(NameChange),
    Trash,
    Restore,
    Undo(HistoryStep),
    Redo(HistoryStep),
    /// Second half of undoing a retaken initial frame: restores the previous one.
    UndoRestore,
    /// First half of redoing a retaken initial frame: discards the previous one.
    RedoRestore(HistoryStep),
}

/// The collection session; see the crate documentation.
#[derive(Debug)]
pub struct Session {
    pub(crate) limits: GuardLimits,
    labels: Labels,
    counts: OutcomeCounts,
    pub(crate) pending: Option<PendingFrame>,
    pub(crate) last: Option<LastGrasp>,
    pub(crate) undo: Vec<HistoryStep>,
    pub(crate) redo: Vec<HistoryStep>,
    in_flight: Option<InFlight>,
    pub(crate) current: CurrentCommand,
    /// Number of the state.
    pub(crate) revision: u64,
    pub(crate) changed: Option<Change>,
    /// The refused trigger with its guard violations.
    refused: Option<(Stage, Vec<GuardViolation>)>,
    message: Option<Message>,
    pub(crate) summary: Summary,
    /// Time of the last capture, ns; 0 before the first.
    captured_ns: u64,
}

/// Statistics of the session.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Summary {
    /// Number of saved initial frames.
    pub initials: u64,
    /// Number of saved grasps.
    pub saved: u64,
    /// Number of labels.
    pub labelled: u64,
    /// Number of triggers refused by guards.
    pub refused: u64,
    /// Number of overridden refusals.
    pub overridden: u64,
    /// Number of undone steps.
    pub undone: u64,
    /// Number of redone steps.
    pub redone: u64,
    /// Number of failed store requests.
    pub failed: u64,
}

impl Session {
    /// Starts a session on a dataset with `counts` grasps and possibly a pending initial frame.
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
                "resuming with the initial frame of {}; press i to retake it",
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
            current: CurrentCommand::none(),
            revision: 0,
            changed: None,
            refused: None,
            message,
            summary: Summary::default(),
            captured_ns: 0,
        }
    }

    /// Changes the limits of the guards.
    pub fn set_limits(&mut self, limits: GuardLimits) {
        self.limits = limits;
    }

    /// Whether a store request is in progress; commands must wait for its reply.
    #[must_use]
    pub fn is_storing(&self) -> bool {
        self.in_flight.is_some()
    }

    /// Statistics so far.
    #[must_use]
    pub fn summary(&self) -> Summary {
        self.summary
    }

    /// The pending initial frame.
    #[must_use]
    pub fn pending(&self) -> Option<&PendingFrame> {
        self.pending.as_ref()
    }

    /// Time of the last capture, `CLOCK_MONOTONIC`, ns; only newer frames can be captured.
    #[must_use]
    pub fn captured_ns(&self) -> u64 {
        self.captured_ns
    }

    /// Object, scene and operator of the next grasp.
    #[must_use]
    pub fn labels(&self) -> &Labels {
        &self.labels
    }

    /// Next step of the cycle.
    #[must_use]
    pub fn step(&self) -> Step {
        match (&self.pending, &self.last) {
            (Some(_), _) => Step::Grasp,
            (None, Some(last)) if last.outcome == Outcome::Unlabelled => Step::Label,
            (None, _) => Step::Initial,
        }
    }

    /// Whether the last command was a refused trigger.
    #[must_use]
    pub fn is_refused(&self) -> bool {
        self.refused.is_some()
    }

    /// Whether a command would capture frames now; only these need the camera conditions.
    #[must_use]
    pub fn is_trigger(&self, command: &Command) -> bool {
        match command {
            Command::Initial | Command::Grasp => true,
            Command::Trigger => self.step() != Step::Label,
            Command::Override => self
                .refused
                .as_ref()
                .is_some_and(|(_, violations)| can_override(violations)),
            _ => false,
        }
    }

    /// Handles a command; `now` are the camera conditions, for a [trigger](Self::is_trigger). Must
    /// not be called while [`Session::is_storing`].
    pub fn handle(&mut self, request: Request, now: Option<&Conditions>) -> Vec<Effect> {
        if let Some(effects) = self.refuse_if_stale(&request) {
            return effects;
        }
        let refused = self.refused.take();
        self.current = CurrentCommand::new(&request, refused.is_some());
        self.message = None;
        let effects = match request.command {
            Command::Override => match refused {
                Some((stage, violations)) => self.override_guards(stage, violations, now),
                None => self.refuse_with("nothing to override"),
            },
            Command::Trigger => match self.step() {
                Step::Initial => self.capture(Stage::Initial, now, false),
                Step::Grasp => self.capture(Stage::Grasp, now, false),
                Step::Label => self.refuse_with("lift, then label the grasp: s stable, f slip"),
            },
            Command::Initial => self.capture(Stage::Initial, now, false),
            Command::Grasp => self.capture(Stage::Grasp, now, false),
            Command::Label(outcome) => self.label(outcome),
            Command::Relabel(id, outcome) => self.set_outcome(id, outcome),
            Command::EditLast(names) => match &self.last {
                Some(last) => self.edit(last.id.clone(), names),
                None => self.refuse_with("no grasp to edit yet"),
            },
            Command::Edit(id, names) => self.edit(id, names),
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
        self.with_result(effects)
    }

    /// Handles the reply to the store request.
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
            (InFlight::Names(names), reply) => self.names_changed(names, &reply),
            (InFlight::Trash, StoreReply::Trashed(grasp)) => self.trashed(grasp),
            (InFlight::Restore, StoreReply::Grasp(grasp)) => self.restored(grasp),
            (InFlight::Undo(step), reply) => self.undone(step, reply),
            (InFlight::Redo(step), reply) => self.redone(step, reply),
            (InFlight::UndoRestore, StoreReply::Initial(frame)) => {
                self.pending = Some(frame);
                self.finish_undo("previous initial frame restored")
            }
            (InFlight::RedoRestore(step), _) => self.redo_restore(step),
            _ => Vec::new(),
        };
        self.with_result(effects)
    }

    /// Adds the command's result unless a store request is in progress.
    fn with_result(&mut self, mut effects: Vec<Effect>) -> Vec<Effect> {
        if !self.is_storing() {
            self.note_change();
            let (id, result) = (self.current.id, self.current.result.clone());
            effects.push(Effect::Result { id, result });
        }
        effects
    }

    /// State of the session for a screen; `now_ns` is `CLOCK_MONOTONIC`.
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
                    "the initial frame is {:.0} min old: press i to retake it",
                    initial_age_s.unwrap_or(0.0) / 60.0
                ),
            });
        }
        SessionView {
            revision: self.revision,
            step: self.step(),
            object: self.labels.object.clone(),
            scene: self.labels.scene.clone(),
            operator: self.labels.operator.clone(),
            initial_at: self.pending.as_ref().map(|frame| frame.captured_at.clone()),
            initial_age_s,
            counts: self.counts(),
            last: self.last.clone(),
            undo: self.undo.last().map(HistoryStep::describe),
            redo: self.redo.last().map(HistoryStep::describe),
            message,
            refusal: self.refused.as_ref().map(|(stage, violations)| Refusal {
                stage: stage.name().into(),
                reasons: reasons(violations),
                can_override: can_override(violations),
            }),
            saving: self.in_flight.is_some(),
        }
    }

    /// Returns the number of grasps by object and outcome.
    #[must_use]
    pub fn outcome_counts(&self) -> &OutcomeCounts {
        &self.counts
    }

    fn counts(&self) -> Counts {
        let mut counts = Counts::default();
        let count = |object: &BTreeMap<Outcome, usize>, outcome| object.get(&outcome).copied();
        for object in self.counts.values() {
            counts.stable += count(object, Outcome::Stable).unwrap_or(0);
            counts.slip += count(object, Outcome::Slip).unwrap_or(0);
            counts.unlabelled += count(object, Outcome::Unlabelled).unwrap_or(0);
        }
        if let Some(current) = self.counts.get(&self.labels.object) {
            counts.object_stable = count(current, Outcome::Stable).unwrap_or(0);
            counts.object_slip = count(current, Outcome::Slip).unwrap_or(0);
        }
        counts
    }

    pub(crate) fn set_message(&mut self, level: MessageLevel, text: impl Into<String>) {
        self.message = Some(Message {
            level,
            text: text.into(),
        });
    }

    /// Refuses a command with a reason that is also shown as a message.
    pub(crate) fn refuse_with(&mut self, reason: &str) -> Vec<Effect> {
        self.set_message(MessageLevel::Info, reason);
        self.refuse(vec![reason.to_owned()], false)
    }

    fn refuse(&mut self, reasons: Vec<String>, can_override: bool) -> Vec<Effect> {
        self.current.result = CommandResult::Refused {
            reasons,
            can_override,
            stale: false,
        };
        vec![Effect::Tone(Tone::Refused)]
    }

    pub(crate) fn store(&mut self, in_flight: InFlight, request: StoreRequest) -> Vec<Effect> {
        self.in_flight = Some(in_flight);
        vec![Effect::Store(request)]
    }

    /// Effect that sets the current initial frame.
    pub(crate) fn use_initial(&self) -> Effect {
        Effect::UseInitial(self.pending.as_ref().map(|frame| frame.id.clone()))
    }

    fn rename<T: fmt::Display>(
        &mut self,
        name: T,
        field: fn(&mut Labels) -> &mut T,
        what: &str,
    ) -> Vec<Effect> {
        self.set_message(MessageLevel::Info, format!("{what}: {name}"));
        *field(&mut self.labels) = name;
        Vec::new()
    }

    fn override_guards(
        &mut self,
        stage: Stage,
        violations: Vec<GuardViolation>,
        now: Option<&Conditions>,
    ) -> Vec<Effect> {
        let Some(violation) = violations.iter().find(|o| !o.can_override) else {
            self.summary.overridden += 1;
            return self.capture(stage, now, true);
        };
        let text = format!("cannot be overridden: {}", violation.reason);
        self.refused = Some((stage, violations));
        self.set_message(MessageLevel::Warning, text.as_str());
        self.refuse(vec![text], false)
    }

    fn capture(&mut self, stage: Stage, now: Option<&Conditions>, overriding: bool) -> Vec<Effect> {
        let Some(now) = now else {
            return self.refuse_with("camera conditions unavailable");
        };
        let mut violations = guard::check_frames(&self.limits, now, self.captured_ns);
        violations.extend(guard::check_gels(now, stage == Stage::Initial));
        match (stage, &self.pending) {
            (Stage::Initial, _) => violations.extend(guard::check_open(&self.limits, now)),
            (Stage::Grasp, Some(initial)) => {
                violations.extend(guard::check_against_initial(&self.limits, now, initial));
            }
            (Stage::Grasp, None) => violations.push(GuardViolation {
                guard: Guard::NoInitial,
                reason: "no initial frame: open the gripper and take one".into(),
                can_override: false,
            }),
        }
        // What cannot be overridden is the reason; the rest would not help.
        violations.sort_by_key(|violation| violation.can_override);
        let can_override = can_override(&violations);
        if !can_override || (!violations.is_empty() && !overriding) {
            self.summary.refused += 1;
            let reasons = reasons(&violations);
            self.refused = Some((stage, violations));
            return self.refuse(reasons, can_override);
        }
        self.captured_ns = now.now_ns;
        let overridden = violations
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
        self.record(HistoryStep::Initial { id, replaced });
        self.set_message(MessageLevel::Info, "initial frame saved: close the gripper");
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
        let before = self.last.replace(last.clone()).map(Box::new);
        self.pending = None;
        self.set_message(
            MessageLevel::Info,
            format!("grasp {} saved: lift, then label it", last.id.short()),
        );
        self.record(HistoryStep::Grasp {
            last,
            before,
            reopened: None,
        });
        vec![self.use_initial(), Effect::Tone(Tone::GraspSaved)]
    }

    fn label(&mut self, outcome: Outcome) -> Vec<Effect> {
        match &self.last {
            Some(last) => self.set_outcome(last.id.clone(), outcome),
            None => self.refuse_with("no grasp to label yet"),
        }
    }

    fn set_outcome(&mut self, id: GraspId, outcome: Outcome) -> Vec<Effect> {
        let newest = self.last.as_ref().filter(|last| last.id == id);
        if newest.is_some_and(|newest| newest.outcome == outcome) {
            let text = format!("grasp {} is already labelled {outcome}", id.short());
            return self.refuse_with(&text);
        }
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
        self.set_message(
            MessageLevel::Info,
            format!("grasp {} labelled {outcome}", id.short()),
        );
        self.record(HistoryStep::Label {
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

    /// Updates the state after a label was stored.
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
        let was_last = self.remove_grasp(&grasp);
        let id = grasp.id.short();
        self.set_message(
            MessageLevel::Info,
            format!("grasp {id} moved to the trash; undo restores it"),
        );
        self.record(HistoryStep::Trash { grasp, was_last });
        vec![Effect::Tone(Tone::Undone)]
    }

    fn restored(&mut self, grasp: LastGrasp) -> Vec<Effect> {
        self.count(&grasp.object, grasp.outcome, 1);
        let id = grasp.id.short();
        self.set_message(
            MessageLevel::Info,
            format!("grasp {id} restored from the trash"),
        );
        self.record(HistoryStep::Restore(grasp));
        vec![Effect::Tone(Tone::Undone)]
    }

    /// Removes a trashed grasp; returns whether it was the newest of the session.
    pub(crate) fn remove_grasp(&mut self, grasp: &LastGrasp) -> bool {
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
            InFlight::Grasp => "the grasp was NOT saved; its initial frame is kept",
            InFlight::Label(_) => "the label was NOT saved",
            InFlight::Names(_) => "the names were NOT changed",
            InFlight::Trash => "the grasp was NOT moved to the trash",
            InFlight::Restore => "the grasp was NOT restored from the trash",
            InFlight::DiscardReplaced => {
                "the previous initial frame could not be moved to the trash"
            }
            InFlight::Undo(step) => {
                self.undo.push(step);
                "undo failed"
            }
            InFlight::UndoRestore => "the previous initial frame could not be restored",
            InFlight::Redo(step) | InFlight::RedoRestore(step) => {
                self.redo.push(step);
                "redo failed"
            }
        };
        let error = format!("{what}: {message}");
        self.set_message(MessageLevel::Error, error.as_str());
        self.current.result = CommandResult::Failed { error };
        vec![self.use_initial(), Effect::Tone(Tone::Fault)]
    }
}

fn can_override(violations: &[GuardViolation]) -> bool {
    violations.iter().all(|o| o.can_override)
}

fn reasons(violations: &[GuardViolation]) -> Vec<String> {
    violations.iter().map(|o| o.reason.clone()).collect()
}
