//! Baseline renderer: Taxim's lookup table (Si & Yuan 2022). A pyramid of Gaussian filters models
//! the gel around the contact, a table of polynomials the photometric response; shadows are
//! ray-marched over the height map instead of Taxim's shadow table.

mod fit;
mod height;
mod on_presses;
mod shadow;
mod table;

pub use fit::BallPress;
pub use on_presses::fit_to_presses;
pub use table::TaximTable;

use image::{Rgb, RgbImage};

use super::depth::object_depth;
use super::press_depth::{PressDepth, SensorGeometry};
use super::rasteriser::Rasteriser;
use super::scene::TactileScene;
use super::scene_renderer::SceneRenderer;
use gripcast_base::error::{Error, Result};

/// Slope up to which a face counts as flat.
const FLAT_DEGREES: f64 = 0.1;
/// Slope from which the table applies fully. Larger values reduce the fidelity close to the
/// contact.
const SLOPED_DEGREES: f64 = 1.5;

/// Taxim's renderer applied to the object's depth.
#[derive(Clone, Debug)]
pub struct LookupRenderer {
    grid: SensorGeometry,
    background: RgbImage,
    table: TaximTable,
    has_shadows: bool,
    rasteriser: Rasteriser,
}

impl LookupRenderer {
    /// Renderer on a no-contact image, without shadows.
    ///
    /// # Errors
    /// `Input` if the image size differs from the grid.
    pub fn new(grid: SensorGeometry, background: RgbImage, table: TaximTable) -> Result<Self> {
        let found = (background.width() as usize, background.height() as usize);
        if found != (grid.width, grid.height) {
            return Err(Error::input(format!(
                "the no-contact image must have {} × {} pixels, found {} × {}",
                grid.width, grid.height, found.0, found.1
            )));
        }
        Ok(Self {
            grid,
            background,
            table,
            has_shadows: false,
            rasteriser: Rasteriser::new(),
        })
    }

    /// Adds shadows.
    #[must_use]
    pub fn with_shadows(mut self) -> Self {
        self.has_shadows = true;
        self
    }

    /// Returns the change of the no-contact image caused by a press, grey levels: red, green, blue
    /// per pixel, row-major, neither rounded nor clipped.
    ///
    /// A flat face does not change; the change is faded in up to a slope of 1.5 degrees. Taxim's
    /// own renderer applies its flat bin everywhere.
    ///
    /// # Errors
    /// `Input` if the press is on another grid.
    pub fn change(&self, press: &PressDepth) -> Result<Vec<[f32; 3]>> {
        if press.geometry != self.grid {
            return Err(Error::input(format!(
                "the press must be on the grid {:?}, found {:?}",
                self.grid, press.geometry
            )));
        }
        let heights = height::heights(press);
        let light = self
            .has_shadows
            .then(|| shadow::transmitted_light(&heights, &self.grid));
        let SensorGeometry { width, height, .. } = self.grid;
        // The polynomials use pixels of the table's own image.
        let [columns, rows] = self.table.image_size();
        let zoom = [columns as f64 / width as f64, rows as f64 / height as f64];
        let untouched = self.background.pixels();
        let change = |(pixel, Rgb(untouched)): (usize, &Rgb<u8>)| {
            let position = [pixel % width, pixel / width];
            let slope = gradient(&heights, &self.grid, position);
            let table_position =
                [0, 1].map(|axis| (position[axis] as f64 + 0.5) * zoom[axis] - 0.5);
            let fraction = fraction_of_change(slope);
            let change = if fraction == 0.0 {
                [0.0; 3]
            } else {
                self.table
                    .change(slope, table_position)
                    .map(|c| c * fraction)
            };
            [0, 1, 2].map(|channel| {
                let change = change[channel] as f32;
                let Some(light) = &light else { return change };
                let untouched = f32::from(untouched[channel]);
                (untouched + change) * light[channel][pixel] - untouched
            })
        };
        Ok(untouched.enumerate().map(change).collect())
    }

    /// Renders the image of a press.
    ///
    /// # Errors
    /// `Input` if the press is on another grid.
    pub fn image(&self, press: &PressDepth) -> Result<RgbImage> {
        let mut image = self.background.clone();
        for (Rgb(pixel), change) in image.pixels_mut().zip(self.change(press)?) {
            for (value, change) in pixel.iter_mut().zip(change) {
                // The cast saturates at 0 and 255.
                *value = (f32::from(*value) + change).round() as u8;
            }
        }
        Ok(image)
    }
}

impl SceneRenderer for LookupRenderer {
    fn grid(&self) -> SensorGeometry {
        self.grid
    }

    fn render(&mut self, scene: &TactileScene<'_>, _seed: Option<u64>) -> Result<RgbImage> {
        let press = object_depth(scene, &self.grid, &mut self.rasteriser);
        self.image(&press)
    }
}

/// Fade-in factor for a slope. The table is not determined for nearly flat faces: its samples are a
/// few pixels in the centre of each ball press, deep in the gel. Filter residue far from the
/// contact must not get their colour.
fn fraction_of_change(slope: [f32; 2]) -> f64 {
    let angle = f64::from(slope[0].hypot(slope[1])).atan().to_degrees();
    ((angle - FLAT_DEGREES) / (SLOPED_DEGREES - FLAT_DEGREES)).clamp(0.0, 1.0)
}

