//! What an operator can ask for, whichever way it arrives.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use gripcast_base::error::Error;
use gripcast_base::files::{Label, ObjectName};
use gripcast_dataset::{GraspId, Outcome};

/// A session command; keyboard, pedal, script and API all end here.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Command {
    /// The next step of the cycle: initial, then grasp. Nothing while a label is awaited.
    Trigger,
    /// Take the initial frame (again).
    Initial,
    /// Take the grasp frame.
    Grasp,
    /// Label the last grasp.
    Label(Outcome),
    /// Label any grasp of the dataset.
    Relabel(GraspId, Outcome),
    /// Move any grasp of the dataset to the trash.
    Trash(GraspId),
    /// Take a grasp back from the trash.
    Restore(GraspId),
    /// Take back the last step.
    Undo,
    /// Do again what was taken back.
    Redo,
    /// Repeat the refused command although a guard refused it; recorded in the grasp.
    Override,
    /// Name of the object from now on.
    Object(ObjectName),
    /// Name of the scene from now on.
    Scene(Label),
    /// Name of the operator from now on.
    Operator(Label),
    /// End the session.
    Quit,
}

/// Where a command came from; stored with each frame.
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

/// A command on its way through the session.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Request {
    /// Number by which its [result](super::Effect::Result) names it.
    pub id: u64,
    /// What is asked for.
    pub command: Command,
    /// Where it came from.
    pub source: CommandSource,
}

/// What became of a command.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(tag = "result", rename_all = "snake_case")]
pub enum CommandResult {
    /// Carried out; what it changed is durable.
    Accepted,
    /// Refused: by guards, or because there was nothing to do.
    Refused {
        /// One for each guard, or what there was not to do.
        reasons: Vec<String>,
        /// Whether `override` can help.
        can_override: bool,
    },
    /// It failed on disk; nothing changed.
    Failed {
        /// What failed, and how to fix it.
        error: String,
    },
}

impl CommandResult {
    /// Why it was not carried out, in one line.
    #[must_use]
    pub fn complaint(&self) -> Option<String> {
        match self {
            Self::Accepted => None,
            Self::Refused { reasons, .. } => Some(reasons.join("; ")),
            Self::Failed { error } => Some(error.clone()),
        }
    }
}

/// A text that is no command.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ParseCommandError {
    /// The text.
    pub text: String,
    /// What is wrong with the name or id in it, where the command itself is known.
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
             trash ID, restore ID, quit",
            self.text
        )
    }
}

impl std::error::Error for ParseCommandError {}

/// Commands of one word.
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
    fn every_command_reads_back() {
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
            "trash 2026-11-20T10-15-03Z-7f3a",
            "restore 2026-11-20T10-15-03Z-7f3a",
            "quit",
        ] {
            assert_eq!(text.parse::<Command>().unwrap().to_string(), text);
        }
    }

    #[test]
    fn nonsense_is_refused() {
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
            "relabel 7f3a",
            "relabel 7f3a good",
        ] {
            assert!(text.parse::<Command>().is_err(), "{text:?}");
        }
    }
}
