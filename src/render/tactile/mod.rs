//! Pictures of a GelSight Mini pressed on an object.
//!
//! A press is a map of depths on the sensor's pixel grid ([`PressDepth`]); a renderer makes a
//! picture of it. Columns of the picture run along the gel's x axis (the gripper's approach,
//! 25 mm), rows along its y axis, as the sensor's camera sees it from behind the gel.
//!
//! [`TactileRenderer`] works by a [`SensorProfile`], which [`calibrate`] fits to real presses:
//! depth → shape of the gel ([`Smoothing`]) → normals → change of light ([`ShadingModel`]) on the
//! picture of the untouched gel → drift and noise ([`FrameLook`]).

mod background;
mod bessel;
pub mod calibrate;
mod gaussian;
mod led;
mod membrane;
mod noise;
mod normals;
mod press_depth;
mod profile;
mod renderer;
mod shading;
mod smooth;

pub use background::BackgroundFit;
pub use led::{Led, LedShading};
pub use membrane::sink_of_ball_m;
pub use noise::{Drift, FrameLook};
pub use normals::Normals;
pub use press_depth::{PressDepth, SensorGeometry};
pub use profile::{Background, SensorProfile, ShadingModel};
pub use renderer::TactileRenderer;
pub use shading::{NormalOrder, PolynomialShading, PositionOrder};
pub use smooth::{Smoother, Smoothing};
