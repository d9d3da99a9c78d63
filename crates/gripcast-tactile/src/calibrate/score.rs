//! Scores rendered images against real presses.
//!
//! With the labelled radius r of a contact and the distance d from its centre, pixels:
//! - background: per channel gain · no-contact + offset, least squares over d > r + 45, because
//!   exposure and white balance drift between frames;
//! - patch: d < r + 10;
//! - FVE (fraction of variance explained) = 1 − SSE(rendered) / SSE(background alone) in the patch;
//! - L1 and PSNR (peak 255) in the patch over all channels, of the rendered 8-bit image.
//!
//! Whole-image measures are not used: most of the image is background, so an image without contact
//! scores as high as a good one.

use image::RgbImage;
use serde::Serialize;

use super::ball::BallContact;
use super::press_set::{LabelledPress, PressSet};
use crate::background::planes_of;
use gripcast_base::error::Result;

/// Minimum distance from the contact border for fitting the background, px.
const OUTSIDE_PX: f64 = 45.0;
/// Width of the patch beyond the contact border, px.
const PATCH_PX: f64 = 10.0;

/// Change of an image: red, green and blue planes, grey levels, each `width * height`.
pub type ChangePlanes = [Vec<f32>; 3];

/// Change of a real image caused by a press.
#[derive(Clone, Debug)]
pub struct ObservedChange {
    /// Gain relative to the no-contact image, per channel.
    pub gain: [f64; 3],
    /// Offset after the gain, grey levels.
    pub offset: [f64; 3],
    /// The image minus (gain · no-contact + offset).
    pub change: ChangePlanes,
    /// RMS change where the background was fitted, grey levels.
    pub outside_rms: [f64; 3],
}

/// Score of one press.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PressScore {
    /// File name.
    pub file: String,
    /// Fraction of variance explained in the patch.
    pub fve: f64,
    /// PSNR of the patch, dB.
    pub patch_psnr_db: f64,
    /// Mean absolute error in the patch, grey levels.
    pub patch_l1: f64,
    /// PSNR of the background alone, dB.
    pub no_contact_psnr_db: f64,
    /// Mean absolute error of the background alone, grey levels.
    pub no_contact_l1: f64,
}

/// Mean score over presses.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Score {
    /// Mean fraction of variance explained in the patch.
    pub fve: f64,
    /// The same from the squared errors pooled over all presses.
    pub fve_pooled: f64,
    /// PSNR of the patch, dB.
    pub patch_psnr_db: f64,
    /// Mean absolute error in the patch, grey levels.
    pub patch_l1: f64,
    /// PSNR of the background alone, dB.
    pub no_contact_psnr_db: f64,
    /// Mean absolute error of the background alone, grey levels.
    pub no_contact_l1: f64,
    /// Scores of the presses, in the order of the indices.
    #[serde(skip)]
    pub presses: Vec<PressScore>,
}

/// Scores a renderer on some presses of a set. `render` returns the change caused by a contact;
/// [`change_between`] computes it from two images.
///
/// # Errors
/// Those of `render`.
pub fn score(
    set: &PressSet,
    indices: &[usize],
    render: &mut dyn FnMut(&BallContact) -> Result<ChangePlanes>,
) -> Result<Score> {
    let mut presses = Vec::new();
    let (mut error, mut reference) = (0.0, 0.0);
    for index in indices {
        let press = &set.presses[*index];
        let observed = observe(set, press);
        let change = render(&set.contact(press))?;
        let sums = PatchErrors::new(set, press, &observed, Some(&change));
        let nothing = PatchErrors::new(set, press, &observed, None);
        error += sums.square;
        reference += nothing.square;
        presses.push(PressScore {
            file: press.file.clone(),
            fve: 1.0 - sums.square / nothing.square,
            patch_psnr_db: sums.psnr_db(),
            patch_l1: sums.l1(),
            no_contact_psnr_db: nothing.psnr_db(),
            no_contact_l1: nothing.l1(),
        });
    }
    let mean = |value: &dyn Fn(&PressScore) -> f64| {
        presses.iter().map(value).sum::<f64>() / presses.len().max(1) as f64
    };
    Ok(Score {
        fve: mean(&|p| p.fve),
        fve_pooled: 1.0 - error / reference,
        patch_psnr_db: mean(&|p| p.patch_psnr_db),
        patch_l1: mean(&|p| p.patch_l1),
        no_contact_psnr_db: mean(&|p| p.no_contact_psnr_db),
        no_contact_l1: mean(&|p| p.no_contact_l1),
        presses,
    })
}

/// Returns the difference of two images of the same size.
pub fn change_between(pressed: &RgbImage, untouched: &RgbImage) -> ChangePlanes {
    let mut change = planes_of(pressed);
    for (plane, other) in change.iter_mut().zip(planes_of(untouched)) {
        for (value, other) in plane.iter_mut().zip(other) {
            *value -= other;
        }
    }
    change
}

