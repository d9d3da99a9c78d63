//! Hardware access: USB, V4L2 and HID.
//!
//! * [`camera`]: frame sources (V4L2, replay) and their supervision
//! * [`device`]: discovery and identity of USB cameras, access rights
//! * [`trigger`]: session commands from pedals and scripts
//! * [`calibration`]: rig files, factory intrinsics

pub mod calibration;
pub mod camera;
pub mod device;
pub mod trigger;
