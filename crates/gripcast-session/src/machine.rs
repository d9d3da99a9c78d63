//! The state machine itself.

use std::collections::BTreeMap;
use std::fmt;

use serde::Serialize;

use super::Command;
use super::guard::{self, Conditions, Guard, GuardLimits, Objection};
use super::view::{
    Counts, LastGrasp, Message, MessageLevel, Predicted, Refusal, SessionView, Step, Tone,
};
use gripcast_base::files::{FileName, Label, ObjectName};
use gripcast_dataset::{GraspId, Outcome, OverriddenGuard};
use gripcast_imaging::Role;

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

/// An initial frame that waits for its grasp.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PendingFrame {
    /// Key of the grasp that it begins.
    pub id: GraspId,
    /// Wall clock, RFC 3339 UTC.
    pub captured_at: String,
    /// `CLOCK_MONOTONIC` of the trigger, ns; 0 when it was taken before this process started.
    pub trigger_time_ns: u64,
    /// Control values of each camera at that time.
    pub controls: BTreeMap<Role, BTreeMap<String, i64>>,
    /// The external camera's frame: its driver time, ns, and file.
    pub external: Option<(u64, FileName)>,
}

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
    /// End.
    Quit,
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
    Grasp {
        /// Its key.
        id: GraspId,
        /// Its object.
        object: ObjectName,
        /// Its outcome.
        outcome: Outcome,
        /// What was predicted before the lift.
        predicted: Option<Predicted>,
    },
    /// An outcome is durable.
    Labelled {
        /// The grasp's object.
        object: ObjectName,
        /// Its outcome before.
        before: Outcome,
    },
    /// A grasp is in the trash.
    Trashed {
        /// Its object.
        object: ObjectName,
        /// Its outcome.
        outcome: Outcome,
    },
    /// Done; nothing to tell.
    Done,
    /// Nothing changed on disk.
    Failed {
        /// Why, and how to mend it.
        message: String,
    },
}

/// A step that can be taken back.
#[derive(Clone, Debug, PartialEq)]
enum Done {
    Initial {
        id: GraspId,
        replaced: Option<PendingFrame>,
    },
    Grasp {
        last: LastGrasp,
        before: Option<LastGrasp>,
        /// Pending frame that an undo made from the grasp's initial frame.
        reopened: Option<GraspId>,
    },
    Label {
        id: GraspId,
        object: ObjectName,
        before: Outcome,
        after: Outcome,
    },
    Trash {
        id: GraspId,
        object: ObjectName,
        outcome: Outcome,
        /// The newest grasp of the session, if it is this one.
        was_last: Option<LastGrasp>,
    },
    Restore {
        id: GraspId,
        object: ObjectName,
        outcome: Outcome,
    },
}

/// What the request under way is for.
#[derive(Clone, Debug)]
enum InFlight {
    Initial,
    DiscardReplaced,
    Grasp,
    Label {
        id: GraspId,
        outcome: Outcome,
    },
    Trash {
        id: GraspId,
    },
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
    pending: Option<PendingFrame>,
    last: Option<LastGrasp>,
    undo: Vec<Done>,
    redo: Vec<Done>,
    in_flight: Option<InFlight>,
    refused: Option<(Command, Vec<Objection>)>,
    message: Option<Message>,
    summary: Summary,
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

