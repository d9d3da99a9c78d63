//! The collection state machine: commands and observations in, effects and a view out, no IO.

mod command;
mod view;

pub use command::{Command, CommandSource, ParseCommandError};
pub use view::{Counts, LastGrasp, Message, MessageLevel, Refusal, SessionView, Step, Tone};
