//! Session commands (`trigger`, `stable`, `object mug`) from foot pedals and scripts.

mod pedal;
mod script;

pub use pedal::{PedalEvent, find_pedal, pedal_udev_rule, run_pedal};
pub use script::{Answer, Conditions, Script, ScriptAction, ScriptRunner};

/// A command of a pedal.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TriggerEvent {
    /// Text of the command.
    pub text: String,
    /// Time of the command, `CLOCK_MONOTONIC`, ns.
    pub at_ns: u64,
}
