//! Interface of the tactile renderers, and the renderer of the paper.

use image::RgbImage;

use super::depth::object_depth;
use super::noise::{Drift, FrameNoise};
use super::press_depth::{PressDepth, SensorGeometry};
use super::profile::SensorProfile;
use super::rasteriser::Rasteriser;
use super::renderer::TactileRenderer;
use super::scene::{Skin, TactileScene};
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

    /// Depth of the object of a scene in the gel.
    pub fn press(&mut self, scene: &TactileScene<'_>) -> PressDepth {
        object_depth(scene, &self.shading.geometry(), &mut self.rasteriser)
    }

    /// As [`SceneRenderer::render`], of a scene's [`Self::press`] and skin.
    ///
    /// # Errors
    /// `Input` if the press is on another grid.
    pub fn render_press(
        &mut self,
        press: &PressDepth,
        skin: &Skin,
        seed: Option<u64>,
    ) -> Result<RgbImage> {
        let noise = noise(&self.drift, seed);
        self.shading.render_with_skin(press, skin, &noise)
    }

    /// As [`SceneRenderer::marker_field`], of a scene's [`Self::press`] and skin.
    ///
    /// # Errors
    /// `Input` if the press is on another grid.
    pub fn marker_field_of(
        &mut self,
        press: &PressDepth,
        skin: &Skin,
    ) -> Result<Option<MarkerField>> {
        self.shading.marker_field(press, skin)
    }
}

impl SceneRenderer for ObjectDepthRenderer {
    fn grid(&self) -> SensorGeometry {
        self.shading.geometry()
    }

    fn render(&mut self, scene: &TactileScene<'_>, seed: Option<u64>) -> Result<RgbImage> {
        let press = self.press(scene);
        self.render_press(&press, &scene.skin, seed)
    }

    fn marker_field(&mut self, scene: &TactileScene<'_>) -> Result<Option<MarkerField>> {
        let press = self.press(scene);
        self.marker_field_of(&press, &scene.skin)
    }
}

/// Noise and drift of a seed; none without a seed.
pub(super) fn noise(drift: &Drift, seed: Option<u64>) -> FrameNoise {
    seed.map_or_else(FrameNoise::default, |seed| drift.sample(seed))
}
