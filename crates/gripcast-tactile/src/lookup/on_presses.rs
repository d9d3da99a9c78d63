//! Fits a lookup table to calibration presses.

use super::{BallPress, LookupRenderer, TaximTable};
use crate::calibrate::{PressSet, observe};
use gripcast_base::error::Result;

/// Bins of a table along each axis, as in Taxim.
const BINS: usize = 125;

/// Renderer on the no-contact image of a set, its table fitted to some of the presses.
///
/// # Errors
/// `Input` if no index is given or a contact lies outside the image.
pub fn fit_to_presses(set: &PressSet, indices: &[usize]) -> Result<LookupRenderer> {
    let changes: Vec<Vec<[f32; 3]>> = indices
        .iter()
        .map(|index| {
            let [red, green, blue] = observe(set, &set.presses[*index]).change;
            let pixels = red.iter().zip(&green).zip(&blue);
            pixels.map(|((r, g), b)| [*r, *g, *b]).collect()
        })
        .collect();
    let presses: Vec<BallPress<'_>> = indices
        .iter()
        .zip(&changes)
        .map(|(index, change)| BallPress {
            change,
            center_px: set.presses[*index].centre_px,
            contact_radius_px: set.presses[*index].radius_px,
            ball_radius_px: set.ball_m / set.geometry.pixel_m,
        })
        .collect();
    let table = TaximTable::fit(&presses, [set.geometry.width, set.geometry.height], BINS)?;
    LookupRenderer::new(set.geometry, set.no_contact.clone(), table)
}
