//! What a calibration found, for people and programs.

use serde::Serialize;

use super::press_set::{ScaleSource, SkippedPress};
use super::score::Score;
use super::select::ChosenModel;

/// Result of a calibration. `fve`, `patch_psnr_db`, `patch_l1` and the no-contact baseline are
/// those of the presses that were not fitted (of the fitted ones where none is left, see
/// `scored_on`).
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CalibrationReport {
    /// Scores.
    #[serde(flatten)]
    pub score: Score,
    /// `held_out`, or `fitted` where every press was fitted.
    pub scored_on: &'static str,
    /// Presses fitted.
    pub fitted: usize,
    /// Presses held out.
    pub held_out: usize,
    /// Presses that could not be used.
    pub skipped: Vec<SkippedPress>,
    /// Presses whose contact was found in the image.
    pub contacts_found: usize,
    /// Seed of the split.
    pub seed: u64,
    /// `polynomial` or `leds`.
    pub model: &'static str,
    /// Shape of the gel and terms; for lamps the polynomial by which the shape was chosen.
    pub chosen: ChosenModel,
    /// Diameter of the ball, m.
    pub ball_diameter_m: f64,
    /// Size of a pixel, m.
    pub pixel_m: f64,
    /// Where it comes from.
    pub scale: ScaleSource,
    /// Cross-validated FVE for each scale that was tried: pixel size (m), FVE.
    pub scale_scan: Vec<[f64; 2]>,
    /// Mean gain of the presses against the image without contact.
    pub gain_mean: [f64; 3],
    /// Mean offset at the background's mean level, grey levels.
    pub offset_mean: [f64; 3],
    /// Noise of one frame, grey levels.
    pub noise_std: [f64; 3],
}
