//! Where commands come from: keyboard, foot pedal, script.
//!
//! All of them deliver the text of a session command (`trigger`, `stable`, `object mug`), so that
//! every way of asking means the same.

mod keyboard;
mod pedal;
mod script;

pub use keyboard::{KEY_BINDINGS, Key, KeyBinding, command_for_key};
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
    /// Where it came from.
    pub source: TriggerSource,
    /// When it was given, `CLOCK_MONOTONIC`, ns.
    pub at_ns: u64,
}

/// Where a command came from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TriggerSource {
    /// A key in the terminal.
    Keyboard,
    /// A HID pedal or presenter.
    Pedal,
    /// A script file.
    Script,
    /// Another program.
    Remote,
}
