//! Image degradation: shading, motion, blur and noise.

use glam::DVec2;
use image::GrayImage;
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64;
use rayon::prelude::*;

use super::surface::Shade;
use gripcast_imaging::{linear_to_srgb, srgb_to_linear};

/// Direction of the shading gradient, from x towards y.
const SHADING_RAD: f64 = 1.0;

/// Conditions of a synthetic image.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageConditions {
    /// Grey levels (sRGB) of paper, ink and background.
    pub levels: [f32; 3],
    /// Standard deviation of the Gaussian blur of the lens, px.
    pub psf_px: f64,
    /// Displacement of the image during the exposure, px.
    pub motion_px: DVec2,
    /// Standard deviation of the sensor noise, grey levels.
    pub noise: f64,
    /// Relative change of brightness from one side of the image to the other.
    pub shading: f64,
}

impl Default for ImageConditions {
    /// A good camera indoors: blur 0.7 px, noise 3 levels, shading 0.25.
    fn default() -> Self {
        Self {
            levels: [205.0, 35.0, 90.0],
            psf_px: 0.7,
            motion_px: DVec2::ZERO,
            noise: 3.0,
            shading: 0.25,
        }
    }
}

impl ImageConditions {
    /// Linear light in [0, 1].
    pub(super) fn light(&self, shade: Shade) -> f32 {
        srgb_to_linear(match shade {
            Shade::White => self.levels[0],
            Shade::Black => self.levels[1],
            Shade::Background => self.levels[2],
        })
    }
}

/// Applies motion, blur and shading to linear light, then noise to its sRGB levels.
pub(super) fn degrade(
    mut levels: Vec<f32>,
    width: u32,
    height: u32,
    conditions: &ImageConditions,
    seed: u64,
) -> GrayImage {
    let (columns, rows) = (width as usize, height as usize);
    if conditions.motion_px != DVec2::ZERO {
        levels = motion_blur(&levels, columns, rows, conditions.motion_px);
    }
    let kernel = gaussian(conditions.psf_px);
    levels = convolve(&levels, columns, rows, &kernel);
    let size = DVec2::new(f64::from(width), f64::from(height));
    let direction = DVec2::from_angle(SHADING_RAD);
    let pixels = levels
        .par_chunks(columns)
        .enumerate()
        .flat_map_iter(|(y, row)| {
            let mut random = Pcg64::seed_from_u64(seed ^ ((y as u64) << 40));
            row.iter().enumerate().map(move |(x, level)| {
                let position = DVec2::new(x as f64, y as f64) / size - 0.5;
                let light = 1.0 + conditions.shading * position.dot(direction);
                let noise = conditions.noise * normal(&mut random);
                let srgb = linear_to_srgb(*level * light as f32);
                (f64::from(srgb) + noise).round().clamp(0.0, 255.0) as u8
            })
        })
        .collect();
    GrayImage::from_raw(width, height, pixels).unwrap_or_default()
}

/// Samples the normal distribution (Box and Muller, 1958).
pub(super) fn normal(random: &mut Pcg64) -> f64 {
    let radius = (-2.0 * (1.0 - random.random::<f64>()).ln()).sqrt();
    radius * (std::f64::consts::TAU * random.random::<f64>()).cos()
}

/// Normalised Gaussian kernel.
fn gaussian(sigma_px: f64) -> Vec<f32> {
    let radius = (4.0 * sigma_px).ceil() as i32;
    let weight = |i: i32| (-0.5 * (f64::from(i) / sigma_px.max(1e-3)).powi(2)).exp();
    let sum: f64 = (-radius..=radius).map(weight).sum();
    (-radius..=radius)
        .map(|i| (weight(i) / sum) as f32)
        .collect()
}

/// Convolves along both axes with a symmetric kernel, repeating the border.
fn convolve(levels: &[f32], columns: usize, rows: usize, kernel: &[f32]) -> Vec<f32> {
    let radius = kernel.len() / 2;
    let mut across = vec![0.0; levels.len()];
    across
        .par_chunks_mut(columns)
        .zip(levels.par_chunks(columns))
        .for_each(|(to, from)| {
            for (x, to) in to.iter_mut().enumerate() {
                let at = |i: usize| from[(x + i).saturating_sub(radius).min(columns - 1)];
                *to = kernel.iter().enumerate().map(|(i, k)| k * at(i)).sum();
            }
        });
    let mut result = vec![0.0; levels.len()];
    result
        .par_chunks_mut(columns)
        .enumerate()
        .for_each(|(y, to)| {
            for (i, k) in kernel.iter().enumerate() {
                let from = (y + i).saturating_sub(radius).min(rows - 1);
                let row = &across[from * columns..(from + 1) * columns];
                for (to, from) in to.iter_mut().zip(row) {
                    *to += k * from;
                }
            }
        });
    result
}

/// Mean along a straight path centred at each pixel.
fn motion_blur(levels: &[f32], columns: usize, rows: usize, path_px: DVec2) -> Vec<f32> {
    let steps = (4.0 * path_px.length()).ceil().max(2.0) as usize;
    let mut result = vec![0.0; levels.len()];
    result
        .par_chunks_mut(columns)
        .enumerate()
        .for_each(|(y, to)| {
            for (x, to) in to.iter_mut().enumerate() {
                let mut sum = 0.0;
                for step in 0..steps {
                    let fraction = (step as f64 + 0.5) / steps as f64 - 0.5;
                    let at = DVec2::new(x as f64, y as f64) + path_px * fraction;
                    sum += bilinear(levels, columns, rows, at);
                }
                *to = sum / steps as f32;
            }
        });
    result
}

fn bilinear(levels: &[f32], columns: usize, rows: usize, at: DVec2) -> f32 {
    let at = at.clamp(
        DVec2::ZERO,
        DVec2::new(columns as f64 - 1.0, rows as f64 - 1.0),
    );
    let (x, y) = (at.x as usize, at.y as usize);
    let (fx, fy) = ((at.x - x as f64) as f32, (at.y - y as f64) as f32);
    let (right, below) = ((x + 1).min(columns - 1), (y + 1).min(rows - 1));
    let level = |x: usize, y: usize| levels[y * columns + x];
    let top = level(x, y) * (1.0 - fx) + level(right, y) * fx;
    let bottom = level(x, below) * (1.0 - fx) + level(right, below) * fx;
    top * (1.0 - fy) + bottom * fy
}
