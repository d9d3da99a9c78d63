//! Interface of the tactile renderers, and the renderer of the paper.

use image::RgbImage;

use super::depth::object_depth;
use super::noise::{Drift, FrameNoise};
use super::press_depth::SensorGeometry;
use super::profile::SensorProfile;
use super::rasteriser::Rasteriser;
use super::renderer::TactileRenderer;
use super::scene::TactileScene;
use gripcast_base::error::Result;
use gripcast_shear::MarkerField;

/// Renders the image that a sensor would take of a scene.
///
/// Renderers reuse buffers between frames: use one per thread.
pub trait SceneRenderer: Send {
    /// Pixel grid of the images.
    fn grid(&self) -> SensorGeometry;

    /// Renders a scene. The seed selects noise and drift, if the renderer has any; `None` disables
    /// them.
    ///
    /// # Errors
    /// `Input` if the scene lacks data that the renderer needs.
    fn render(&mut self, scene: &TactileScene<'_>, seed: Option<u64>) -> Result<RgbImage>;

    /// Returns where the gel markers of a scene are; `None` if the renderer draws none.
    ///
    /// # Errors
    /// As [`SceneRenderer::render`].
    fn marker_field(&mut self, _scene: &TactileScene<'_>) -> Result<Option<MarkerField>> {
        Ok(None)
    }
}

/// Renderer of the paper (§3.2): depth of the object, smoothed and shaded by a sensor profile.
#[derive(Clone, Debug)]
pub struct ObjectDepthRenderer {
    pub(super) shading: TactileRenderer,
    pub(super) drift: Drift,
    pub(super) rasteriser: Rasteriser,
}

impl ObjectDepthRenderer {
    /// Renderer for a sensor profile.
    ///
    /// # Errors
    /// `Config` if the profile is invalid.
    pub fn new(profile: &SensorProfile) -> Result<Self> {
        Ok(Self {
            shading: TactileRenderer::new(profile)?,
            drift: profile.drift,
            rasteriser: Rasteriser::new(),
        })
    }
}

impl SceneRenderer for ObjectDepthRenderer {
    fn grid(&self) -> SensorGeometry {
        self.shading.geometry()
    }

    fn render(&mut self, scene: &TactileScene<'_>, seed: Option<u64>) -> Result<RgbImage> {
        let press = object_depth(scene, &self.grid(), &mut self.rasteriser);
        let noise = noise(&self.drift, seed);
        self.shading.render_with_skin(&press, &scene.skin, &noise)
    }

    fn marker_field(&mut self, scene: &TactileScene<'_>) -> Result<Option<MarkerField>> {
        let press = object_depth(scene, &self.grid(), &mut self.rasteriser);
        self.shading.marker_field(&press, &scene.skin)
    }
}

/// Noise and drift of a seed; none without a seed.
pub(super) fn noise(drift: &Drift, seed: Option<u64>) -> FrameNoise {
    seed.map_or_else(FrameNoise::default, |seed| drift.sample(seed))
}
