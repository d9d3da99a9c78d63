//! Shear: how the skin of a gel moves under a tactile image.
//!
//! A [`ShearTracker`] starts from the image of the untouched gel and measures each later image
//! against it: the displacement of every gel marker where the gel has them, else the rigid motion of
//! the texture in contact. Positions are pixels of the cropped image: x right, y down, pixel (0,0)
//! is the centre of the top-left pixel.
//!
//! ```
//! use gripcast_shear::{ExpectedMarkers, ShearTracker};
//! use image::{Rgb, RgbImage};
//!
//! let initial = RgbImage::from_pixel(320, 240, Rgb([90, 100, 110]));
//! let mut tracker = ShearTracker::new(&initial, 3.0e-5, ExpectedMarkers::Unknown)?;
//! let frame = tracker.update(&initial);
//! assert!(frame.field.is_none());
//! # Ok::<(), gripcast_base::error::Error>(())
//! ```

mod association;
mod contact;
mod contact_map;
mod darkness;
mod dots;
mod force;
mod gel_motion;
mod lattice;
mod marker;
mod markers;
mod problem;
mod slip;
mod texture;
#[cfg(test)]
mod texture_test;
mod tracker;
#[cfg(test)]
mod tracker_test;

pub use contact_map::ContactMaps;
pub use force::FingerForce;
pub use gel_motion::{GelMotion, LiftImage, LiftMotion};
pub use marker::{GelMarker, MarkerField, MarkerPattern, covered};
pub use problem::ShearProblem;
pub use tracker::{
    ExpectedMarkers, ShearFrame, ShearSource, ShearSummary, ShearTracker, USUAL_M_PER_PX,
};
