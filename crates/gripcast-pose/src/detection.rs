//! What detectors find.

use glam::DVec2;
use image::GrayImage;

use gripcast_base::error::Result;

/// A marker found in an image.
#[derive(Clone, Debug, PartialEq)]
pub struct Detection {
    /// Its number in the dictionary.
    pub id: u32,
    /// Outer corners of its black border, px: top left, top right, bottom right, bottom left as
    /// read upright. Pixel (0, 0) is the centre of the top-left pixel.
    pub corners_px: [DVec2; 4],
    /// Bits that had to be corrected.
    pub hamming: u32,
    /// How clearly the bits differ from the threshold, grey levels.
    pub margin: f32,
}

/// Finds markers of one dictionary in grey images.
pub trait MarkerDetector: Send {
    /// Its name on the command line.
    fn name(&self) -> &'static str;

    /// All markers of an image, by id. Ids outside of the whitelist given at construction are
    /// not reported.
    ///
    /// # Errors
    /// `Input` for an image that is too small or too large.
    fn detect(&mut self, image: &GrayImage) -> Result<Vec<Detection>>;
}
