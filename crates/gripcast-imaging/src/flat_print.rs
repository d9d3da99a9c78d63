//! A flat printed image in space.

use image::GrayImage;

/// A flat printed image, as a sheet or a card carries it.
#[derive(Clone, Debug)]
pub struct FlatPrint {
    /// The fraction of each pixel that is bare paper, 255 for all of it.
    pub paper: GrayImage,
    /// Top left, top right, bottom right, bottom left corner as seen from the front, m.
    pub corners_m: [[f64; 3]; 4],
}
