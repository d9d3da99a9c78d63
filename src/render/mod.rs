//! What the sensors would see of a simulated grasp: tactile pictures and the camera between the
//! fingers.

mod seed;
pub mod tactile;
pub mod visual;
