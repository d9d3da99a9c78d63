//! What the sender of a command saw, and whether the command still fits the session.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::Effect;
use super::command::{Command, CommandResult, CommandSource, Request};
use super::history::HistoryStep;
use super::machine::Session;
use super::view::{MessageLevel, SessionView, Step, Tone};
use gripcast_dataset::{GraspId, Outcome};

/// What the sender of a command saw. A command is refused where a given value differs from the
/// session's; values that are not given are not compared.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Seen {
    /// `revision` of the session.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub revision: Option<u64>,
    /// `step` of the session.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub step: Option<Step>,
    /// Id of the newest grasp, `last.id`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<String>)]
    pub grasp: Option<GraspId>,
    /// Outcome of the newest grasp, `last.outcome`. Not compared for a `relabel` of another grasp.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub outcome: Option<Outcome>,
    /// `undo` of the session: the step that undo reverts.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub undo: Option<String>,
    /// `redo` of the session: the step that redo repeats.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub redo: Option<String>,
}

/// The newest change of the session.
#[derive(Clone, Debug)]
pub(crate) struct Change {
    /// Time of its command, `CLOCK_MONOTONIC`, ns.
    at_ns: u64,
    /// What happened, for example `grasp 7f3a was saved`.
    text: String,
}

/// The newest command.
#[derive(Clone, Debug)]
pub(crate) struct CurrentCommand {
    /// Id of the request.
    pub(crate) id: u64,
    command: Command,
    /// Time at which it was handled, `CLOCK_MONOTONIC`, ns.
    at_ns: u64,
    /// Preliminary result.
    pub(crate) result: CommandResult,
    /// Whether it ended the refusal of a trigger.
    ended_refusal: bool,
}

impl CurrentCommand {
    /// Before the first command.
    pub(crate) fn none() -> Self {
        let request = Request::new(0, Command::Quit, CommandSource::Script);
        Self::new(&request, false)
    }

    /// Starts with the result `Accepted`.
    pub(crate) fn new(request: &Request, ended_refusal: bool) -> Self {
        Self {
            id: request.id,
            command: request.command.clone(),
            at_ns: request.now_ns,
            result: CommandResult::Accepted,
            ended_refusal,
        }
    }
}

impl Seen {
    /// What the sender of a command saw who shows `view`, as far as the command depends on it.
    #[must_use]
    pub fn of(view: &SessionView, command: &Command) -> Self {
        if command.names_its_target() {
            let is_label = matches!(command, Command::Relabel(..));
            let last = view.last.as_ref().filter(|_| is_label);
            return Self {
                outcome: last.map(|last| last.outcome),
                ..Self::default()
            };
        }
        Self {
            revision: Some(view.revision),
            undo: view.undo.clone().filter(|_| *command == Command::Undo),
            redo: view.redo.clone().filter(|_| *command == Command::Redo),
            ..Self::default()
        }
    }
}

impl Session {
    /// Continues the revisions of an earlier session: the first revision is `revision`.
    #[must_use]
    pub fn with_revision(mut self, revision: u64) -> Self {
        self.revision = revision;
        self
    }

    /// Refuses a command that no longer fits; the state stays as it is. A remote sender shows the
    /// reasons itself, all others have only the message.
    pub(crate) fn refuse_if_stale(&mut self, request: &Request) -> Option<Vec<Effect>> {
        let reasons = self.stale_reasons(request);
        if reasons.is_empty() {
            return None;
        }
        let mut effects = Vec::new();
        if request.source != CommandSource::Remote {
            let text = format!(
                "`{}` NOT carried out: {}",
                request.command,
                reasons.join("; ")
            );
            self.set_message(MessageLevel::Warning, text);
            effects.push(Effect::Tone(Tone::Refused));
        }
        effects.push(Effect::Result {
            id: request.id,
            result: CommandResult::Refused {
                reasons,
                can_override: false,
                stale: true,
            },
        });
        Some(effects)
    }

