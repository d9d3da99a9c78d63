//! Set of presses for fitting and scoring.

use image::RgbImage;
use serde::Serialize;

use super::ball::BallContact;
use crate::SensorGeometry;

/// A press with its contact.
#[derive(Clone, Debug)]
pub struct LabelledPress {
    /// Number in the list, from 1.
    pub number: usize,
    /// File name.
    pub file: String,
    /// SHA-256 of the file, 64 hex digits.
    pub sha256: String,
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
    /// Number in the list, from 1.
    pub number: usize,
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
    /// That of the profile that is scored.
    Profile,
}

/// Presses of one ball on one sensor.
#[derive(Clone, Debug)]
pub struct PressSet {
    /// Pixel grid and scale.
    pub geometry: SensorGeometry,
    /// Source of the scale.
    pub scale: ScaleSource,
    /// Pixel size that the list or the user states, on the pixel grid of `geometry`, m.
    pub stated_pixel_m: Option<f64>,
    /// Ball radius, m.
    pub ball_m: f64,
    /// Ball diameter of the list if another one was given, m.
    pub overridden_ball_diameter_m: Option<f64>,
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

    /// Returns the indices of the usable presses at some positions of the list.
    pub(super) fn indices_of(&self, positions: &[usize]) -> Vec<usize> {
        let presses = self.presses.iter().enumerate();
        let named = presses.filter(|(_, press)| positions.contains(&(press.number - 1)));
        named.map(|(index, _)| index).collect()
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
        stated_pixel_m: Some(geometry.pixel_m),
        ball_m,
        overridden_ball_diameter_m: None,
        untouched: crate::background::planes_of(&no_contact),
        no_contact,
        presses,
        skipped: Vec::new(),
    }
}
