//! Commands of the operator, from any source.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::seen::Seen;
use gripcast_base::error::Error;
use gripcast_base::files::{Label, ObjectName};
use gripcast_dataset::{GraspId, NameChange, Outcome};

/// A session command from keyboard, pedal, script or API.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Command {
    /// Next step of the cycle: initial, then grasp. Refused while a label is pending.
    Trigger,
    /// Take the initial frame (again).
    Initial,
    /// Take the grasp frame.
    Grasp,
    /// Label the last grasp.
    Label(Outcome),
    /// Label any grasp of the dataset.
    Relabel(GraspId, Outcome),
    /// Change object, scene or operator of any grasp of the dataset.
    Edit(GraspId, NameChange),
    /// Change object, scene or operator of the newest grasp.
    EditLast(NameChange),
    /// Move any grasp of the dataset to the trash.
    Trash(GraspId),
    /// Restore a grasp from the trash.
    Restore(GraspId),
    /// Undo the last step.
    Undo,
    /// Redo the last undone step.
    Redo,
    /// Repeat the refused trigger despite guard violations; recorded in the grasp.
    Override,
    /// Set the object of the next grasps.
    Object(ObjectName),
    /// Set the scene of the next grasps.
    Scene(Label),
    /// Set the operator of the next grasps.
    Operator(Label),
    /// End the session.
    Quit,
}

impl Command {
    /// Whether the command means the same whatever happened since it was given, because it names
    /// what it changes.
    #[must_use]
    pub fn names_its_target(&self) -> bool {
        matches!(
            self,
            Self::Relabel(..)
                | Self::Edit(..)
                | Self::Trash(_)
                | Self::Restore(_)
                | Self::Object(_)
                | Self::Scene(_)
                | Self::Operator(_)
        )
    }
}

/// Source of a command; stored with each frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CommandSource {
    /// A key in the terminal.
    Keyboard,
    /// A HID pedal or presenter.
    Pedal,
    /// A script file.
    Script,
    /// Another program.
    Remote,
}

impl CommandSource {
    /// Name in `grasp.json`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Keyboard => "keyboard",
            Self::Pedal => "pedal",
            Self::Script => "script",
            Self::Remote => "remote",
        }
    }
}

/// A command with its id and source.
#[derive(Clone, Debug, PartialEq)]
pub struct Request {
    /// Id, repeated in its [result](super::Effect::Result).
    pub id: u64,
    /// The command.
    pub command: Command,
    /// Its source.
    pub source: CommandSource,
    /// Time since the operator gave it, ms.
    pub age_ms: f64,
    /// What its sender saw.
    pub seen: Seen,
    /// Current time, `CLOCK_MONOTONIC`, ns.
    pub now_ns: u64,
}

impl Request {
    /// Creates a request that was given just now, without expectations.
    #[must_use]
    pub fn new(id: u64, command: Command, source: CommandSource) -> Self {
        Self {
            id,
            command,
            source,
            age_ms: 0.0,
            seen: Seen::default(),
            now_ns: 0,
        }
    }
}

/// Result of a command.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(tag = "result", rename_all = "snake_case")]
pub enum CommandResult {
    /// Executed; its changes are durable.
    Accepted,
    /// Refused by guards, because there was nothing to do, or because the command no longer fits.
    Refused {
        /// One reason per guard violation.
        reasons: Vec<String>,
        /// Whether `override` is possible.
        can_override: bool,
        /// Whether the command no longer fitted: too old, or its sender saw another state.
        #[serde(default)]
        stale: bool,
    },
    /// Storing failed; nothing changed.
    Failed {
        /// Error with remedy.
        error: String,
    },
}

impl CommandResult {
    /// Reason why it was not executed, in one line.
    #[must_use]
    pub fn error_message(&self) -> Option<String> {
        match self {
            Self::Accepted => None,
            Self::Refused { reasons, .. } => Some(reasons.join("; ")),
            Self::Failed { error } => Some(error.clone()),
        }
    }
}

/// An invalid command.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ParseCommandError {
    /// The text.
    pub text: String,
    /// Error of the name or id in a known command.
    pub reason: Option<String>,
}

impl fmt::Display for ParseCommandError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(reason) = &self.reason {
            return f.write_str(reason);
        }
        write!(
            f,
            "unknown command `{}`; expected one of trigger, initial, grasp, stable, slip, unlabel, \
             undo, redo, override, object NAME, scene NAME, operator NAME, relabel ID OUTCOME, \
             edit ID|last object|scene|operator NAME, trash ID, restore ID, quit",
            self.text
        )
    }
}

