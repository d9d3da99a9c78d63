//! Rigid motion of the texture in contact, for gels without markers.

use image::RgbImage;

use crate::ShearFrame;

/// Follows the texture of the contact of one gel.
#[derive(Clone, Debug)]
pub(crate) struct TextureTracker {}

impl TextureTracker {
    pub(crate) fn new(initial: &RgbImage, m_per_px: f64) -> Self {
        let _ = (initial, m_per_px);
        Self {}
    }

    pub(crate) fn update(&mut self, _image: &RgbImage) -> ShearFrame {
        ShearFrame::default()
    }
}