    /// Takes a command. Must not be called while [`Session::is_storing`].
    pub fn handle(&mut self, command: Command, now: &Conditions) -> Vec<Effect> {
        let refused = self.refused.take();
        self.message = None;
        match command {
            Command::Override => match refused {
                Some((command, objections)) if objections.iter().all(|o| o.can_override) => {
                    self.summary.overridden += 1;
                    self.capture(command, now, true)
                }
                Some((command, objections)) => {
                    let reason = objections
                        .iter()
                        .find(|o| !o.can_override)
                        .map_or_else(String::new, |o| o.reason.clone());
                    self.refused = Some((command, objections));
                    self.say(
                        MessageLevel::Warning,
                        format!("this cannot be overridden: {reason}"),
                    );
                    vec![Effect::Tone(Tone::Refused)]
                }
                None => self.nothing("there is nothing to override"),
            },
            Command::Trigger => match self.step() {
                Step::Initial => self.capture(Command::Initial, now, false),
                Step::Grasp => self.capture(Command::Grasp, now, false),
                Step::Label => self.nothing("lift, then label the grasp: s stable, f slip"),
            },
            Command::Initial | Command::Grasp => self.capture(command, now, false),
            Command::Label(outcome) => self.label(outcome),
            Command::Relabel(id, outcome) => self.store(
                InFlight::Label {
                    id: id.clone(),
                    outcome,
                },
                StoreRequest::SetOutcome { id, outcome },
            ),
            Command::Trash(id) => self.store(
                InFlight::Trash { id: id.clone() },
                StoreRequest::TrashGrasp { id },
            ),
            Command::Restore(id) => {
                self.store(InFlight::Restore, StoreRequest::RestoreGrasp { id })
            }
            Command::Undo => self.undo(),
            Command::Redo => self.redo(),
            Command::Object(name) => self.rename(name, |labels| &mut labels.object, "object"),
            Command::Scene(name) => self.rename(name, |labels| &mut labels.scene, "scene"),
            Command::Operator(name) => self.rename(name, |labels| &mut labels.operator, "operator"),
            Command::Quit => vec![Effect::Quit],
        }
    }

