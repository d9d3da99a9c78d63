//! Rig files: which camera has which role, with which mode, controls and guards; intrinsics.

mod draft;
mod factory;
mod rig_file;

pub use draft::{Draft, draft};
pub use factory::{ColourTable, colour_intrinsics};
pub use rig_file::{BoardsConfig, CameraConfig, PedalConfig, RigFile, SourceKind};
