//! Calibration from images: camera intrinsics from views of a board, and the poses of the gripper's
//! tags.

mod board_points;
mod bundle;
mod chessboard_finder;
mod collector;
mod coverage;
mod gripper;
mod gripper_bundle;
mod gripper_check;
mod gripper_frame;
mod gripper_report;
mod gripper_result;
mod gripper_start;
#[cfg(test)]
mod gripper_test;
#[cfg(test)]
mod images_test;
mod intrinsics;
#[cfg(test)]
mod intrinsics_test;
mod saddle;
mod start;

pub use board_points::{BoardPoint, BoardPoints, PointFinder};
pub use collector::{AddedImage, Collector, CollectorSettings, Rejection};
pub use coverage::{Coverage, Hint, Tilt};
pub use gripper::calibrate_gripper;
pub use gripper_result::{
    CalibratedMarker, FrameSource, GripperCalibration, GripperImage, MarkerState,
};
pub use intrinsics::{CalibrationReport, Holdout, PARAMETERS, ViewFit, calibrate_intrinsics};
