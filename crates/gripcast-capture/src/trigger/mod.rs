//! Where commands come from besides the screen: foot pedal, script.
//!
//! Both deliver the text of a session command (`trigger`, `stable`, `object mug`), so that
//! every way of asking means the same.

mod pedal;
mod script;

pub use pedal::{
    KeyEdgeDetector, KeyMap, PedalEvent, find_pedal, key_usage, pedal_udev_rule, run_pedal,
    usage_key,
};
pub use script::{Answer, Conditions, Script, ScriptAction, ScriptRunner};

/// A command from outside.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TriggerEvent {
    /// Text of the command.
    pub text: String,
    /// When it was given, `CLOCK_MONOTONIC`, ns.
    pub at_ns: u64,
}
