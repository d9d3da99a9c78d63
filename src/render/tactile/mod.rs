//! Pictures of a GelSight Mini pressed on an object.
//!
//! A press is a map of depths on the sensor's pixel grid ([`PressDepth`]); a renderer makes a
//! picture of it. Columns of the picture run along the gel's x axis (the gripper's approach,
//! 25 mm), rows along its y axis, as the sensor's camera sees it from behind the gel.

mod press_depth;

pub use press_depth::{PressDepth, SensorGeometry};
