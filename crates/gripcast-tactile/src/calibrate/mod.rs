//! Calibration: fits a sensor profile to real presses of a ball.
//!
//! A folder contains an image of the untouched gel and presses of a ball of known diameter
//! ([`PressSet`]; unlabelled contacts are detected). A random split of the presses is fitted: first
//! gel shape, shading terms and ridge by cross-validation, then the coefficients on all of them.
//! The held-out presses are scored ([`score`]).

mod ball;
mod detect;
mod led_fit;
mod press_file;
mod press_read;
mod press_set;
mod report;
mod run;
mod score;
mod select;
mod sheet;
mod simplex;
mod sums;

pub use ball::BallContact;
pub use press_read::ReadOptions;
pub use press_set::{LabelledPress, PressSet, ScaleSource, SkippedPress};
pub use report::CalibrationReport;
pub use run::{CalibrateOptions, Calibration, ModelChoice, run};
pub use score::{ChangePlanes, ObservedChange, PressScore, Score, change_between, observe, score};
pub use select::{ChosenModel, Terms};
