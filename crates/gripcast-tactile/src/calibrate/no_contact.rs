//! Finds a contact in the image that should show the untouched gel.
//!
//! Such a contact is missing from all presses, so that their changes agree at one place far from
//! their own contacts. It cannot be found if all presses lie at that place.

use super::press_set::{LabelledPress, PressSet};
use super::score::{CentreDistance, ChangePlanes, is_outside, observe};
use crate::ensure;
use gripcast_base::error::{Error, Result};

/// Side of a block, px.
const BLOCK: usize = 16;
/// Largest change of a block that all presses share, grey levels: 13 on real presses, 33 or more
/// with one of them in place of the no-contact image.
const MAX_SHARED: f64 = 22.0;
/// Minimum number of presses that see a block untouched.
const MIN_PRESSES: usize = 2;

/// # Errors
/// `Input` if the no-contact image shows a contact.
pub(super) fn check_no_contact(set: &PressSet) -> Result<()> {
    let (width, height) = (set.geometry.width, set.geometry.height);
    let presses: Vec<(&LabelledPress, ChangePlanes)> = set
        .presses
        .iter()
        .map(|press| (press, observe(set, press).change))
        .collect();
    let mut largest = (0.0, [0, 0]);
    for y in (0..height.saturating_sub(BLOCK)).step_by(BLOCK) {
        for x in (0..width.saturating_sub(BLOCK)).step_by(BLOCK) {
            let pixels = (0..BLOCK * BLOCK).map(|k| (y + k / BLOCK) * width + x + k % BLOCK);
            let pixels: Vec<usize> = pixels.collect();
            let untouched = presses.iter().filter(|(press, _)| {
                let distance = CentreDistance::new(press);
                let mut all = pixels.iter();
                all.all(|i| is_outside(distance.at(*i), press.radius_px))
            });
            let changes: Vec<[f64; 3]> = untouched
                .map(|(_, change)| block_mean(change, &pixels))
                .collect();
            let shared = shared_change(&changes);
            if shared > largest.0 {
                largest = (shared, [x + BLOCK / 2, y + BLOCK / 2]);
            }
        }
    }
    let (shared, [x, y]) = largest;
    ensure(shared <= MAX_SHARED, || {
        Error::input(format!(
            "all presses differ from the no-contact image by {shared:.0} grey levels near column \
             {x}, row {y}, far from their contacts: it shows a contact or other light"
        ))
        .remedy("give an image of the untouched gel, taken under the light of the presses")
    })
}

/// Mean change of a block per channel.
fn block_mean(change: &ChangePlanes, pixels: &[usize]) -> [f64; 3] {
    std::array::from_fn(|c| {
        let values = pixels.iter().map(|i| f64::from(change[c][*i]));
        values.sum::<f64>() / pixels.len() as f64
    })
}

/// Largest change of a channel that all presses have at least, with one sign; 0 for few presses.
fn shared_change(changes: &[[f64; 3]]) -> f64 {
    if changes.len() < MIN_PRESSES {
        return 0.0;
    }
    let of_channel = |c: usize| {
        let lowest = changes.iter().map(|v| v[c]).fold(f64::INFINITY, f64::min);
        let highest = changes
            .iter()
            .map(|v| v[c])
            .fold(f64::NEG_INFINITY, f64::max);
        lowest.max(-highest)
    };
    (0..3).map(of_channel).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use image::{Rgb, RgbImage};

    use super::super::press_set::test_set;
    use super::*;
    use crate::SensorGeometry;

    /// An image without contact, or with a square that is darker by `depth`.
    fn gel(depth: u8) -> RgbImage {
        RgbImage::from_fn(320, 240, |x, y| {
            let level = 90 + (x / 8) as u8 + (y / 8) as u8;
            let is_dark = (160..192).contains(&x) && (96..128).contains(&y);
            Rgb([level, level - if is_dark { depth } else { 0 }, level])
        })
    }

    /// A set of presses that show only the gel, with contacts stated at `centres`.
    fn set(no_contact: RgbImage, centres: &[[f64; 2]]) -> PressSet {
        let geometry = SensorGeometry {
            width: 320,
            height: 240,
            pixel_m: 6e-5,
            gel_thickness_m: 4e-3,
        };
        let press = |(index, centre_px): (usize, &[f64; 2])| LabelledPress {
            number: index + 1,
            file: format!("{index}.png"),
            sha256: String::new(),
            image: gel(0),
            centre_px: *centre_px,
            radius_px: 20.0,
            is_detected: false,
        };
        let presses = centres.iter().enumerate().map(press).collect();
        test_set(geometry, 2e-3, no_contact, presses)
    }

    #[test]
    fn contact_in_the_no_contact_image_is_found() {
        let spread = [[40.0, 40.0], [280.0, 200.0], [60.0, 200.0]];
        assert!(check_no_contact(&set(gel(0), &spread)).is_ok());
        // Less than the bulge of real gels around other presses.
        assert!(check_no_contact(&set(gel(15), &spread)).is_ok());
        let text = check_no_contact(&set(gel(40), &spread))
            .unwrap_err()
            .to_string();
        assert!(text.contains("column 184, row 120"), "{text}");
        // It cannot be told from the presses' own contacts.
        assert!(check_no_contact(&set(gel(40), &[[176.0, 112.0]; 3])).is_ok());
    }
}
