//! Report of a calibration, or of the score of an existing profile.

use serde::Serialize;

use super::press_set::{PressSet, ScaleSource, SkippedPress};
use super::score::{PressScore, Score};
use super::select::ChosenModel;
use crate::SensorProfile;

/// FVE below which the rendering explains too little.
const MIN_FVE: f64 = 0.5;
/// Maximum relative difference of the profile's pixel size to the stated one.
const MAX_SCALE_DIFFERENCE: f64 = 0.03;
/// Maximum number of presses named in a note.
const MAX_NAMED: usize = 5;

/// Use of a press.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// The profile was fitted to it.
    Fitted,
    /// Scored only.
    HeldOut,
    /// Scored; the profile does not record its presses.
    Unknown,
}

/// A usable press.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PressRow {
    /// Number in the list, from 1.
    pub number: usize,
    /// Use.
    pub role: Role,
    /// Column and row of the contact centre, px of the profile's grid.
    pub center_px: [f64; 2],
    /// Contact radius, px of the profile's grid.
    pub radius_px: f64,
    /// Whether the contact was detected in the image rather than labelled.
    pub is_detected: bool,
    /// Depth of the ball below the border of its contact, from radius, pixel size and ball, m.
    pub indentation_m: f64,
    /// File and scores.
    #[serde(flatten)]
    pub score: PressScore,
}

/// Result of a calibration or of scoring a profile. `fve`, `patch_psnr_db`, `patch_l1` and the
/// no-contact baseline are means over the presses that the profile was not fitted to, or over the
/// fitted ones if there are no others (see `scored_on`).
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CalibrationReport {
    /// Scores.
    #[serde(flatten)]
    pub score: Score,
    /// Role of the presses with these scores.
    pub scored_on: Role,
    /// Means over the fitted presses, if there are any.
    pub train: Option<Score>,
    /// Number of presses that the profile was fitted to.
    pub fitted: usize,
    /// Number of other scored presses.
    pub held_out: usize,
    /// Each usable press.
    pub presses: Vec<PressRow>,
    /// Unusable presses.
    pub skipped: Vec<SkippedPress>,
    /// Files that are neither fitted nor scored although nothing is wrong with them.
    pub unused: Vec<String>,
    /// Number of presses whose contact was detected in the image.
    pub contacts_found: usize,
    /// `polynomial` or `leds`.
    pub model: &'static str,
    /// Ball diameter, m.
    pub ball_diameter_m: f64,
    /// Pixel size, m.
    pub pixel_m: f64,
    /// Source of the pixel size.
    pub scale: ScaleSource,
    /// What the fit chose; none if an existing profile is scored.
    #[serde(flatten)]
    pub fit: Option<FitReport>,
    /// What to check before the profile is used.
    pub notes: Vec<String>,
}

/// What a fit chose and observed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FitReport {
    /// Seed of a random split.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// Gel shape and shading terms; for LEDs those of the polynomial that selected the shape.
    pub chosen: ChosenModel,
    /// Cross-validated FVE of each candidate scale: pixel size (m), FVE.
    pub scale_scan: Vec<[f64; 2]>,
    /// Mean gain of the presses relative to the no-contact image.
    pub gain_mean: [f64; 3],
    /// Mean offset at the mean level of the background, grey levels.
    pub offset_mean: [f64; 3],
    /// Noise of one frame, standard deviation, grey levels.
    pub noise_std: [f64; 3],
}

/// Returns what is doubtful about scores and inputs.
pub(super) fn notes(
    set: &PressSet,
    profile: &SensorProfile,
    score: &Score,
    rows: &[PressRow],
) -> Vec<String> {
    let mut notes = Vec::new();
    let ball_mm = 2e3 * set.ball_m;
    if let Some(listed_m) = set.overridden_ball_diameter_m {
        notes.push(format!(
            "the given ball of {ball_mm:.2} mm replaces that of presses.json, {:.2} mm; the scores \
             do not tell which is right",
            1e3 * listed_m
        ));
    }
    if set.scale == ScaleSource::Nominal {
        notes.push(format!(
            "the pixel size is not known: {:.4} mm is assumed, the nominal view of a GelSight Mini; \
             pass --pixel-mm, or set `m_per_px` in presses.json",
            1e3 * set.geometry.pixel_m
        ));
    }
    let ratio = set
        .stated_pixel_m
        .map_or(1.0, |m| profile.geometry.pixel_m / m);
    if set.scale == ScaleSource::Profile && (ratio - 1.0).abs() > MAX_SCALE_DIFFERENCE {
        notes.push(format!(
            "the profile's pixel is {:.0} % of the stated one; the profile's is used",
            100.0 * ratio
        ));
    }
    if score.fve < MIN_FVE {
        notes.push(format!(
            "the profile explains little of the presses (FVE {:.2}): check the no-contact image, \
             the ball, the crop and the contacts, and whether all images are of one sensor under \
             one light",
            score.fve
        ));
    } else {
        let worse = rows.iter().filter(|row| row.score.fve < 0.0);
        let worse: Vec<&str> = worse.map(|row| &*row.score.file).collect();
        if !worse.is_empty() {
            notes.push(format!(
                "rendered worse than no contact at all: {}; check their contacts",
                listed(&worse)
            ));
        }
    }
    notes
}

/// Joins names, at most five.
pub(super) fn listed(names: &[&str]) -> String {
    let mut text = names[..names.len().min(MAX_NAMED)].join(", ");
    if names.len() > MAX_NAMED {
        text += &format!(" and {} more", names.len() - MAX_NAMED);
    }
    text
}
