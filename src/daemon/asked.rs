//! Commands on their way to the engine, and what became of them.

use serde::Serialize;
use tokio::sync::oneshot;

use gripcast_session::{Command, CommandSource, Effect, SessionView, Tone};

/// A command for the engine.
#[derive(Debug)]
pub struct Asked {
    /// What is asked for.
    pub command: Command,
    /// Where it came from.
    pub source: CommandSource,
    /// Who wants to know what became of it.
    pub answer: Option<oneshot::Sender<Answered>>,
}

impl Asked {
    /// A command whose sender reads the outcome off the status.
    #[must_use]
    pub fn new(command: Command, source: CommandSource) -> Self {
        Self {
            command,
            source,
            answer: None,
        }
    }

    /// A command and the answer to it, which comes when all that it asked for is durable.
    #[must_use]
    pub fn with_answer(
        command: Command,
        source: CommandSource,
    ) -> (Self, oneshot::Receiver<Answered>) {
        let (answer, receiver) = oneshot::channel();
        let asked = Self {
            command,
            source,
            answer: Some(answer),
        };
        (asked, receiver)
    }
}

/// What became of a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Fate {
    /// Carried out; what it changed is durable.
    CarriedOut,
    /// Refused: by a guard, or because there was nothing to do.
    Refused,
    /// It failed on disk; nothing changed.
    Failed,
}

/// The answer to a command.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Answered {
    /// What became of it.
    pub fate: Fate,
    /// What the session said.
    pub message: Option<String>,
    /// Reasons of the guards that refused, one a guard.
    pub reasons: Vec<String>,
    /// Whether an override can help.
    pub can_override: bool,
}

impl Answered {
    /// The answer that follows from the last effects of a command and the session after it.
    pub(super) fn of(effects: &[Effect], view: &SessionView) -> Self {
        let sounded = |tone| effects.contains(&Effect::Tone(tone));
        let fate = if sounded(Tone::Fault) {
            Fate::Failed
        } else if sounded(Tone::Refused) {
            Fate::Refused
        } else {
            Fate::CarriedOut
        };
        let refusal = view.refusal.as_ref();
        Self {
            fate,
            message: view.message.as_ref().map(|message| message.text.clone()),
            reasons: refusal.map_or_else(Vec::new, |refusal| refusal.reasons.clone()),
            can_override: refusal.is_some_and(|refusal| refusal.can_override),
        }
    }

    /// Why it was not carried out, in one line.
    pub(super) fn complaint(&self) -> Option<String> {
        if self.fate == Fate::CarriedOut {
            return None;
        }
        let reasons = (!self.reasons.is_empty()).then(|| self.reasons.join("; "));
        Some(reasons.or_else(|| self.message.clone()).unwrap_or_default())
    }
}
