//! Looks at the images of a simulation: what its contact changed, and small copies.

use image::{RgbImage, imageops};

use super::facts::ExampleImages;
use super::gather::Done;
use crate::store::ResultStore;
use gripcast_base::error::{Error, Result};
use gripcast_base::random::SeedStream;
use gripcast_dataset::shard::{ShardImages, ShardRow};
use gripcast_imaging::{Decoder, TactileDifference};
use gripcast_report::image::data_uri;

/// Columns of the small images.
const SHOWN_PX: u32 = 160;
/// Grey levels shown for each level of change.
const GAIN: f32 = 2.0;
/// Above this a pixel has changed, grey levels: noise between two images stays below.
pub(super) const CHANGED_LEVELS: u16 = 10;
/// A pair with a smaller fraction of changed pixels shows no contact: about 40 of 320 × 240, what a
/// square of half a millimetre covers.
pub(super) const MIN_CHANGED: f64 = 5e-4;

/// What was seen in a rendering of a simulation.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Look {
    pub(super) rendering: u32,
    pub(super) appearance: String,
    /// Mean absolute change of the left and the right tactile image, grey levels.
    pub(super) mean_change: [f64; 2],
    /// Fraction of pixels that changed.
    pub(super) changed: [f64; 2],
    /// Small copies, where they were asked for.
    pub(super) images: Option<ExampleImages>,
}

/// Looks at one rendering, drawn from the seed, of a result with images.
///
/// # Errors
/// `Input` for images that are damaged or not those of the result; those of the operating system.
pub(super) fn look(
    store: &ResultStore,
    done: &Done<'_>,
    seed: u64,
    is_shown: bool,
) -> Result<Look> {
    let id = &done.simulation.id;
    let rows = store.rows(&done.result)?;
    let mut draw = SeedStream::named(seed, &format!("rendering of {id}"));
    let row = rows.get(draw.index(rows.len().max(1)));
    let row = row.ok_or_else(|| Error::input("there is no rendering"));
    row.and_then(|row| seen(row, is_shown))
        .map_err(|e| e.at(store.samples(id).display()))
}

fn seen(row: &ShardRow, is_shown: bool) -> Result<Look> {
    let ShardImages {
        initial_left,
        initial_right,
        grasp_left,
        grasp_right,
        grasp_rgb,
        ..
    } = &row.images;
    let mut decoder = Decoder::new()?;
    let mut image = |bytes: &[u8]| decoder.stored_image(bytes);
    let grasp = [image(grasp_left)?, image(grasp_right)?];
    let change = [
        TactileDifference::between(&image(initial_left)?, &grasp[0])?,
        TactileDifference::between(&image(initial_right)?, &grasp[1])?,
    ];
    let images = match is_shown {
        true => Some(ExampleImages {
            colour: small(&image(grasp_rgb)?)?,
            grasp: [small(&grasp[0])?, small(&grasp[1])?],
            change: [
                small(&change[0].to_image(GAIN))?,
                small(&change[1].to_image(GAIN))?,
            ],
        }),
        false => None,
    };
    Ok(Look {
        rendering: row.facts.rendering,
        appearance: row.facts.appearance.clone(),
        mean_change: [0, 1].map(|k| f64::from(change[k].mean_abs())),
        changed: [0, 1].map(|k| f64::from(change[k].changed_fraction(CHANGED_LEVELS))),
        images,
    })
}

/// A small copy as a data URI.
fn small(image: &RgbImage) -> Result<String> {
    let (width, height) = image.dimensions();
    let shown = SHOWN_PX.min(width);
    let rows = (u64::from(height) * u64::from(shown)).div_ceil(u64::from(width.max(1)));
    let rows = u32::try_from(rows.max(1)).unwrap_or(SHOWN_PX);
    data_uri(&imageops::thumbnail(image, shown, rows))
}
