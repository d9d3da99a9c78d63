//! Denoiser guided by the first surfaces: non-local means over patches, joint with albedo, normal
//! and depth.
//!
//! A pixel becomes the weighted mean of the pixels around it. Weights compare small patches of
//! light, divided by the albedo so that textures stay sharp, against the noise that is expected
//! there, and the first surfaces. The weights for one half of the paths come from the other half,
//! so that noise does not choose itself. Sources: Buades, Coll, Morel, *A non-local algorithm for
//! image denoising* (2005); Rousselle, Knaus, Zwicker, *Adaptive rendering with non-local means
//! filtering* (2012); Rousselle, Manzi, Zwicker, *Robust denoising using feature and color
//! information* (2013).

use rayon::prelude::*;

use super::picture::Picture;
use super::renderer::Rendering;

/// Albedo below which light is not divided any further.
const LEAST_ALBEDO: f32 = 0.02;
/// Radius over which the noise is averaged, px.
const NOISE_RADIUS: usize = 3;

/// How much is smoothed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DenoiseSettings {
    /// Radius of the neighbourhood, px.
    pub radius: usize,
    /// Radius of the compared patches, px.
    pub patch_radius: usize,
    /// How far patches may differ, in standard deviations of their noise.
    pub noise: f32,
    /// Difference of albedo, of the cosine between normals and of relative depth at which the
    /// weight of a pixel has fallen to 1/e.
    pub albedo: f32,
    /// See `albedo`.
    pub normal: f32,
    /// See `albedo`.
    pub depth: f32,
}

impl Default for DenoiseSettings {
    fn default() -> Self {
        Self {
            radius: 7,
            patch_radius: 2,
            noise: 0.6,
            albedo: 0.2,
            normal: 0.05,
            depth: 0.02,
        }
    }
}

/// Light of one half of the paths.
type Light = Vec<[f32; 3]>;

/// Picture with less noise. The result depends on the rendering alone.
pub fn denoise(rendering: &Rendering, settings: &DenoiseSettings) -> Picture {
    let (width, height) = (rendering.picture.width, rendering.picture.height);
    let albedo: Vec<[f32; 3]> = (0..width * height)
        .map(|at| match rendering.depth_m[at] > 0.0 {
            true => rendering.albedo.pixels[at].map(|a| a.max(LEAST_ALBEDO)),
            false => [1.0; 3],
        })
        .collect();
    let halves: [Light; 2] = [0, 1].map(|half| {
        let pixels = rendering.halves[half].pixels.iter().zip(&albedo);
        pixels
            .map(|(p, a)| std::array::from_fn(|k| p[k] / a[k]))
            .collect()
    });
    let guide = Guide {
        rendering,
        settings,
        variance: noise(&halves, rendering, &albedo),
        width,
        height,
    };
    let rows: Vec<Vec<[f32; 3]>> = (0..height)
        .into_par_iter()
        .map(|row| guide.filter_row(&halves, row))
        .collect();
    let mut picture = rendering.picture.clone();
    for (at, light) in rows.into_iter().flatten().enumerate() {
        picture.pixels[at] = std::array::from_fn(|k| light[k] * albedo[at][k]);
    }
    picture
}

/// Variance of the light of one half, for each pixel: that among the paths, scaled by how far the
/// halves really differ, because well spread paths differ less than independent ones.
fn noise(halves: &[Light; 2], rendering: &Rendering, albedo: &[[f32; 3]]) -> Vec<f32> {
    let (width, height) = (rendering.picture.width, rendering.picture.height);
    let of_paths = rendering.variance.pixels.iter().zip(albedo);
    let of_paths: Vec<f32> = of_paths
        .map(|(v, a)| (0..3).map(|k| 2.0 * v[k] / (a[k] * a[k])).sum::<f32>() / 3.0)
        .collect();
    let of_halves: Vec<f32> = halves[0]
        .iter()
        .zip(&halves[1])
        .map(|(a, b)| (0..3).map(|k| 0.5 * (a[k] - b[k]).powi(2)).sum::<f32>() / 3.0)
        .collect();
    let of_halves = box_mean(&of_halves, width, height, NOISE_RADIUS);
    let smooth = box_mean(&of_paths, width, height, NOISE_RADIUS);
    of_paths
        .iter()
        .zip(&smooth)
        .zip(&of_halves)
        .map(|((own, paths), halves)| match *paths > 0.0 {
            // Half of the pixel's own, half of its surroundings: single paths are seldom typical.
            true => 0.5 * (own + paths) * (halves / paths).min(1.0),
            false => *halves,
        })
        .collect()
}

/// Mean over squares of `2 radius + 1` pixels, fewer at the borders.
fn box_mean(values: &[f32], width: usize, height: usize, radius: usize) -> Vec<f32> {
    let along = |count: usize, at: usize| at.saturating_sub(radius)..(at + radius + 1).min(count);
    let mut rows = Vec::with_capacity(values.len());
    for row in values.chunks(width.max(1)) {
        for column in 0..width {
            let range = along(width, column);
            let count = range.len() as f32;
            rows.push(row[range].iter().sum::<f32>() / count);
        }
    }
    let mut out = Vec::with_capacity(values.len());
    for row in 0..height {
        let range = along(height, row);
        for column in 0..width {
            let sum: f32 = range.clone().map(|r| rows[r * width + column]).sum();
            out.push(sum / range.len() as f32);
        }
    }
    out
}

