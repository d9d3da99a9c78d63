//! Set of presses for fitting and scoring.

use image::RgbImage;
use rand::SeedableRng as _;
use rand::seq::SliceRandom as _;
use rand_pcg::Pcg64;
use serde::Serialize;

use super::ball::BallContact;
use crate::SensorGeometry;

/// A press with its contact.
#[derive(Clone, Debug)]
pub struct LabelledPress {
    /// File name.
    pub file: String,
    /// The sensor's image.
    pub image: RgbImage,
    /// Column and row of the contact centre, px.
    pub centre_px: [f64; 2],
    /// Contact radius, px.
    pub radius_px: f64,
    /// Whether the contact was detected in the image rather than labelled.
    pub is_detected: bool,
}

/// A press that is not used.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct SkippedPress {
    /// File name.
    pub file: String,
    /// Why it is not used.
    pub reason: String,
}

/// Source of the pixel size.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ScaleSource {
    /// Given with the presses or by the user.
    Given,
    /// Nominal view of a Mini.
    Nominal,
    /// Fitted by cross-validation.
    Fitted,
}

/// Presses of one ball on one sensor.
#[derive(Clone, Debug)]
pub struct PressSet {
    /// Pixel grid and scale.
    pub geometry: SensorGeometry,
    /// Source of the scale.
    pub scale: ScaleSource,
    /// Ball radius, m.
    pub ball_m: f64,
    /// No-contact image.
    pub no_contact: RgbImage,
    /// Planes of the no-contact image.
    pub(super) untouched: [Vec<f32>; 3],
    /// Usable presses, in the order of the list.
    pub presses: Vec<LabelledPress>,
    /// Unusable presses.
    pub skipped: Vec<SkippedPress>,
}

impl PressSet {
    /// Returns the contact of a press.
    pub fn contact(&self, press: &LabelledPress) -> BallContact {
        BallContact {
            geometry: self.geometry,
            centre_px: press.centre_px,
            radius_px: press.radius_px,
            ball_m: self.ball_m,
        }
    }

    /// Splits the presses at random into indices to fit and to score: the first `fraction` of the
    /// shuffle is fitted (at least one, at most `max`), the rest is scored, independently of `max`.
    pub fn split(&self, fraction: f64, max: Option<usize>, seed: u64) -> (Vec<usize>, Vec<usize>) {
        let mut order: Vec<usize> = (0..self.presses.len()).collect();
        order.shuffle(&mut Pcg64::seed_from_u64(seed));
        let count = (fraction * order.len() as f64).round() as usize;
        let held_out = order.split_off(count.clamp(1, order.len()));
        order.truncate(max.unwrap_or(usize::MAX).max(1));
        (order, held_out)
    }
}

/// A press set for tests of the fit.
#[cfg(test)]
pub(super) fn test_set(
    geometry: SensorGeometry,
    ball_m: f64,
    no_contact: RgbImage,
    presses: Vec<LabelledPress>,
) -> PressSet {
    PressSet {
        geometry,
        scale: ScaleSource::Given,
        ball_m,
        untouched: crate::background::planes_of(&no_contact),
        no_contact,
        presses,
        skipped: Vec::new(),
    }
}
