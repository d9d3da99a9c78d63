//! The virtual rig's world: a hand that grasps object after object, and what its cameras see.
//!
//! Every grasp is a simulated one. Tactile pictures are rendered from its trace, step by step, by
//! the renderer that the synthetic datasets use; a colour picture takes the path tracer seconds,
//! so those are made ahead for some key steps ([`shoot`]). Pictures are pure functions of the
//! hand's state, the frame's number and a seed.

mod film;
mod gel;
mod hand;
mod library;
mod random;
mod shoot;
mod view;

pub use film::{Film, FilmFiles, FilmKeys};
pub(super) use gel::GelPainter;
pub use hand::{HandGoal, SceneMoment, VirtualHand};
pub use library::FilmLibrary;
pub use shoot::{ShootSettings, shoot};
pub(super) use view::{ColourPainter, DepthPainter, Place};
