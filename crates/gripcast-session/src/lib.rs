//! The collection state machine: commands and observations in, effects and a view out, no IO.
//!
//! ```text
//!            trigger              trigger            stable | slip
//!  Initial ──────────► Grasp ────────────► Label ──────────────────► Initial …
//!     ▲     guards            guards          │
//!     └──────────────── undo / redo, any number of steps ───────────┘
//! ```
//!
//! Guards ([`GuardLimits`]) check each trigger; a refusal lists its reasons, and
//! [`Command::Override`] repeats the trigger and records the overridden guards. The engine executes
//! [`Effect`]s, one [`StoreRequest`] at a time, and replies with [`StoreReply`]; nothing counts as
//! saved before the reply. The last effect of a command is its [`CommandResult`].
//!
//! A command carries its age and what its sender saw ([`Seen`]); one that no longer fits is refused
//! and changes nothing.

mod command;
mod guard;
mod history;
mod machine;
#[cfg(test)]
mod machine_test;
mod names;
mod pending;
mod seen;
#[cfg(test)]
mod seen_test;
mod store;
mod view;

pub use command::{Command, CommandResult, CommandSource, ParseCommandError, Request};
pub use guard::{CameraCondition, Conditions, Guard, GuardLimits, GuardViolation};
pub use machine::{Effect, OutcomeCounts, Session, Summary};
pub use pending::PendingFrame;
pub use seen::Seen;
pub use store::{Labels, StoreReply, StoreRequest};
pub use view::{Counts, LastGrasp, Message, MessageLevel, Refusal, SessionView, Step, Tone};
