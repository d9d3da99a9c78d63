//! Calibration: fits a sensor profile to real presses of a ball.
//!
//! A folder contains an image of the untouched gel and presses of a ball of known diameter
//! ([`PressSet`]; unlabelled contacts are detected). Some of the presses, drawn or named ([`Split`]),
//! are fitted: first gel shape, shading terms and ridge by cross-validation, then the coefficients
//! on all of them. The held-out presses are scored ([`score`]). [`score_profile`] scores an existing
//! profile.

mod ball;
mod detect;
mod evaluate;
mod led_fit;
mod no_contact;
mod press_file;
mod press_read;
mod press_set;
mod report;
mod run;
mod score;
mod select;
mod sheet;
mod simplex;
mod split;
mod sums;

pub use ball::BallContact;
pub use evaluate::score_profile;
pub use press_read::ReadOptions;
pub use press_set::{LabelledPress, PressSet, ScaleSource, SkippedPress};
pub use report::{CalibrationReport, FitReport, PressRow, Role};
pub use run::{CalibrateOptions, Calibration, ModelChoice, run};
pub use score::{ChangePlanes, ObservedChange, PressScore, Score, change_between, observe, score};
pub use select::{ChosenModel, Terms};
pub use split::{Split, SplitPresses};
