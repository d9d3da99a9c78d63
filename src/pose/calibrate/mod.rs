//! Calibration from pictures of a board: the intrinsics of a camera.

mod board_points;
mod bundle;
mod collector;
mod coverage;
mod intrinsics;
#[cfg(test)]
mod intrinsics_test;
#[cfg(test)]
mod pictures_test;
mod saddle;
mod start;

pub use board_points::{BoardPoint, BoardPoints, PointFinder};
pub use collector::{Collector, CollectorSettings, Offer, Refusal};
pub use coverage::{Coverage, Hint, Tilt};
pub use intrinsics::{CalibrationReport, Holdout, PARAMETERS, ViewFit, calibrate_intrinsics};
