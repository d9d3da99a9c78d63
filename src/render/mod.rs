//! What the sensors would see of a simulated grasp: tactile pictures and the camera between the
//! fingers.

pub(crate) mod caption;
mod seed;
pub mod tactile;
pub mod visual;
