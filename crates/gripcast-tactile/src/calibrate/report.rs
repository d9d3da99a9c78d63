//! Report of a calibration.

use serde::Serialize;

use super::press_set::{ScaleSource, SkippedPress};
use super::score::Score;
use super::select::ChosenModel;

/// Result of a calibration. `fve`, `patch_psnr_db`, `patch_l1` and the no-contact baseline are
/// those of the held-out presses, or of the fitted ones if none is held out (see `scored_on`).
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CalibrationReport {
    /// Scores.
    #[serde(flatten)]
    pub score: Score,
    /// `held_out`, or `fitted` if no press is held out.
    pub scored_on: &'static str,
    /// Number of fitted presses.
    pub fitted: usize,
    /// Number of held-out presses.
    pub held_out: usize,
    /// Unusable presses.
    pub skipped: Vec<SkippedPress>,
    /// Number of presses whose contact was detected in the image.
    pub contacts_found: usize,
    /// Seed of the split.
    pub seed: u64,
    /// `polynomial` or `leds`.
    pub model: &'static str,
    /// Gel shape and shading terms; for LEDs those of the polynomial that selected the shape.
    pub chosen: ChosenModel,
    /// Ball diameter, m.
    pub ball_diameter_m: f64,
    /// Pixel size, m.
    pub pixel_m: f64,
    /// Source of the pixel size.
    pub scale: ScaleSource,
    /// Cross-validated FVE of each candidate scale: pixel size (m), FVE.
    pub scale_scan: Vec<[f64; 2]>,
    /// Mean gain of the presses relative to the no-contact image.
    pub gain_mean: [f64; 3],
    /// Mean offset at the mean level of the background, grey levels.
    pub offset_mean: [f64; 3],
    /// Noise of one frame, standard deviation, grey levels.
    pub noise_std: [f64; 3],
}
