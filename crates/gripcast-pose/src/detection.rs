//! Detected markers and the detector trait.

use glam::DVec2;
use image::GrayImage;

use gripcast_base::error::Result;

/// A marker detected in an image.
#[derive(Clone, Debug, PartialEq)]
pub struct Detection {
    /// Id in the dictionary.
    pub id: u32,
    /// Outer corners of the black border, px: top left, top right, bottom right, bottom left of the
    /// marker read upright. Pixel (0, 0) is the centre of the top-left pixel.
    pub corners_px: [DVec2; 4],
    /// Number of corrected bits.
    pub hamming: u32,
    /// Decision margin: mean difference of the bits from the threshold, grey levels.
    pub margin: f32,
}

/// Detects markers of one dictionary in grey images.
pub trait MarkerDetector: Send {
    /// Name on the command line.
    fn name(&self) -> &'static str;

    /// Detects the whitelisted markers of an image, sorted by id.
    ///
    /// # Errors
    /// `Input` for an image that is too small or too large.
    fn detect(&mut self, image: &GrayImage) -> Result<Vec<Detection>>;
}
