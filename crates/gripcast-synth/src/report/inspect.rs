//! Inspects the images of a simulation: change by the contact, and thumbnails.

use image::{RgbImage, imageops};

use super::facts::ExampleImages;
use super::results::FinishedSimulation;
use crate::store::ResultStore;
use gripcast_base::error::{Error, Result};
use gripcast_base::random::SeedStream;
use gripcast_dataset::shard::{ShardImages, ShardRow};
use gripcast_imaging::{Decoder, TactileDifference};
use gripcast_report::image::data_uri;

/// Width of the thumbnails, px.
const THUMBNAIL_PX: u32 = 160;
/// Amplification of the shown change.
const GAIN: f32 = 2.0;
/// Minimum change of a changed pixel, grey levels; noise between two images is below.
pub(super) const CHANGED_LEVELS: u16 = 10;
/// Minimum fraction of changed pixels of a pair with contact: about 40 of 320 × 240 px, a square of
/// half a millimetre.
pub(super) const MIN_CHANGED: f64 = 5e-4;

/// Change of the tactile images of one rendering.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct TactileChange {
    pub(super) rendering: u32,
    pub(super) appearance: String,
    /// Mean absolute change of the left and the right tactile image, grey levels.
    pub(super) mean_change: [f64; 2],
    /// Fraction of pixels that changed.
    pub(super) changed: [f64; 2],
    /// Thumbnails, if requested.
    pub(super) images: Option<ExampleImages>,
}

/// Inspects one rendering, drawn by the seed, of a result with images.
///
/// # Errors
/// `Input` for images that are damaged or belong to another result; I/O errors.
pub(super) fn inspect(
    store: &ResultStore,
    done: &FinishedSimulation<'_>,
    seed: u64,
    with_thumbnails: bool,
) -> Result<TactileChange> {
    let id = &done.simulation.id;
    let rows = store.rows(&done.result)?;
    let mut draw = SeedStream::named(seed, &format!("rendering of {id}"));
    let row = rows.get(draw.index(rows.len().max(1)));
    let row = row.ok_or_else(|| Error::input("the result has no rendering"));
    row.and_then(|row| change_of(row, with_thumbnails))
        .map_err(|e| e.at(store.samples(id).display()))
}

fn change_of(row: &ShardRow, with_thumbnails: bool) -> Result<TactileChange> {
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
    let images = if with_thumbnails {
        Some(ExampleImages {
            colour: thumbnail(&image(grasp_rgb)?)?,
            grasp: [thumbnail(&grasp[0])?, thumbnail(&grasp[1])?],
            change: [
                thumbnail(&change[0].to_image(GAIN))?,
                thumbnail(&change[1].to_image(GAIN))?,
            ],
        })
    } else {
        None
    };
    Ok(TactileChange {
        rendering: row.facts.rendering,
        appearance: row.facts.appearance.clone(),
        mean_change: [0, 1].map(|k| f64::from(change[k].mean_abs())),
        changed: [0, 1].map(|k| f64::from(change[k].changed_fraction(CHANGED_LEVELS))),
        images,
    })
}

/// Encodes a thumbnail as a data URI.
fn thumbnail(image: &RgbImage) -> Result<String> {
    let (width, height) = image.dimensions();
    let shown = THUMBNAIL_PX.min(width);
    let rows = (u64::from(height) * u64::from(shown)).div_ceil(u64::from(width.max(1)));
    let rows = u32::try_from(rows.max(1)).unwrap_or(THUMBNAIL_PX);
    data_uri(&imageops::thumbnail(image, shown, rows))
}
