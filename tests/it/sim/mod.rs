//! The simulator against other implementations and closed forms, and its commands.

mod cli;
mod fields;
mod ipctk;
mod press_cli;