/// Gradient of a height map (m), pixels per pixel along columns and rows, by central differences;
/// border pixels copy their inner neighbours.
fn gradient(heights_m: &[f32], grid: &SensorGeometry, [x, y]: [usize; 2]) -> [f32; 2] {
    let SensorGeometry { width, height, .. } = *grid;
    if width < 3 || height < 3 {
        return [0.0; 2];
    }
    let (x, y) = (x.clamp(1, width - 2), y.clamp(1, height - 2));
    let at = |x: usize, y: usize| heights_m[y * width + x];
    let scale = (0.5 / grid.pixel_m) as f32;
    [
        (at(x + 1, y) - at(x - 1, y)) * scale,
        (at(x, y + 1) - at(x, y - 1)) * scale,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    const GRID: SensorGeometry = SensorGeometry {
        width: 64,
        height: 48,
        pixel_m: 1e-4,
        gel_thickness_m: 4e-3,
    };

    fn renderer(table: TaximTable) -> LookupRenderer {
        let untouched = RgbImage::from_pixel(64, 48, Rgb([100, 110, 120]));
        LookupRenderer::new(GRID, untouched, table).unwrap()
    }

    fn block() -> PressDepth {
        let inside = |i: usize| (24..40).contains(&(i % 64)) && (16..32).contains(&(i / 64));
        let depth = |i| if inside(i) { 8e-4 } else { 0.0 };
        PressDepth {
            geometry: GRID,
            depth_m: (0..64 * 48).map(depth).collect(),
        }
    }

    #[test]
    fn table_change_is_applied_and_saturates() {
        let table = TaximTable::constant(9, [640, 480], [200.0, -20.0, 0.4]);
        let image = renderer(table).image(&block()).unwrap();
        assert_eq!(image.get_pixel(24, 24), &Rgb([255, 90, 120]));
    }

    #[test]
    fn positions_are_scaled_to_the_tables_image() {
        // Ten times as large: pixel (24, 24) lies at (244.5, 244.5).
        let table = TaximTable::linear_in_column(9, [640, 480]);
        let change = renderer(table).change(&block()).unwrap();
        assert!((change[24 * 64 + 24][0] - 244.5).abs() < 1e-4);
    }

    #[test]
    fn pixels_far_from_contact_are_unchanged() {
        let table = TaximTable::constant(9, [640, 480], [200.0, -20.0, 5.0]);
        let renderer = renderer(table).with_shadows();
        let mut press = PressDepth::untouched(GRID);
        assert!(
            renderer
                .change(&press)
                .unwrap()
                .iter()
                .all(|c| *c == [0.0; 3])
        );
        let distance = |i: usize| ((i % 64) as f64 - 6.0).hypot((i / 64) as f64 - 6.0);
        for (i, depth) in press.depth_m.iter_mut().enumerate() {
            *depth = if distance(i) < 4.0 { 5e-4 } else { 0.0 };
        }
        let change = renderer.change(&press).unwrap();
        assert!(change[6 * 64 + 10][0] > 100.0, "{:?}", change[6 * 64 + 10]);
        // Filters as wide as 1 mm leave a slope everywhere within their reach.
        let heights = height::heights(&press);
        let is_far = |i: &usize| distance(*i) > 34.0;
        let far: Vec<usize> = (0..64 * 48).filter(is_far).collect();
        assert!(far.iter().any(|i| heights[*i] > 0.0));
        assert!(far.iter().all(|i| change[*i] == [0.0; 3]));
    }

    #[test]
    fn change_fades_in_from_flat_face() {
        let fraction = |degrees: f64| fraction_of_change([0.0, -degrees.to_radians().tan() as f32]);
        assert_eq!([0.0, 0.09].map(fraction), [0.0; 2]);
        assert!((fraction(0.8) - 0.5).abs() < 1e-4);
        assert_eq!([1.51, 80.0].map(fraction), [1.0; 2]);
    }

    #[test]
    fn shadows_only_darken() {
        let table = TaximTable::constant(9, [640, 480], [0.0; 3]);
        let plain = renderer(table.clone()).image(&block()).unwrap();
        let shaded = renderer(table).with_shadows();
        let shaded = shaded.image(&block()).unwrap();
        assert!(shaded.iter().zip(plain.iter()).all(|(a, b)| a <= b));
        assert!(shaded != plain);
    }

    #[test]
    fn image_or_press_of_another_size_is_refused() {
        let table = TaximTable::constant(9, [640, 480], [0.0; 3]);
        let small = RgbImage::new(32, 48);
        let text = LookupRenderer::new(GRID, small, table.clone());
        let text = text.unwrap_err().to_string();
        assert!(
            text.contains("64 × 48") && text.contains("32 × 48"),
            "{text}"
        );
        let mut press = block();
        press.geometry.pixel_m = 2e-4;
        assert!(renderer(table).image(&press).is_err());
    }
}
