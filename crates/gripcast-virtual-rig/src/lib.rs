//! A virtual rig: a hand that grasps object after object, and the cameras that see it.
//!
//! Every grasp is a simulated one. Tactile images are rendered from its trace, step by step, by
//! the renderer that the synthetic datasets use; a colour image takes the path tracer seconds,
//! so those are rendered ahead for some key steps ([`shoot`]). Images are pure functions of the
//! hand's state, the frame's number and a seed.
//!
//! [`VirtualSource`] gives the cameras to whoever opens a rig file.
//!
//! ```
//! use std::sync::Arc;
//! use std::time::Duration;
//!
//! use gripcast_capture::calibration::RigFile;
//! use gripcast_capture::camera::{CameraOpener as _, ManualClock};
//! use gripcast_imaging::Role;
//! use gripcast_virtual_rig::{FilmLibrary, HandGoal, VirtualRig};
//!
//! let rig = VirtualRig::new(FilmLibrary::built_in()?, 1, Arc::new(ManualClock::new(0)));
//! let file = RigFile::virtual_rig();
//! let mut camera = rig.camera(Role::Left, &file.cameras[&Role::Left])?.open()?;
//! rig.hand().go(HandGoal::Closed);
//! let frame = camera.next_frame(Duration::from_secs(1)).unwrap();
//! assert_eq!((frame.width, frame.height), (640, 480));
//! # Ok::<(), gripcast_base::error::Error>(())
//! ```

mod camera;
#[cfg(test)]
mod camera_test;
mod film;
mod gel;
mod hand;
mod library;
mod random;
mod shoot;
mod source;
mod view;

pub use camera::{VirtualOpener, VirtualRig};
pub use film::{Film, FilmFiles, FilmKeys};
pub use hand::{HandGoal, SceneMoment, VirtualHand};
pub use library::FilmLibrary;
pub use shoot::{ShootSettings, shoot};
pub use source::VirtualSource;
