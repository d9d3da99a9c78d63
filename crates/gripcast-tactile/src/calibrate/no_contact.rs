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
