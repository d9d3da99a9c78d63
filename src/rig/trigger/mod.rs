//! Where commands come from: keyboard, foot pedal, script.
