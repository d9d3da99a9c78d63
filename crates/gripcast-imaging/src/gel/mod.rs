//! Tactile images judged as images: contact, illumination and the state of a gel.
//!
//! [`GelCells`] reduces an image to a grid. [`GelChange`] splits the change between two of them
//! into a smooth illumination and local structure: only structure is contact. [`GelMonitor`]
//! follows one gel over time and names its [`GelProblem`]s. A [`ViewProblem`] is an image that is not
//! as a GelSight Mini sends it.

mod cells;
mod change;
#[cfg(test)]
mod change_test;
mod monitor;
#[cfg(test)]
mod monitor_test;
#[cfg(test)]
mod real_gel_test;
mod view;

pub use cells::GelCells;
pub use change::{ChangeKind, GelChange, MIN_CONTACT_FRACTION};
pub use monitor::{GelMonitor, GelProblem, GelState};
pub use view::ViewProblem;
