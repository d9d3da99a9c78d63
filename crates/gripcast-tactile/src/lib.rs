//! Tactile images of a GelSight Mini pressed on an object.
//!
//! A press is a depth map on the sensor's pixel grid ([`PressDepth`]), from which a renderer makes
//! an image. Image columns run along the gel's x axis (the gripper's approach direction, 25 mm),
//! rows along its y axis, as seen by the sensor's camera behind the gel.
//!
//! A [`TactileScene`] is the object and the gel in the sensor frame, from a simulated grasp or from
//! a mesh pressed to a given depth; every [`SceneRenderer`] renders it. [`ObjectDepthRenderer`] is
//! the renderer of the paper: [`object_depth`] by a z-buffer ([`Rasteriser`]), then
//! [`TactileRenderer`]. [`GelSurfaceRenderer`] and [`lookup::LookupRenderer`] are baselines.
//!
//! [`TactileRenderer`] uses a [`SensorProfile`], which [`calibrate`] fits to real presses: depth →
//! gel shape ([`Smoothing`]) → normals → change of light ([`ShadingModel`]) on the background image
//! → drift and noise ([`FrameNoise`]).

mod background;
mod bessel;
pub mod calibrate;
mod contact_gap;
mod depth;
pub mod force;
mod gaussian;
mod gel_surface;
mod led;
pub mod lookup;
mod markers;
mod membrane;
mod moment;
mod noise;
mod normals;
mod press_depth;
mod profile;
mod profile_gel;
mod rasteriser;
#[cfg(any(test, feature = "testing"))]
pub mod rays;
mod renderer;
mod rigid_press;
mod scene;
mod scene_renderer;
mod shading;
mod shipped_profile;
mod smooth;
mod trace_header;
mod variation;
mod whole_frame;

pub use background::BackgroundFit;
pub use contact_gap::contact_gap;
pub use depth::{gel_surface_depth, object_depth};
pub use gel_surface::{GelSurfaceRenderer, faceted};
pub use led::{Led, LedShading};
pub use markers::{ContactLoad, LayerMotion, MarkerLattice, NodeMotion};
pub use membrane::ball_sink_m;
pub use moment::Moment;
pub use noise::{Drift, FrameNoise};
pub use normals::Normals;
pub use press_depth::{PressDepth, SensorGeometry};
pub use profile::{Background, FittedPress, SensorProfile, ShadingModel};
pub use profile_gel::ProfileGel;
pub use rasteriser::{NO_TRIANGLE, Rasteriser};
pub use renderer::TactileRenderer;
pub use rigid_press::{depth_under_force, foundation_pa_m};
pub use scene::{MountingAngle, SensorMount, SimulatedGel, Skin, TactileScene};
pub use scene_renderer::{ObjectDepthRenderer, SceneRenderer};
pub use shading::{NormalOrder, PolynomialShading, PositionOrder};
pub use shipped_profile::SensorName;
pub use smooth::{Smoother, Smoothing};
pub use trace_header::{TraceHeader, TraceObject, TraceStart};
pub use variation::SensorVariation;
pub use whole_frame::WholeFrame;

/// Fails with the given error unless the condition holds.
fn ensure<E>(holds: bool, error: impl FnOnce() -> E) -> Result<(), E> {
    if holds { Ok(()) } else { Err(error()) }
}
