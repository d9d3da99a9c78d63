//! Demo data: a small dataset without real grasps. Its "reality" is a simulation that differs from
//! the one that replays it, and the dataset states that.
//!
//! [`build_demo`] covers the whole chain: grasps are sampled and simulated with the fine mesh and
//! softer gels ([`reality`]), selected so that half of them slip ([`selection`]), rendered
//! ([`images`], [`tactile`]), annotated by gripcast's pose estimation and recorded ([`recording`]).

mod build;
mod images;
mod object;
mod plan;
mod reality;
mod recording;
mod selection;
mod tactile;

pub use build::{DemoData, build_demo};
pub use plan::{DemoProgress, DemoSettings, DemoStage, DemoWatch};
