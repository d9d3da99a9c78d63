//! Virtual rig: a hand that grasps one object after another, and its cameras.
//!
//! The hand plays back recorded simulations. Tactile images are rendered at each step of the
//! trace with the renderer of the synthetic datasets; colour images take the path tracer seconds,
//! so they are rendered ahead of time at keyframes ([`record_clip`]). Images are pure functions
//! of the hand's state, the frame number and a seed.
//!
//! [`VirtualSource`] opens the virtual cameras of a rig file.
//!
//! ```
//! use std::sync::Arc;
//! use std::time::Duration;
//!
//! use gripcast_capture::calibration::RigFile;
//! use gripcast_capture::camera::{CameraOpener as _, ManualClock};
//! use gripcast_imaging::Role;
//! use gripcast_virtual_rig::{ClipLibrary, HandTarget, VirtualRig};
//!
//! let rig = VirtualRig::new(ClipLibrary::built_in()?, 1, Arc::new(ManualClock::new(0)));
//! let file = RigFile::virtual_rig();
//! let mut camera = rig.camera(Role::Left, &file.cameras[&Role::Left])?.open()?;
//! rig.hand().move_to(HandTarget::Closed);
//! let frame = camera.next_frame(Duration::from_secs(1)).unwrap();
//! assert_eq!((frame.width, frame.height), (640, 480));
//! # Ok::<(), gripcast_base::error::Error>(())
//! ```

mod camera;
#[cfg(test)]
mod camera_test;
mod clip;
mod gel;
mod hand;
mod library;
mod random;
mod record_clip;
mod source;
mod view;

pub use camera::{VirtualOpener, VirtualRig};
pub use clip::{Clip, ClipFiles, Keyframes};
pub use hand::{HandTarget, SceneState, VirtualHand};
pub use library::ClipLibrary;
pub use record_clip::{ClipSettings, record_clip};
pub use source::VirtualSource;
