//! Gel markers: dots under the skin of a gel that move with it.
//!
//! [`MarkerLattice`] places the dots of a [`MarkerPattern`](gripcast_shear::MarkerPattern) at rest.
//! A motion of the skin, a function from a point at rest to its displacement (m, sensor frame),
//! carries them: [`NodeMotion`] interpolates the face nodes of a simulated gel, [`LayerMotion`]
//! models a gel of which only the depth is known. The dots are drawn into the shaded image before
//! noise, as ellipses that follow the stretch of the skin.

mod dots;
mod lattice;
mod layer_motion;
mod node_motion;
mod pattern;
#[cfg(test)]
mod simulated_gel_test;
#[cfg(test)]
mod slip_ratio_test;

pub use lattice::MarkerLattice;
pub use layer_motion::{ContactLoad, LayerMotion};
pub use node_motion::NodeMotion;

pub(crate) use dots::MarkerInk;
pub(crate) use layer_motion::ElasticLayer;
pub(crate) use pattern::validate;