impl std::error::Error for ParseCommandError {}

/// Commands without arguments.
const PLAIN: [(&str, Command); 10] = [
    ("trigger", Command::Trigger),
    ("initial", Command::Initial),
    ("grasp", Command::Grasp),
    ("stable", Command::Label(Outcome::Stable)),
    ("slip", Command::Label(Outcome::Slip)),
    ("unlabel", Command::Label(Outcome::Unlabelled)),
    ("undo", Command::Undo),
    ("redo", Command::Redo),
    ("override", Command::Override),
    ("quit", Command::Quit),
];

impl FromStr for Command {
    type Err = ParseCommandError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let text = text.trim();
        let (word, rest) = text.split_once(char::is_whitespace).unwrap_or((text, ""));
        let rest = rest.trim();
        let error = || ParseCommandError {
            text: text.to_owned(),
            reason: None,
        };
        let because = |e: Error| ParseCommandError {
            reason: Some(e.what().to_owned()),
            ..error()
        };
        let label = || {
            if rest.is_empty() {
                Err(error())
            } else {
                Label::parse(rest).map_err(because)
            }
        };
        let id = |text: &str| GraspId::parse(text).map_err(because);
        match word {
            "trash" => Ok(Self::Trash(id(rest)?)),
            "restore" => Ok(Self::Restore(id(rest)?)),
            "relabel" => {
                let (which, outcome) = rest.split_once(char::is_whitespace).ok_or_else(error)?;
                let outcome = Outcome::by_name(outcome.trim()).ok_or_else(error)?;
                Ok(Self::Relabel(id(which)?, outcome))
            }
            "edit" => {
                let (which, names) = rest.split_once(char::is_whitespace).ok_or_else(error)?;
                let names = NameChange::parse(names.trim()).map_err(because)?;
                Ok(match which {
                    "last" => Self::EditLast(names),
                    which => Self::Edit(id(which)?, names),
                })
            }
            "object" if rest.is_empty() => Err(error()),
            "object" => ObjectName::parse(rest).map(Self::Object).map_err(because),
            "scene" => label().map(Self::Scene),
            "operator" => label().map(Self::Operator),
            _ => {
                let plain = PLAIN.iter().find(|(name, _)| *name == word);
                let plain = plain.filter(|_| rest.is_empty()).ok_or_else(error)?;
                Ok(plain.1.clone())
            }
        }
    }
}

impl fmt::Display for Command {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Relabel(id, outcome) => write!(f, "relabel {id} {outcome}"),
            Self::Edit(id, names) => write!(f, "edit {id} {names}"),
            Self::EditLast(names) => write!(f, "edit last {names}"),
            Self::Trash(id) => write!(f, "trash {id}"),
            Self::Restore(id) => write!(f, "restore {id}"),
            Self::Object(name) => write!(f, "object {name}"),
            Self::Scene(name) => write!(f, "scene {name}"),
            Self::Operator(name) => write!(f, "operator {name}"),
            plain => {
                let named = PLAIN.iter().find(|(_, command)| command == plain);
                f.write_str(named.map_or("", |(name, _)| name))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_round_trip() {
        for text in [
            "trigger",
            "initial",
            "grasp",
            "stable",
            "slip",
            "unlabel",
            "undo",
            "redo",
            "override",
            "object mug blue",
            "scene lab",
            "operator Ada",
            "relabel 2026-11-20T10-15-03Z-7f3a unlabelled",
            "edit 2026-11-20T10-15-03Z-7f3a object mug blue",
            "edit last scene lab",
            "edit 2026-11-20T10-15-03Z-7f3a operator Ada",
            "trash 2026-11-20T10-15-03Z-7f3a",
            "restore 2026-11-20T10-15-03Z-7f3a",
            "quit",
        ] {
            assert_eq!(text.parse::<Command>().unwrap().to_string(), text);
        }
    }

    #[test]
    fn invalid_commands_are_refused() {
        for text in [
            "",
            "object",
            "grasp now",
            "jump",
            "trash",
            "trash ../7f3a",
            "object ../mug",
            "object a\u{202e}b",
            "scene a\u{1b}[2Jb",
            "edit 7f3a",
            "edit 7f3a object",
            "edit 7f3a colour blue",
            "edit 7f3a object a/b",
            "edit ../7f3a object mug",
            "relabel 7f3a",
            "relabel 7f3a good",
        ] {
            assert!(text.parse::<Command>().is_err(), "{text:?}");
        }
    }
}
