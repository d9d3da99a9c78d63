//! Finds a contact in the image that should show the untouched gel.
//!
//! Such a contact is missing from all presses, so that their changes agree at one place far from
//! their own contacts. It cannot be found if all presses lie at that place.

use super::press_set::PressSet;
use super::score::{CentreDistance, is_outside, observe};
use crate::ensure;
use gripcast_base::error::{Error, Result};

/// Side of a block, px.
const BLOCK: usize = 16;
/// Largest mean change of a block that all presses share, grey levels: 4 on real presses.
const MAX_SHARED: f64 = 15.0;
/// Minimum number of presses that see a pixel untouched.
const MIN_PRESSES: usize = 2;

/// # Errors
/// `Input` if the no-contact image shows a contact.
pub(super) fn check_no_contact(set: &PressSet) -> Result<()> {
    let (width, height) = (set.geometry.width, set.geometry.height);
    let mut sums = vec![[0.0; 3]; width * height];
    let mut counts = vec![0_usize; width * height];
    for press in &set.presses {
        let distance = CentreDistance::new(press);
        let change = observe(set, press).change;
        for (i, (sum, count)) in sums.iter_mut().zip(&mut counts).enumerate() {
            if is_outside(distance.at(i), press.radius_px) {
                for (sum, plane) in sum.iter_mut().zip(&change) {
                    *sum += f64::from(plane[i]);
                }
                *count += 1;
            }
        }
    }
    let mut largest = (0.0, [0, 0]);
    for y in (0..height.saturating_sub(BLOCK)).step_by(BLOCK) {
        for x in (0..width.saturating_sub(BLOCK)).step_by(BLOCK) {
            let pixels = (0..BLOCK * BLOCK).map(|k| (y + k / BLOCK) * width + x + k % BLOCK);
            let seen: Vec<usize> = pixels.filter(|i| counts[*i] >= MIN_PRESSES).collect();
            if seen.len() < BLOCK * BLOCK / 2 {
                continue;
            }
            for channel in 0..3 {
                let total: f64 = seen
                    .iter()
                    .map(|i| sums[*i][channel] / counts[*i] as f64)
                    .sum();
                let shared = (total / seen.len() as f64).abs();
                if shared > largest.0 {
                    largest = (shared, [x + BLOCK / 2, y + BLOCK / 2]);
                }
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