/// What weights are made of.
struct Guide<'a> {
    rendering: &'a Rendering,
    settings: &'a DenoiseSettings,
    /// Variance of the light of one half.
    variance: Vec<f32>,
    width: usize,
    height: usize,
}

impl Guide<'_> {
    /// Filtered light of a row.
    fn filter_row(&self, halves: &[Light; 2], row: usize) -> Vec<[f32; 3]> {
        let mut sums = vec![[[0.0f32; 4]; 2]; self.width];
        let radius = self.settings.radius as isize;
        let mut distances = [Vec::new(), Vec::new()];
        for dy in -radius..=radius {
            let Some(other) = shifted(row, dy, self.height) else {
                continue;
            };
            for dx in -radius..=radius {
                for half in 0..2 {
                    self.patch_distances(&halves[half], row, [dx, dy], &mut distances[half]);
                }
                for column in 0..self.width {
                    let Some(neighbour) = shifted(column, dx, self.width) else {
                        continue;
                    };
                    let (p, q) = (row * self.width + column, other * self.width + neighbour);
                    let same = self.same_surface(p, q);
                    if same < 1e-4 {
                        continue;
                    }
                    for half in 0..2 {
                        // The other half decides.
                        let weight = same * (-distances[1 - half][column].max(0.0)).exp();
                        let sum = &mut sums[column][half];
                        for k in 0..3 {
                            sum[k] += weight * halves[half][q][k];
                        }
                        sum[3] += weight;
                    }
                }
            }
        }
        let mean = |[a, b]: &[[f32; 4]; 2]| {
            std::array::from_fn(|k| 0.5 * (a[k] / a[3].max(1e-12) + b[k] / b[3].max(1e-12)))
        };
        sums.iter().map(mean).collect()
    }

    /// For each column of a row: how far the patch around a pixel differs from the shifted one,
    /// beyond what noise explains.
    fn patch_distances(&self, light: &Light, row: usize, [dx, dy]: [isize; 2], out: &mut Vec<f32>) {
        let patch = self.settings.patch_radius as isize;
        let scale = 1.0 / (self.settings.noise * self.settings.noise);
        // Mean over the rows of the patch for each column, then over the columns.
        let columns: Vec<f32> = (0..self.width)
            .map(|column| {
                let Some(other) = shifted(column, dx, self.width) else {
                    return f32::INFINITY;
                };
                let (mut sum, mut count) = (0.0, 0.0);
                for y in -patch..=patch {
                    let (Some(r), Some(s)) = (
                        shifted(row, y, self.height),
                        shifted(row, y + dy, self.height),
                    ) else {
                        continue;
                    };
                    sum +=
                        self.pixel_distance(light, r * self.width + column, s * self.width + other);
                    count += 1.0;
                }
                if count > 0.0 {
                    sum / count
                } else {
                    f32::INFINITY
                }
            })
            .collect();
        out.clear();
        out.extend((0..self.width).map(|column| {
            let (mut sum, mut count) = (0.0, 0.0);
            for x in -patch..=patch {
                if let Some(c) = shifted(column, x, self.width)
                    && columns[c].is_finite()
                {
                    sum += columns[c];
                    count += 1.0;
                }
            }
            if count > 0.0 {
                scale * sum / count
            } else {
                0.0
            }
        }));
    }

    /// Squared difference of two pixels less the noise, in units of the noise.
    #[inline]
    fn pixel_distance(&self, light: &Light, p: usize, q: usize) -> f32 {
        let (vp, vq) = (self.variance[p], self.variance[q]);
        let difference = (0..3)
            .map(|k| (light[p][k] - light[q][k]).powi(2))
            .sum::<f32>()
            / 3.0;
        (difference - (vp + vp.min(vq))) / (vp + vq + 1e-6)
    }

    /// Weight by the first surfaces: 1 for the same, 0 for different ones.
    #[inline]
    fn same_surface(&self, p: usize, q: usize) -> f32 {
        let (rendering, settings) = (self.rendering, self.settings);
        let (zp, zq) = (rendering.depth_m[p], rendering.depth_m[q]);
        if (zp > 0.0) != (zq > 0.0) {
            return 0.0;
        }
        let (ap, aq) = (&rendering.albedo.pixels[p], &rendering.albedo.pixels[q]);
        let albedo = (0..3).map(|k| (ap[k] - aq[k]).powi(2)).sum::<f32>();
        let (np, nq) = (&rendering.normal.pixels[p], &rendering.normal.pixels[q]);
        let normal = (0..3).map(|k| (np[k] - nq[k]).powi(2)).sum::<f32>() * 0.5;
        let depth = if zp > 0.0 { (zp - zq).abs() / zp } else { 0.0 };
        let exponent = albedo / (settings.albedo * settings.albedo)
            + normal / settings.normal
            + (depth / settings.depth).powi(2);
        (-exponent).exp()
    }
}

/// Index moved by an offset, if it stays in range.
#[inline]
fn shifted(at: usize, by: isize, count: usize) -> Option<usize> {
    at.checked_add_signed(by).filter(|moved| *moved < count)
}
