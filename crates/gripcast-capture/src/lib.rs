//! Everything that touches USB, V4L2 or HID.
//!
//! * [`camera`]: frame sources (V4L2, replay) and their supervision; whoever opens a rig passes
//!   what makes its virtual cameras
//! * [`device`]: discovery and identity of USB cameras, access rights
//! * [`trigger`]: pedal and script, both ending in session commands
//! * [`calibration`]: rig files, intrinsics, factory read-out

pub mod calibration;
pub mod camera;
pub mod device;
pub mod trigger;
