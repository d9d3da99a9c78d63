//! Presses ready to fit and to score.

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
    /// File.
    pub file: String,
    /// The sensor's image.
    pub image: RgbImage,
    /// Column and row of the contact's centre, pixels.
    pub centre_px: [f64; 2],
    /// Radius of the contact, pixels.
    pub radius_px: f64,
    /// Whether the contact was found in the image, not given.
    pub is_detected: bool,
}

/// A press that is not used.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct SkippedPress {
    /// File.
    pub file: String,
    /// Why.
    pub reason: String,
}

/// Where the size of a pixel comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ScaleSource {
    /// Given with the presses or by the user.
    Given,
    /// A Mini's nominal view.
    Nominal,
    /// Chosen by cross-validation around another value.
    Fitted,
}

/// Presses of one ball on one sensor.
#[derive(Clone, Debug)]
pub struct PressSet {
    /// Grid and scale.
    pub geometry: SensorGeometry,
    /// Where the scale comes from.
    pub scale: ScaleSource,
    /// Radius of the ball, m.
    pub ball_m: f64,
    /// The untouched gel.
    pub no_contact: RgbImage,
    /// Planes of the untouched gel.
    pub(super) untouched: [Vec<f32>; 3],
    /// Usable presses, in the order of the list.
    pub presses: Vec<LabelledPress>,
    /// The others.
    pub skipped: Vec<SkippedPress>,
}

impl PressSet {
    /// The contact of a press.
    pub fn contact(&self, press: &LabelledPress) -> BallContact {
        BallContact {
            geometry: self.geometry,
            centre_px: press.centre_px,
            radius_px: press.radius_px,
            ball_m: self.ball_m,
        }
    }

    /// Indices for fitting and for scoring: a shuffle by seed, the first `fraction` of it to fit
    /// (at most `most`, at least one), the others, in equal number for every `most`, to score.
    pub fn split(&self, fraction: f64, most: Option<usize>, seed: u64) -> (Vec<usize>, Vec<usize>) {
        let mut order: Vec<usize> = (0..self.presses.len()).collect();
        order.shuffle(&mut Pcg64::seed_from_u64(seed));
        let count = (fraction * order.len() as f64).round() as usize;
        let held_out = order.split_off(count.clamp(1, order.len()));
        order.truncate(most.unwrap_or(usize::MAX).max(1));
        (order, held_out)
    }
}

/// A press without a set, for tests of the fit.
#[cfg(test)]
pub(super) fn made_up(
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
