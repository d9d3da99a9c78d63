//! Demo data: a small dataset of grasps that were never made. "Reality" is a simulation that differs
//! from the one that replays it, and the dataset says so.
//!
//! [`build_demo`] goes through the whole chain: grasps are drawn ([`sampler`]), simulated with the
//! fine mesh and softer gels ([`reality`]), chosen so that half of them fail ([`selection`]),
//! photographed by rendered cameras ([`images`], [`tactile`]), annotated by the project's own
//! pose code and recorded ([`recording`]).

mod build;
mod images;
mod object;
mod plan;
mod reality;
mod recording;
mod sampler;
mod selection;
mod tactile;

pub use build::{DemoData, build_demo};
pub use plan::{DemoProgress, DemoSettings, DemoStage, DemoWatch};
