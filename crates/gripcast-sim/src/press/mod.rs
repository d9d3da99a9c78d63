//! Quasi-static press of a gel against a fixed rigid indenter: force against depth.

mod indenter;
mod run;
mod setup;

pub use indenter::Indenter;
pub use run::{Press, PressPoint, PressTarget, half_pad, quarter_pad};
pub use setup::{PressGel, PressSetup, points_without_force};