/// Fits the background of a press and returns the change.
pub fn observe(set: &PressSet, press: &LabelledPress) -> ObservedChange {
    let distance = CentreDistance::new(press);
    observe_where(set, &press.image, |i| {
        is_outside(distance.at(i), press.radius_px)
    })
}

/// Whether a pixel at a distance from the centre of a contact is far from it.
pub(super) fn is_outside(distance: f64, radius_px: f64) -> bool {
    distance > radius_px + OUTSIDE_PX
}

/// RMS difference of another no-contact image from that of the set after gain and offset, largest
/// of the channels, grey levels; 0 if the sizes differ.
pub(super) fn background_residual(set: &PressSet, image: &RgbImage) -> f64 {
    if image.dimensions() != set.no_contact.dimensions() {
        return 0.0;
    }
    let observed = observe_where(set, image, |_| true);
    observed.outside_rms.into_iter().fold(0.0, f64::max)
}

/// [`observe`] with the background fitted to selected pixels.
pub(super) fn observe_where(
    set: &PressSet,
    image: &RgbImage,
    chosen: impl Fn(usize) -> bool,
) -> ObservedChange {
    let mut observed = ObservedChange {
        gain: [1.0; 3],
        offset: [0.0; 3],
        change: planes_of(image),
        outside_rms: [0.0; 3],
    };
    let chosen: Vec<usize> = (0..observed.change[0].len())
        .filter(|i| chosen(*i))
        .collect();
    for (channel, untouched) in set.untouched.iter().enumerate() {
        let plane = &mut observed.change[channel];
        let (gain, offset) = fit_line(&chosen, untouched, plane);
        for (value, untouched) in plane.iter_mut().zip(untouched) {
            *value -= (gain * f64::from(*untouched) + offset) as f32;
        }
        let square: f64 = chosen.iter().map(|i| f64::from(plane[*i]).powi(2)).sum();
        observed.outside_rms[channel] = (square / chosen.len().max(1) as f64).sqrt();
        (observed.gain[channel], observed.offset[channel]) = (gain, offset);
    }
    observed
}

/// Least-squares fit y = gain · x + offset over some pixels; (1, mean difference) if x is constant.
fn fit_line(chosen: &[usize], x: &[f32], y: &[f32]) -> (f64, f64) {
    let count = chosen.len().max(1) as f64;
    let mean = |plane: &[f32]| chosen.iter().map(|i| f64::from(plane[*i])).sum::<f64>() / count;
    let (mean_x, mean_y) = (mean(x), mean(y));
    let (mut xx, mut xy) = (0.0, 0.0);
    for i in chosen {
        let dx = f64::from(x[*i]) - mean_x;
        xx += dx * dx;
        xy += dx * (f64::from(y[*i]) - mean_y);
    }
    let gain = if xx > 1e-6 * count { xy / xx } else { 1.0 };
    (gain, mean_y - gain * mean_x)
}

/// Distance of pixels from a contact centre.
#[derive(Clone, Copy, Debug)]
pub(super) struct CentreDistance {
    centre_px: [f64; 2],
    width: usize,
}

impl CentreDistance {
    pub(super) fn new(press: &LabelledPress) -> Self {
        Self {
            centre_px: press.centre_px,
            width: press.image.width() as usize,
        }
    }

    pub(super) fn at(&self, pixel: usize) -> f64 {
        let x = (pixel % self.width) as f64 - self.centre_px[0];
        let y = (pixel / self.width) as f64 - self.centre_px[1];
        x.hypot(y)
    }
}

/// Whether a pixel at a distance lies in the patch of a contact.
pub(super) fn in_patch(distance: f64, radius_px: f64) -> bool {
    distance < radius_px + PATCH_PX
}

/// Sums of errors over a patch.
struct PatchErrors {
    square: f64,
    absolute: f64,
    values: f64,
}

impl PatchErrors {
    fn new(
        set: &PressSet,
        press: &LabelledPress,
        observed: &ObservedChange,
        change: Option<&ChangePlanes>,
    ) -> Self {
        let distance = CentreDistance::new(press);
        let mut sums = Self {
            square: 0.0,
            absolute: 0.0,
            values: 0.0,
        };
        for (i, real) in press.image.pixels().enumerate() {
            if !in_patch(distance.at(i), press.radius_px) {
                continue;
            }
            for (c, real) in real.0.into_iter().enumerate() {
                let background =
                    observed.gain[c] * f64::from(set.untouched[c][i]) + observed.offset[c];
                let change = change.map_or(0.0, |planes| f64::from(planes[c][i]));
                // 8-bit rounding: + 0.5 rounds, the cast saturates.
                let shown = (background + change + 0.5) as u8;
                let error = f64::from(shown) - f64::from(real);
                sums.square += error * error;
                sums.absolute += error.abs();
                sums.values += 1.0;
            }
        }
        sums
    }

    fn l1(&self) -> f64 {
        self.absolute / self.values
    }

    fn psnr_db(&self) -> f64 {
        10.0 * (255.0 * 255.0 * self.values / self.square.max(1e-9)).log10()
    }
}
