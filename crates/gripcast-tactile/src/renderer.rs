//! Renders the sensor image of a press.

use image::RgbImage;

use super::background::planes_of;
use super::markers::{
    ContactLoad, ElasticLayer, LayerMotion, MarkerInk, MarkerLattice, NodeMotion,
};
use super::noise::{FrameNoise, pixel_noise};
use super::normals::Normals;
use super::press_depth::{PressDepth, SensorGeometry};
use super::profile::{SensorProfile, ShadingModel};
use super::scene::Skin;
use super::smooth::Smoother;
use gripcast_base::error::{Error, Result};
use gripcast_shear::MarkerField;

/// Pixels composed together.
const LANES: usize = 32;
/// Relative tolerance of pixel sizes.
const SAME_PIXEL: f64 = 1e-6;

/// Renders images of one sensor on one thread; buffers are reused between frames.
#[derive(Clone, Debug)]
pub struct TactileRenderer {
    geometry: SensorGeometry,
    smoother: Smoother,
    normals: Normals,
    shading: ShadingModel,
    noise_std: [f32; 3],
    layer: ElasticLayer,
    markers: Option<MarkerInk>,
    untouched: [Vec<f32>; 3],
    change: [Vec<f32>; 3],
}

impl TactileRenderer {
    /// Prepares a sensor.
    ///
    /// # Errors
    /// `Config` if the profile is invalid.
    pub fn new(profile: &SensorProfile) -> Result<Self> {
        profile.validate()?;
        let geometry = profile.geometry;
        let untouched = match &profile.background.image {
            Some(image) => planes_of(image),
            None => profile
                .background
                .fit
                .planes(geometry.width, geometry.height),
        };
        Ok(Self {
            geometry,
            smoother: Smoother::new(&profile.smoothing, geometry.pixel_m),
            normals: Normals::default(),
            shading: profile.shading.clone(),
            noise_std: profile.noise_std.map(|v| v as f32),
            layer: profile.gel.layer(geometry.gel_thickness_m),
            markers: profile.markers.as_ref().map(|pattern| {
                MarkerInk::new(pattern, &geometry, &profile.shading, profile.gel_seed())
            }),
            untouched,
            change: std::array::from_fn(|_| Vec::new()),
        })
    }

    /// Pixel grid, scale and gel of the images.
    pub fn geometry(&self) -> SensorGeometry {
        self.geometry
    }

    /// The gel markers at rest; `None` for a gel without.
    pub fn markers(&self) -> Option<&MarkerLattice> {
        self.markers.as_ref().map(|ink| &ink.lattice)
    }

    /// Returns the change of the image caused by a press, grey levels: red, green and blue planes
    /// of `width * height`, neither rounded nor clipped. Gel markers are not part of it.
    ///
    /// # Errors
    /// `Input` if the press is on another grid.
    pub fn change(&mut self, press: &PressDepth) -> Result<&[Vec<f32>; 3]> {
        self.check(press)?;
        let height_m = self.smoother.smooth(press);
        self.normals.compute(height_m, &self.geometry);
        for plane in &mut self.change {
            plane.clear();
            plane.resize(press.depth_m.len(), 0.0);
        }
        match &self.shading {
            ShadingModel::Polynomial(s) => {
                self.normals.limit_slope(s.steepest as f32);
                s.add(&self.geometry, &self.normals, &mut self.change);
            }
            ShadingModel::Leds(s) => s.add(&self.geometry, &self.normals, &mut self.change),
        }
        Ok(&self.change)
    }

    /// Models how a press under a tangential load moves the skin.
    ///
    /// # Errors
    /// `Input` if the press is on another grid.
    pub fn layer_motion(&mut self, press: &PressDepth, load: &ContactLoad) -> Result<LayerMotion> {
        self.check(press)?;
        let face_m = self.smoother.smooth(press);
        Ok(LayerMotion::new(face_m, press, &self.layer, load))
    }

    /// Renders the sensor image of a press, 8 bits per channel. Gel markers move as in a
    /// [`LayerMotion`] without load.
    ///
    /// # Errors
    /// `Input` if the press is on another grid.
    pub fn render(&mut self, press: &PressDepth, noise: &FrameNoise) -> Result<RgbImage> {
        self.render_with_skin(press, &Skin::default(), noise)
    }

    /// Renders the sensor image of a press, 8 bits per channel, with gel markers that move with a
    /// skin.
    ///
    /// # Errors
    /// `Input` if the press is on another grid.
    pub fn render_with_skin(
        &mut self,
        press: &PressDepth,
        skin: &Skin,
        noise: &FrameNoise,
    ) -> Result<RgbImage> {
        if self.markers.is_none() {
            return self.render_moved(press, noise, &|_| [0.0; 2]);
        }
        let motion = self.skin_motion(press, skin)?;
        self.render_moved(press, noise, &|at| motion.displacement_m(at))
    }

