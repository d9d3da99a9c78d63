//! Calibration from pictures.

mod gripper;
mod gripper_bundle;
mod gripper_check;
mod gripper_frame;
mod gripper_linear;
mod gripper_report;
mod gripper_start;
#[cfg(test)]
mod gripper_test;

pub use gripper::{
    CalibratedMarker, FrameSource, GripperCalibration, GripperPicture, MarkerState,
    calibrate_gripper,
};
