//! Posed printed images.

use image::GrayImage;

/// A printed sheet or card at a pose.
#[derive(Clone, Debug)]
pub struct FlatPrint {
    /// Unprinted fraction of each pixel, times 255.
    pub paper: GrayImage,
    /// Top left, top right, bottom right, bottom left corner from the front, m.
    pub corners_m: [[f64; 3]; 4],
}
