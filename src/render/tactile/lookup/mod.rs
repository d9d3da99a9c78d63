//! The lookup-table renderer of Taxim (Si & Yuan 2022), to compare with: a pyramid of Gaussian
//! filters for the gel around the contact, a table of polynomials for the colours, shadows marched
//! over the height map instead of its shadow table.

mod fit;
mod height;
mod npz;
mod shadow;
mod table;

pub use fit::BallPress;
pub use height::TaximHeights;
pub use shadow::{ShadowLamp, Shadows};
pub use table::{ChannelOrder, TaximTable};

use image::{Rgb, RgbImage};

use super::depth::object_depth;
use super::press_depth::{PressDepth, SensorGeometry};
use super::rasteriser::Rasteriser;
use super::scene::TactileScene;
use super::scene_renderer::SceneRenderer;
use crate::error::{Error, ErrorKind, Result};

/// Taxim's renderer on the object's depth.
#[derive(Clone, Debug)]
pub struct LookupRenderer {
    grid: SensorGeometry,
    background: RgbImage,
    table: TaximTable,
    heights: TaximHeights,
    shadows: Option<Shadows>,
    rasteriser: Rasteriser,
}

impl LookupRenderer {
    /// A renderer over a no-contact picture, without shadows.
    ///
    /// # Errors
    /// `Input` where the picture has another size than the grid.
    pub fn new(
        grid: SensorGeometry,
        background: RgbImage,
        table: TaximTable,
        heights: TaximHeights,
    ) -> Result<Self> {
        let found = (background.width() as usize, background.height() as usize);
        if found != (grid.width, grid.height) {
            return Err(Error::new(
                ErrorKind::Input,
                format!(
                    "the no-contact picture must be of {} × {} pixels, found {} × {}",
                    grid.width, grid.height, found.0, found.1
                ),
            ));
        }
        Ok(Self {
            grid,
            background,
            table,
            heights,
            shadows: None,
            rasteriser: Rasteriser::new(),
        })
    }

    /// The same with shadows.
    #[must_use]
    pub fn with_shadows(mut self, shadows: Shadows) -> Self {
        self.shadows = Some(shadows);
        self
    }

    /// Picture of a press.
    pub fn picture(&self, press: &PressDepth) -> RgbImage {
        let heights = self.heights.heights(press);
        let light = self.shadows.as_ref().map(|s| s.light(&heights, &self.grid));
        let mut picture = self.background.clone();
        let SensorGeometry {
            width,
            height,
            pixel_m,
            ..
        } = self.grid;
        // The polynomials count in pixels of the table's own picture.
        let [columns, rows] = self.table.image_size();
        let zoom = [columns as f64 / width as f64, rows as f64 / height as f64];
        for (x, y, pixel) in picture.enumerate_pixels_mut() {
            let (x, y) = (x as usize, y as usize);
            let slope = slope(&heights, [width, height], [x, y], pixel_m);
            let place = [x, y].map(|v| v as f64 + 0.5);
            let place = [place[0] * zoom[0] - 0.5, place[1] * zoom[1] - 0.5];
            let change = self.table.change(slope, place);
            let Rgb(colours) = *pixel;
            *pixel = Rgb([0, 1, 2].map(|channel| {
                let lit = light.as_ref().map_or(1.0, |l| l[channel][y * width + x]);
                let value = (f64::from(colours[channel]) + change[channel]) * f64::from(lit);
                value.round().clamp(0.0, 255.0) as u8
            }));
        }
        picture
    }
}

impl SceneRenderer for LookupRenderer {
    fn name(&self) -> &'static str {
        "lookup"
    }

    fn grid(&self) -> SensorGeometry {
        self.grid
    }

    fn render(&mut self, scene: &TactileScene<'_>, _seed: Option<u64>) -> Result<RgbImage> {
        let press = object_depth(scene, &self.grid, &mut self.rasteriser);
        Ok(self.picture(&press))
    }
}

/// Rise of a height map (m) along columns and rows, pixels per pixel, by central differences;
/// border pixels take those of their neighbours further in.
fn slope(
    heights_m: &[f32],
    [width, height]: [usize; 2],
    [x, y]: [usize; 2],
    pixel_m: f64,
) -> [f32; 2] {
    if width < 3 || height < 3 {
        return [0.0; 2];
    }
    let (x, y) = (x.clamp(1, width - 2), y.clamp(1, height - 2));
    let at = |x: usize, y: usize| heights_m[y * width + x];
    let scale = (0.5 / pixel_m) as f32;
    [
        (at(x + 1, y) - at(x - 1, y)) * scale,
        (at(x, y + 1) - at(x, y - 1)) * scale,
    ]
}
