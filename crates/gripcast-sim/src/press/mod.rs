//! Pressing a gel against a fixed rigid indenter, quasi-statically: force against depth.

mod indenter;
mod run;

pub use indenter::Indenter;
pub use run::{Goal, Press, PressPoint, half_pad, quarter_pad};