    /// Returns where the gel markers truly are in [`Self::render_with_skin`]; `None` for a gel
    /// without.
    ///
    /// # Errors
    /// `Input` if the press is on another grid.
    pub fn marker_field(&mut self, press: &PressDepth, skin: &Skin) -> Result<Option<MarkerField>> {
        if self.markers.is_none() {
            return Ok(None);
        }
        let motion = self.skin_motion(press, skin)?;
        let lattice = self.markers();
        Ok(lattice.map(|lattice| lattice.field(&|at| motion.displacement_m(at))))
    }

    fn skin_motion<'a>(&mut self, press: &PressDepth, skin: &'a Skin) -> Result<Motion<'a>> {
        Ok(match skin {
            Skin::Nodes(nodes) => Motion::Nodes(nodes),
            Skin::Layer(load) => Motion::Layer(self.layer_motion(press, load)?),
        })
    }

    /// Renders the sensor image of a press whose skin moves from a point at rest by `motion`, both m
    /// in the sensor frame, and returns where the gel markers truly are.
    ///
    /// # Errors
    /// `Input` if the press is on another grid; `Config` if the profile has no gel markers.
    pub fn render_with_markers(
        &mut self,
        press: &PressDepth,
        noise: &FrameNoise,
        motion: &dyn Fn([f64; 2]) -> [f64; 2],
    ) -> Result<(RgbImage, MarkerField)> {
        let Some(ink) = &self.markers else {
            return Err(no_markers());
        };
        let field = ink.lattice.field(motion);
        Ok((self.render_moved(press, noise, motion)?, field))
    }

    /// Renders the sensor image of a press whose skin moves.
    fn render_moved(
        &mut self,
        press: &PressDepth,
        noise: &FrameNoise,
        motion: &dyn Fn([f64; 2]) -> [f64; 2],
    ) -> Result<RgbImage> {
        self.change(press)?;
        if let Some(ink) = &mut self.markers {
            ink.dim(motion, &self.untouched, &mut self.change);
        }
        let mut image = RgbImage::new(self.geometry.width as u32, self.geometry.height as u32);
        self.compose(noise, &mut image);
        Ok(image)
    }

    /// Writes gain · (untouched + change) + offset + noise, rounded.
    fn compose(&self, noise: &FrameNoise, image: &mut RgbImage) {
        // + 0.5 rounds; the cast saturates at 0 and 255.
        let offset = noise.offset.map(|v| v + 0.5);
        let mut draws = [[0.0f32; LANES]; 3];
        for (block, pixels) in image.chunks_mut(3 * LANES).enumerate() {
            let first = block * LANES;
            let count = pixels.len() / 3;
            if let Some(seed) = noise.noise_seed {
                let [reds, greens, blues] = &mut draws;
                let lanes = reds.iter_mut().zip(greens).zip(blues);
                for (lane, ((red, green), blue)) in lanes.enumerate() {
                    [*red, *green, *blue] = pixel_noise(seed, first + lane);
                }
            }
            for (channel, draws) in draws.iter().enumerate() {
                let (gain, offset) = (noise.gain[channel], offset[channel]);
                let std = self.noise_std[channel];
                let untouched = &self.untouched[channel][first..first + count];
                let change = &self.change[channel][first..first + count];
                let light = untouched.iter().zip(change).zip(draws);
                let levels = pixels[channel..].iter_mut().step_by(3);
                for (level, ((untouched, change), draw)) in levels.zip(light) {
                    *level = (gain * (untouched + change) + offset + std * draw) as u8;
                }
            }
        }
    }

    fn check(&self, press: &PressDepth) -> Result<()> {
        let (ours, theirs) = (&self.geometry, &press.geometry);
        let same_pixel = (ours.pixel_m - theirs.pixel_m).abs() <= SAME_PIXEL * ours.pixel_m;
        let same_grid = (ours.width, ours.height) == (theirs.width, theirs.height);
        if same_grid && same_pixel && press.depth_m.len() == ours.width * ours.height {
            return Ok(());
        }
        Err(Error::input(format!(
            "the press must be on the sensor's grid of {}×{} pixels of {} m, found {}×{} of {} \
                 m with {} depths",
            ours.width,
            ours.height,
            ours.pixel_m,
            theirs.width,
            theirs.height,
            theirs.pixel_m,
            press.depth_m.len()
        ))
        .remedy("render the depth with the geometry of the sensor profile"))
    }
}

/// Motion of a [`Skin`].
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

/// Error of what needs gel markers.
fn no_markers() -> Error {
    Error::config("the sensor profile has no gel markers").remedy(
        "use a profile with `[markers]`, such as gelsight-mini-markers, or describe those of the gel",
    )
}

#[cfg(test)]
#[path = "renderer_test.rs"]
mod tests;
