//! Finite-element gels: tetrahedral grids with a log neo-Hookean law.

mod assembly;
mod batch;
mod elastic;
mod grid;
mod kernel;
mod neo_hookean;
mod pad;
mod pattern;
mod projection;
mod safe_step;
mod surface;
mod svd;

pub use elastic::Elastic;
pub use grid::{GelGrid, GelResolution, Grading, Side};
pub(crate) use neo_hookean::outer;
pub use neo_hookean::{NeoHookean, Projection};
pub use pad::GelPad;
pub use pattern::StiffnessPattern;
pub use surface::Surface;
pub use svd::{Svd, svd, symmetric_eigen};
