//! The virtual rig's world: a hand that grasps object after object, and what its cameras see.
//!
//! Pictures are pure functions of the hand's state, the time and a seed. They are meant to look
//! and measure like the real ones (colours, contact strength, noise), not to obey physics.

mod gel;
mod grasp;
mod hand;
mod random;
mod view;

pub(super) use gel::GelPainter;
pub use grasp::{Grip, VirtualGrasp, VirtualObject};
pub use hand::{SceneMoment, VirtualHand};
pub(super) use random::NoiseTable;
pub(super) use view::ViewPainter;
