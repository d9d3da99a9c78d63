//! The collection state machine: commands and observations in, effects and a view out, no IO.
//!
//! ```text
//!            trigger              trigger            stable | slip
//!  Initial ──────────► Grasp ────────────► Label ──────────────────► Initial …
//!     ▲     guards            guards          │
//!     └──────────────── undo / redo, any number of steps ───────────┘
//! ```
//!
//! A trigger is held against the guards ([`GuardLimits`]); a refusal names its reasons, and
//! [`Command::Override`] repeats the trigger and records what was overridden. The engine carries
//! out [`Effect`]s, one [`StoreRequest`] at a time, and answers with [`StoreReply`]; nothing is
//! called saved before the answer. The last effect of a command is its [`CommandResult`].

mod command;
mod guard;
mod history;
mod machine;
#[cfg(test)]
mod machine_test;
mod pending;
mod store;
mod view;

pub use command::{Command, CommandResult, CommandSource, ParseCommandError, Request};
pub use guard::{CameraCondition, Conditions, Guard, GuardLimits, Objection};
pub use machine::{Effect, OutcomeCounts, Session, Summary};
pub use pending::PendingFrame;
pub use store::{Labels, StoreReply, StoreRequest};
pub use view::{Counts, LastGrasp, Message, MessageLevel, Refusal, SessionView, Step, Tone};
