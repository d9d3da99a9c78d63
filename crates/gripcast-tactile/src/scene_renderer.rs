//! What all tactile renderers offer, and the one of the paper.

use image::RgbImage;

use super::depth::object_depth;
use super::noise::{Drift, FrameNoise};
use super::press_depth::SensorGeometry;
use super::profile::SensorProfile;
use super::rasteriser::Rasteriser;
use super::renderer::TactileRenderer;
use super::scene::TactileScene;
use gripcast_base::error::Result;

/// Makes the image that a sensor would take of a scene.
///
/// A renderer keeps buffers between frames: each thread takes its own.
pub trait SceneRenderer: Send {
    /// Its name on the command line.
    fn name(&self) -> &'static str;

    /// Pixel grid of its images.
    fn grid(&self) -> SensorGeometry;

    /// The image of a scene. Noise and drift, where the renderer has any, follow from the seed;
    /// without one there are none.
    ///
    /// # Errors
    /// `Input` where the scene lacks what the renderer needs.
    fn render(&mut self, scene: &TactileScene<'_>, seed: Option<u64>) -> Result<RgbImage>;
}

/// The paper's renderer (§3.2): depth of the object itself, smoothed and shaded by a sensor's
/// profile.
#[derive(Clone, Debug)]
pub struct ObjectDepthRenderer {
    shading: TactileRenderer,
    drift: Drift,
    rasteriser: Rasteriser,
}

impl ObjectDepthRenderer {
    /// A renderer of a sensor's images.
    ///
    /// # Errors
    /// `Config` if the profile is not valid.
    pub fn new(profile: &SensorProfile) -> Result<Self> {
        Ok(Self {
            shading: TactileRenderer::new(profile)?,
            drift: profile.drift,
            rasteriser: Rasteriser::new(),
        })
    }
}

impl SceneRenderer for ObjectDepthRenderer {
    fn name(&self) -> &'static str {
        "object-depth"
    }

    fn grid(&self) -> SensorGeometry {
        self.shading.geometry()
    }

    fn render(&mut self, scene: &TactileScene<'_>, seed: Option<u64>) -> Result<RgbImage> {
        let press = object_depth(scene, &self.grid(), &mut self.rasteriser);
        self.shading.render(&press, &noise(&self.drift, seed))
    }
}

/// Drift and noise of a seed; none without one.
pub(super) fn noise(drift: &Drift, seed: Option<u64>) -> FrameNoise {
    seed.map_or_else(FrameNoise::default, |seed| drift.sample(seed))
}
