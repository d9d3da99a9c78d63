//! Interface of the tactile renderers, and the renderer of the paper.

use image::RgbImage;

use super::depth::object_depth;
use super::markers::{LayerMotion, NodeMotion};
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
}

impl SceneRenderer for ObjectDepthRenderer {
    fn grid(&self) -> SensorGeometry {
        self.shading.geometry()
    }

    fn render(&mut self, scene: &TactileScene<'_>, seed: Option<u64>) -> Result<RgbImage> {
        let press = object_depth(scene, &self.grid(), &mut self.rasteriser);
        self.render_press(&press, scene, seed)
    }

    fn marker_field(&mut self, scene: &TactileScene<'_>) -> Result<Option<MarkerField>> {
        if self.shading.markers().is_none() {
            return Ok(None);
        }
        let press = object_depth(scene, &self.grid(), &mut self.rasteriser);
        let motion = self.skin_motion(&press, &scene.skin)?;
        let lattice = self.shading.markers();
        Ok(lattice.map(|lattice| lattice.field(&|at| motion.displacement_m(at))))
    }
}

impl ObjectDepthRenderer {
    /// Renders the depth of a scene.
    pub(super) fn render_press(
        &mut self,
        press: &PressDepth,
        scene: &TactileScene<'_>,
        seed: Option<u64>,
    ) -> Result<RgbImage> {
        let noise = noise(&self.drift, seed);
        if self.shading.markers().is_none() {
            return self.shading.render(press, &noise);
        }
        let motion = self.skin_motion(press, &scene.skin)?;
        self.shading
            .render_moved(press, &noise, &|at| motion.displacement_m(at))
    }

    fn skin_motion<'a>(&mut self, press: &PressDepth, skin: &'a Skin) -> Result<Motion<'a>> {
        Ok(match skin {
            Skin::Nodes(nodes) => Motion::Nodes(nodes),
            Skin::Layer(load) => Motion::Layer(self.shading.layer_motion(press, load)?),
        })
    }
}

/// Motion of the skin of a scene.
enum Motion<'a> {
    Nodes(&'a NodeMotion),
    Layer(LayerMotion),
}

impl Motion<'_> {
    fn displacement_m(&self, at_m: [f64; 2]) -> [f64; 2] {
        match self {
            Self::Nodes(nodes) => nodes.displacement_m(at_m),
            Self::Layer(layer) => layer.displacement_m(at_m),
        }
    }
}

/// Noise and drift of a seed; none without a seed.
pub(super) fn noise(drift: &Drift, seed: Option<u64>) -> FrameNoise {
    seed.map_or_else(FrameNoise::default, |seed| drift.sample(seed))
}
