//! What all tactile renderers offer.

use image::RgbImage;

use super::press_depth::SensorGeometry;
use super::scene::TactileScene;
use crate::error::Result;

/// Makes the picture that a sensor would take of a scene.
///
/// A renderer keeps buffers between frames: threads take one each.
pub trait SceneRenderer: Send {
    /// Its name on the command line.
    fn name(&self) -> &'static str;

    /// Pixel grid of its pictures.
    fn grid(&self) -> &SensorGeometry;

    /// The picture of a scene; noise and drift, where it has any, follow from the seed.
    ///
    /// # Errors
    /// `Input` where the scene lacks what the renderer needs.
    fn render(&mut self, scene: &TactileScene<'_>, seed: u64) -> Result<RgbImage>;
}