    /// Takes the answer to the request under way.
    pub fn completed(&mut self, reply: StoreReply) -> Vec<Effect> {
        let Some(in_flight) = self.in_flight.take() else {
            return Vec::new();
        };
        if let StoreReply::Failed { message } = reply {
            return self.store_failed(in_flight, message);
        }
        match (in_flight, reply) {
            (InFlight::Initial, StoreReply::Initial(frame)) => self.initial_saved(frame),
            (
                InFlight::Grasp,
                StoreReply::Grasp {
                    id,
                    object,
                    outcome,
                    predicted,
                },
            ) => self.grasp_saved(LastGrasp {
                id,
                object,
                outcome,
                predicted,
            }),
            (InFlight::Label { id, outcome }, StoreReply::Labelled { object, before }) => {
                self.labelled(id, object, before, outcome)
            }
            (InFlight::Trash { id }, StoreReply::Trashed { object, outcome }) => {
                self.trashed(id, object, outcome)
            }
            (
                InFlight::Restore,
                StoreReply::Grasp {
                    id,
                    object,
                    outcome,
                    ..
                },
            ) => self.restored(id, object, outcome),
            (InFlight::Undo(done), reply) => self.undone(done, reply),
            (InFlight::Redo(done), reply) => self.redone(done, reply),
            (InFlight::UndoRestore, StoreReply::Initial(frame)) => {
                self.pending = Some(frame);
                self.finish_undo("the initial frame before is back")
            }
            (InFlight::RedoRestore(done), _) => {
                let Done::Initial { ref id, .. } = done else {
                    return Vec::new();
                };
                let id = id.clone();
                self.store(InFlight::Redo(done), StoreRequest::RestoreInitial { id })
            }
            (InFlight::DiscardReplaced, _) | (_, _) => Vec::new(),
        }
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
            undo: self.undo.last().map(describe),
            redo: self.redo.last().map(describe),
            message,
            refusal: self.refused.as_ref().map(|(command, objections)| Refusal {
                stage: command.to_string(),
                reasons: objections.iter().map(|o| o.reason.clone()).collect(),
                can_override: objections.iter().all(|o| o.can_override),
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

    fn say(&mut self, level: MessageLevel, text: impl Into<String>) {
        self.message = Some(Message {
            level,
            text: text.into(),
        });
    }

    fn nothing(&mut self, why: &str) -> Vec<Effect> {
        self.say(MessageLevel::Info, why);
        vec![Effect::Tone(Tone::Refused)]
    }

    fn store(&mut self, in_flight: InFlight, request: StoreRequest) -> Vec<Effect> {
        self.in_flight = Some(in_flight);
        vec![Effect::Store(request)]
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

    fn capture(&mut self, command: Command, now: &Conditions, overriding: bool) -> Vec<Effect> {
        let grasp = command == Command::Grasp;
        let mut objections = guard::check_frames(&self.limits, now, self.captured_ns);
        if grasp {
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
        let blocked = objections.iter().any(|o| !o.can_override);
        if blocked || (!objections.is_empty() && !overriding) {
            self.summary.refused += 1;
            self.refused = Some((command, objections));
            return vec![Effect::Tone(Tone::Refused)];
        }
        self.captured_ns = now.now_ns;
        let stage = if grasp { "grasp" } else { "initial" };
        let overridden = objections
            .into_iter()
            .map(|o| OverriddenGuard {
                guard: o.guard.name().into(),
                stage: stage.into(),
                reason: o.reason,
            })
            .collect();
        match &self.pending {
            Some(initial) if grasp => {
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
        let replaced = self.pending.replace(frame.clone());
        let replaced_id = replaced.as_ref().map(|r| r.id.clone());
        self.undo.push(Done::Initial {
            id: frame.id.clone(),
            replaced,
        });
        self.redo.clear();
        self.say(
            MessageLevel::Info,
            "initial frame saved: close the gripper, then trigger",
        );
        let mut effects = vec![
            Effect::UseInitial(Some(frame.id)),
            Effect::Tone(Tone::InitialSaved),
        ];
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
        self.undo.push(Done::Grasp {
            last,
            before,
            reopened: None,
        });
        self.redo.clear();
        vec![Effect::UseInitial(None), Effect::Tone(Tone::GraspSaved)]
    }

    fn label(&mut self, outcome: Outcome) -> Vec<Effect> {
        let Some(last) = &self.last else {
            return self.nothing("there is no grasp to label yet");
        };
        if last.outcome == outcome {
            let text = format!("grasp {} is labelled {outcome} already", last.id.short());
            return self.nothing(&text);
        }
        let id = last.id.clone();
        self.store(
            InFlight::Label {
                id: id.clone(),
                outcome,
            },
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
        self.undo.push(Done::Label {
            id,
            object,
            before,
            after: outcome,
        });
        self.redo.clear();
        vec![Effect::Tone(match outcome {
            Outcome::Stable => Tone::Stable,
            Outcome::Slip => Tone::Slip,
            Outcome::Unlabelled => Tone::Undone,
        })]
    }

    /// Brings memory in line with a label that was written.
    fn relabel(&mut self, id: &GraspId, object: &ObjectName, from: Outcome, to: Outcome) {
        if let Some(last) = self.last.as_mut().filter(|last| last.id == *id) {
            last.outcome = to;
        }
        self.count(object, from, -1);
        self.count(object, to, 1);
    }

    fn trashed(&mut self, id: GraspId, object: ObjectName, outcome: Outcome) -> Vec<Effect> {
        let was_last = self.leave_out(&id, &object, outcome);
        self.say(
            MessageLevel::Info,
            format!("grasp {} is in the trash; undo brings it back", id.short()),
        );
        self.undo.push(Done::Trash {
            id,
            object,
            outcome,
            was_last,
        });
        self.redo.clear();
        vec![Effect::Tone(Tone::Undone)]
    }

    fn restored(&mut self, id: GraspId, object: ObjectName, outcome: Outcome) -> Vec<Effect> {
        self.count(&object, outcome, 1);
        self.say(
            MessageLevel::Info,
            format!("grasp {} is back from the trash", id.short()),
        );
        self.undo.push(Done::Restore {
            id,
            object,
            outcome,
        });
        self.redo.clear();
        vec![Effect::Tone(Tone::Undone)]
    }

    /// A grasp has gone to the trash; returns it if it was the newest of the session.
    fn leave_out(
        &mut self,
        id: &GraspId,
        object: &ObjectName,
        outcome: Outcome,
    ) -> Option<LastGrasp> {
        self.count(object, outcome, -1);
        self.last.take_if(|last| last.id == *id)
    }

    fn count(&mut self, object: &ObjectName, outcome: Outcome, by: isize) {
        let object = self.counts.entry(object.clone()).or_default();
        let n = object.entry(outcome).or_default();
        *n = n.saturating_add_signed(by);
    }

    fn undo(&mut self) -> Vec<Effect> {
        let Some(done) = self.undo.pop() else {
            return self.nothing("nothing to undo");
        };
        let request = match &done {
            Done::Initial { id, .. } => StoreRequest::DiscardInitial { id: id.clone() },
            Done::Grasp { last, .. } => StoreRequest::UndoGrasp {
                id: last.id.clone(),
            },
            Done::Label { id, before, .. } => StoreRequest::SetOutcome {
                id: id.clone(),
                outcome: *before,
            },
            Done::Trash { id, .. } => StoreRequest::RestoreGrasp { id: id.clone() },
            Done::Restore { id, .. } => StoreRequest::TrashGrasp { id: id.clone() },
        };
        self.store(InFlight::Undo(done), request)
    }

    fn undone(&mut self, done: Done, reply: StoreReply) -> Vec<Effect> {
        match done {
            Done::Initial { id, replaced } => {
                self.pending = None;
                let earlier = replaced.as_ref().map(|r| r.id.clone());
                self.redo.push(Done::Initial { id, replaced });
                match earlier {
                    Some(id) => {
                        self.store(InFlight::UndoRestore, StoreRequest::RestoreInitial { id })
                    }
                    None => self.finish_undo("initial frame taken back"),
                }
            }
            Done::Grasp { last, before, .. } => {
                let StoreReply::Initial(frame) = reply else {
                    return Vec::new();
                };
                self.rename_initial(&last.id, &frame.id);
                self.count(&last.object, last.outcome, -1);
                self.last = before.clone();
                let text = format!("grasp {} taken back", last.id.short());
                self.redo.push(Done::Grasp {
                    last,
                    before,
                    reopened: Some(frame.id.clone()),
                });
                self.pending = Some(frame);
                self.finish_undo(&text)
            }
            Done::Label {
                id,
                object,
                before,
                after,
            } => {
                self.relabel(&id, &object, after, before);
                let text = format!("grasp {} is {before} again", id.short());
                self.redo.push(Done::Label {
                    id,
                    object,
                    before,
                    after,
                });
                self.finish_undo(&text)
            }
            Done::Trash {
                ref id,
                ref object,
                outcome,
                ref was_last,
            } => {
                self.count(object, outcome, 1);
                self.last = was_last.clone().or_else(|| self.last.take());
                let text = format!("grasp {} is back from the trash", id.short());
                self.redo.push(done);
                self.finish_undo(&text)
            }
            Done::Restore {
                ref id,
                ref object,
                outcome,
            } => {
                self.leave_out(id, object, outcome);
                let text = format!("grasp {} is in the trash again", id.short());
                self.redo.push(done);
                self.finish_undo(&text)
            }
        }
    }

    /// An undone grasp's initial frame is pending under a new key: the step that took the frame
    /// has to name it, or it could not be taken back itself.
    fn rename_initial(&mut self, from: &GraspId, to: &GraspId) {
        for done in &mut self.undo {
            if let Done::Initial { id, .. } = done
                && id == from
            {
                id.clone_from(to);
            }
        }
    }

    fn finish_undo(&mut self, text: &str) -> Vec<Effect> {
        self.summary.undone += 1;
        self.say(MessageLevel::Info, text);
        vec![
            Effect::UseInitial(self.pending.as_ref().map(|frame| frame.id.clone())),
            Effect::Tone(Tone::Undone),
        ]
    }

    fn redo(&mut self) -> Vec<Effect> {
        let Some(done) = self.redo.pop() else {
            return self.nothing("nothing to redo");
        };
        match &done {
            Done::Initial { id, replaced } => match replaced {
                Some(earlier) => {
                    let request = StoreRequest::DiscardInitial {
                        id: earlier.id.clone(),
                    };
                    self.store(InFlight::RedoRestore(done), request)
                }
                None => {
                    let request = StoreRequest::RestoreInitial { id: id.clone() };
                    self.store(InFlight::Redo(done), request)
                }
            },
            Done::Grasp { last, reopened, .. } => {
                let request = StoreRequest::RedoGrasp {
                    id: last.id.clone(),
                    reopened: reopened.clone(),
                };
                self.store(InFlight::Redo(done), request)
            }
            Done::Label { id, after, .. } => {
                let request = StoreRequest::SetOutcome {
                    id: id.clone(),
                    outcome: *after,
                };
                self.store(InFlight::Redo(done), request)
            }
            Done::Trash { id, .. } => {
                let request = StoreRequest::TrashGrasp { id: id.clone() };
                self.store(InFlight::Redo(done), request)
            }
            Done::Restore { id, .. } => {
                let request = StoreRequest::RestoreGrasp { id: id.clone() };
                self.store(InFlight::Redo(done), request)
            }
        }
    }

    fn redone(&mut self, done: Done, reply: StoreReply) -> Vec<Effect> {
        match (&done, reply) {
            (Done::Initial { .. }, StoreReply::Initial(frame)) => self.pending = Some(frame),
            (Done::Grasp { last, reopened, .. }, _) => {
                if let Some(reopened) = reopened {
                    self.rename_initial(reopened, &last.id);
                }
                self.count(&last.object, last.outcome, 1);
                self.last = Some(last.clone());
                self.pending = None;
            }
            (
                Done::Label {
                    id,
                    object,
                    before,
                    after,
                },
                _,
            ) => self.relabel(id, object, *before, *after),
            (
                Done::Trash {
                    id,
                    object,
                    outcome,
                    ..
                },
                _,
            ) => {
                self.leave_out(id, object, *outcome);
            }
            (
                Done::Restore {
                    object, outcome, ..
                },
                _,
            ) => self.count(object, *outcome, 1),
            (Done::Initial { .. }, _) => return Vec::new(),
        }
        self.summary.redone += 1;
        self.say(
            MessageLevel::Info,
            format!("done again: {}", describe(&done)),
        );
        self.undo.push(done);
        vec![
            Effect::UseInitial(self.pending.as_ref().map(|frame| frame.id.clone())),
            Effect::Tone(Tone::Undone),
        ]
    }

    fn store_failed(&mut self, in_flight: InFlight, message: String) -> Vec<Effect> {
        self.summary.failed += 1;
        let what = match in_flight {
            InFlight::Initial => "the initial frame was NOT saved",
            InFlight::Grasp => "the grasp was NOT saved; its initial frame still is",
            InFlight::Label { .. } => "the label was NOT saved",
            InFlight::Trash { .. } => "the grasp was NOT moved to the trash",
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
        self.say(MessageLevel::Error, format!("{what}: {message}"));
        vec![
            Effect::UseInitial(self.pending.as_ref().map(|frame| frame.id.clone())),
            Effect::Tone(Tone::Fault),
        ]
    }
}

fn describe(done: &Done) -> String {
    match done {
        Done::Initial { .. } => "initial frame".into(),
        Done::Grasp { last, .. } => format!("grasp {}", last.id.short()),
        Done::Label { id, after, .. } => format!("label {after} of {}", id.short()),
        Done::Trash { id, .. } => format!("trash of {}", id.short()),
        Done::Restore { id, .. } => format!("return of {}", id.short()),
    }
}