    /// Reasons why a command no longer fits: it is too old, or its sender saw another state.
    fn stale_reasons(&self, request: &Request) -> Vec<String> {
        let mut reasons = Vec::new();
        if self.differs(request) {
            reasons.push(self.describe_change(request.now_ns));
        }
        let (undo, redo) = (self.undo.last(), self.redo.last());
        for (verb, seen, step) in [
            ("undo", &request.seen.undo, undo),
            ("redo", &request.seen.redo, redo),
        ] {
            let found = step.map(HistoryStep::describe);
            if seen.is_some() && *seen != found {
                let seen = seen.as_deref().unwrap_or("nothing");
                let found = found.as_deref().unwrap_or("nothing");
                reasons.push(format!("{verb} would now change {found}, not {seen}"));
            }
        }
        let limit_ms = match request.command {
            Command::Quit => f64::INFINITY,
            _ if request.command.names_its_target() => self.limits.max_named_command_age_ms,
            _ => self.limits.max_command_age_ms,
        };
        if request.age_ms > limit_ms {
            reasons.push(format!(
                "this command is {} old; the limit is {}",
                seconds(request.age_ms),
                seconds(limit_ms)
            ));
        }
        reasons
    }

    /// Whether the sender saw another revision, step or newest grasp.
    fn differs(&self, request: &Request) -> bool {
        let seen = &request.seen;
        let last = self.last.as_ref();
        let labelled = match &request.command {
            Command::Relabel(id, _) => last.filter(|last| last.id == *id),
            _ => last,
        };
        let is_other_outcome = |outcome| labelled.is_some_and(|grasp| grasp.outcome != outcome);
        seen.revision
            .is_some_and(|revision| revision != self.revision)
            || seen.step.is_some_and(|step| step != self.step())
            || seen
                .grasp
                .as_ref()
                .is_some_and(|id| last.is_none_or(|last| last.id != *id))
            || seen.outcome.is_some_and(is_other_outcome)
    }

    /// The newest change and its age, for a sender that did not see it.
    fn describe_change(&self, now_ns: u64) -> String {
        let Some(Change { at_ns, text }) = &self.changed else {
            return "gripcast was restarted since; look at the step and press again".into();
        };
        let age_ms = now_ns.saturating_sub(*at_ns) as f64 * 1e-6;
        format!(
            "{text} {} ago; look at the step and press again",
            seconds(age_ms)
        )
    }

    /// Counts the end of the current command as a change unless it changed nothing.
    pub(crate) fn note_change(&mut self) {
        let current = &self.current;
        let text = match (&current.result, &current.command) {
            (CommandResult::Refused { .. }, _) if self.is_refused() => {
                "a trigger was refused".to_owned()
            }
            (CommandResult::Refused { .. }, _) if current.ended_refusal => {
                "the refused trigger was given up".to_owned()
            }
            (CommandResult::Refused { .. }, _) | (_, Command::Quit) => return,
            (CommandResult::Failed { .. }, command) => format!("`{command}` failed"),
            (_, Command::Object(name)) => format!("the object was set to {name}"),
            (_, Command::Scene(name)) => format!("the scene was set to {name}"),
            (_, Command::Operator(name)) => format!("the operator was set to {name}"),
            (_, Command::Undo) => match self.redo.last() {
                Some(step) => format!("{} was undone", step.describe()),
                None => "a step was undone".to_owned(),
            },
            (_, Command::Redo) => match self.undo.last() {
                Some(step) => format!("{} was redone", step.describe()),
                None => "a step was redone".to_owned(),
            },
            (_, command) => match self.undo.last() {
                Some(step) => step.describe_done(),
                None => format!("`{command}` was carried out"),
            },
        };
        let at_ns = current.at_ns;
        self.revision += 1;
        self.changed = Some(Change { at_ns, text });
    }
}

/// A duration, ms, as text in seconds.
fn seconds(ms: f64) -> String {
    let s = ms * 1e-3;
    let digits = usize::from(s < 9.95);
    format!("{s:.digits$} s")
}
