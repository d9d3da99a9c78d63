//! Rig files and factory intrinsics.

mod draft;
mod factory;
mod rig_file;

pub use draft::{Draft, draft};
pub use factory::{ColourTable, colour_intrinsics};
pub use rig_file::{BoardsConfig, CameraConfig, PedalConfig, RigFile, SourceKind};
