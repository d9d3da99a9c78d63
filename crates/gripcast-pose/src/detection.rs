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

impl Detection {
    /// Mean of the corners, px.
    #[must_use]
    pub fn center_px(&self) -> DVec2 {
        0.25 * self.corners_px.iter().sum::<DVec2>()
    }

    /// Lengths of the sides, px: top, right, bottom, left.
    #[must_use]
    pub fn sides_px(&self) -> [f64; 4] {
        [0, 1, 2, 3].map(|k| self.corners_px[k].distance(self.corners_px[(k + 1) % 4]))
    }

    /// Length of the shortest side, px.
    #[must_use]
    pub fn min_side_px(&self) -> f64 {
        self.sides_px().into_iter().fold(f64::INFINITY, f64::min)
    }
}

/// Detects markers of one dictionary in grey images.
pub trait MarkerDetector: Send {
    /// Name on the command line.
    fn name(&self) -> &'static str;

    /// Detects the whitelisted markers of an image, sorted by id. An id is listed as often as it is
    /// in the image.
    ///
    /// # Errors
    /// `Input` for an image that is too small or too large.
    fn detect(&mut self, image: &GrayImage) -> Result<Vec<Detection>>;
}
