//! Pictures of a GelSight Mini pressed on an object.
//!
//! A press is a map of depths on the sensor's pixel grid ([`PressDepth`]); a renderer makes a
//! picture of it. Columns of the picture run along the gel's x axis (the gripper's approach,
//! 25 mm), rows along its y axis, as the sensor's camera sees it from behind the gel.

mod contact_gap;
mod depth;
mod depth_timing;
mod press_depth;
mod rasteriser;
mod scene;

pub use contact_gap::contact_gap;
pub use depth::{gel_surface_depth, object_depth};
pub use depth_timing::{DepthLoad, DepthMs, DepthTiming};
pub use press_depth::{PressDepth, SensorGeometry};
pub use rasteriser::{NO_TRIANGLE, Rasteriser};
pub use scene::{Mounting, SensorPlace, SimulatedGel, TactileScene};
