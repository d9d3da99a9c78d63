//! Rig files: which camera has which role, with which mode, controls and guards.

mod rig_file;

pub use rig_file::{CameraConfig, PedalConfig, RigFile, SourceKind};
