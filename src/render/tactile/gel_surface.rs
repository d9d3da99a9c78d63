//! The picture of the deformed gel's own mesh, to compare with: what Taccel's built-in renderer
//! looks at (Li et al. 2025).
//!
//! Rays meet the flat triangles of the gel's face, so each triangle of the mesh has one normal and
//! shows as a flat patch, and the face sinks beyond the contact. Colours are those of the sensor's
//! profile; Taccel's own are a neural network of another sensor.

use image::RgbImage;

use super::depth::gel_surface_depth;
use super::noise::Drift;
use super::press_depth::SensorGeometry;
use super::profile::SensorProfile;
use super::rasteriser::Rasteriser;
use super::renderer::TactileRenderer;
use super::scene::TactileScene;
use super::scene_renderer::{SceneRenderer, look};
use super::smooth::Smoothing;
use crate::error::{Error, ErrorKind, Result};

/// Renders the deformed face of the gel, without smoothing.
#[derive(Clone, Debug)]
pub struct GelSurfaceRenderer {
    shading: TactileRenderer,
    drift: Drift,
    rasteriser: Rasteriser,
}

impl GelSurfaceRenderer {
    /// A renderer with the colours of a sensor's profile.
    ///
    /// # Errors
    /// `Config` if the profile is not valid.
    pub fn new(profile: &SensorProfile) -> Result<Self> {
        let unsmoothed = SensorProfile {
            smoothing: Smoothing::default(),
            ..profile.clone()
        };
        Ok(Self {
            shading: TactileRenderer::new(&unsmoothed)?,
            drift: profile.drift,
            rasteriser: Rasteriser::new(),
        })
    }
}

impl SceneRenderer for GelSurfaceRenderer {
    fn name(&self) -> &'static str {
        "gel-surface"
    }

    fn grid(&self) -> SensorGeometry {
        self.shading.geometry()
    }

    fn render(&mut self, scene: &TactileScene<'_>, seed: Option<u64>) -> Result<RgbImage> {
        let grid = self.grid();
        let press = gel_surface_depth(scene, &grid, &mut self.rasteriser).ok_or_else(|| {
            Error::new(
                ErrorKind::Input,
                "the gel-surface renderer needs the deformed gel, which this scene does not have",
            )
            .remedy("render the end of a stage of a simulated grasp")
        })?;
        self.shading.render(&press, &look(&self.drift, seed))
    }
}
