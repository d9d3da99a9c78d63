//! Denoiser guided by the first surfaces: non-local means over patches, joint with albedo, normal
//! and depth.
//!
//! A pixel becomes the weighted mean of the pixels around it. Weights compare small patches of
//! light, divided by the albedo so that textures stay sharp, against the noise that is expected
//! there, and the first surfaces. The weights for one half of the paths come from the other half,
//! so that noise does not choose itself.
//!
//! A firefly, a pixel with one or a few paths that are far brighter than all around, would be
//! spread evenly over its neighbourhood: a bright square. Its weight is cut, see [`trust`]; the
//! light that it stands for is lost, as with a clamp, and the picture is so much too dark there.
//! Pixels without such paths keep their weight. Sources: Buades, Coll, Morel, *A non-local algorithm for
//! image denoising* (2005); Rousselle, Knaus, Zwicker, *Adaptive rendering with non-local means
//! filtering* (2012); Rousselle, Manzi, Zwicker, *Robust denoising using feature and color
//! information* (2013).

use std::ops::Range;

use rayon::prelude::*;

use super::picture::Picture;
use super::renderer::Rendering;

/// Albedo below which light is not divided any further.
const LEAST_ALBEDO: f32 = 0.02;
/// Radius over which the noise is averaged, px.
const NOISE_RADIUS: usize = 3;
/// Variance of a firefly, in means of its neighbourhood.
const FIREFLY_VARIANCE: f32 = 16.0;
/// Rounds of looking for them.
const FIREFLY_ROUNDS: usize = 8;
/// A pixel is no firefly from this number of equal paths on that would vary as its own do, and
/// may be one entirely at half of it: what is really bright, many paths see.
const SOLID_PATHS: f32 = 8.0;
/// Least weight of a pixel for itself, so that one unlike all others keeps its light.
const LEAST_OWN_TRUST: f32 = 1e-6;
/// Rows that are filtered together.
const BAND: usize = 16;

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
    let of_paths = variance_of_paths(rendering, &albedo);
    let trust = trust(&halves, &of_paths, [width, height], settings.radius);
    let guide = Guide {
        rendering,
        settings,
        variance: noise(&halves, &of_paths, &trust, [width, height]),
        trust,
        width,
        height,
    };
    let bands: Vec<Vec<[f32; 3]>> = (0..height.div_ceil(BAND))
        .into_par_iter()
        .map(|band| guide.filter(&halves, band * BAND..height.min((band + 1) * BAND)))
        .collect();
    let mut picture = rendering.picture.clone();
    for (at, light) in bands.into_iter().flatten().enumerate() {
        picture.pixels[at] = std::array::from_fn(|k| light[k] * albedo[at][k]);
    }
    picture
}

/// Variance of the light of one half among its paths, as if they were independent.
fn variance_of_paths(rendering: &Rendering, albedo: &[[f32; 3]]) -> Vec<f32> {
    let values = rendering.variance.pixels.iter().zip(albedo);
    values
        .map(|(v, a)| (0..3).map(|k| 2.0 * v[k] / (a[k] * a[k])).sum::<f32>() / 3.0)
        .collect()
}

/// Share of its weight that each pixel keeps: below 1 for fireflies.
///
/// With v the variance of a pixel, m its mean over the other pixels of the square around: a
/// firefly keeps c · m / v. Cut like that, the brightest adds √c standard deviations of its
/// neighbours to the sum over the square.
fn trust(halves: &[Light; 2], of_paths: &[f32], size: [usize; 2], radius: usize) -> Vec<f32> {
    let mut trust = vec![1.0; of_paths.len()];
    let suspicion: Vec<f32> = of_paths
        .iter()
        .zip(halves[0].iter().zip(&halves[1]))
        .map(|(v, (a, b))| {
            let square = (0..3).map(|k| (0.5 * (a[k] + b[k])).powi(2)).sum::<f32>() / 3.0;
            // The picture has half of the variance of its halves.
            let paths = square / (0.5 * v).max(f32::MIN_POSITIVE);
            (2.0 - 2.0 * paths / SOLID_PATHS).clamp(0.0, 1.0)
        })
        .collect();
    // Later rounds find what brighter ones beside it hid in the first.
    for _ in 0..FIREFLY_ROUNDS {
        let cut: Vec<f32> = of_paths.iter().zip(&trust).map(|(v, t)| v * t).collect();
        let around = box_mean(&cut, size[0], size[1], radius);
        for (at, trust) in trust.iter_mut().enumerate() {
            let sides = [at % size[0], at / size[0]].into_iter().zip(size);
            let count: usize = sides
                .map(|(at, side)| near(side, at, radius).len())
                .product();
            let others = (around[at] - cut[at] / count as f32).max(0.0);
            let kept = (FIREFLY_VARIANCE * others / of_paths[at].max(f32::MIN_POSITIVE)).min(1.0);
            *trust = 1.0 - suspicion[at] * (1.0 - kept);
        }
    }
    trust
}

/// Variance of the light of one half, for each pixel: that among the paths, scaled by how far the
/// halves really differ, because well spread paths differ less than independent ones. Fireflies
/// count as far as they are trusted.
fn noise(
    halves: &[Light; 2],
    of_paths: &[f32],
    trust: &[f32],
    [width, height]: [usize; 2],
) -> Vec<f32> {
    let of_paths: Vec<f32> = of_paths.iter().zip(trust).map(|(v, t)| v * t).collect();
    let of_halves: Vec<f32> = halves[0]
        .iter()
        .zip(&halves[1])
        .zip(trust)
        .map(|((a, b), t)| t * (0..3).map(|k| 0.5 * (a[k] - b[k]).powi(2)).sum::<f32>() / 3.0)
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

/// Places up to `radius` away along a side.
fn near(side: usize, at: usize, radius: usize) -> Range<usize> {
    at.saturating_sub(radius)..(at + radius + 1).min(side)
}

/// Mean over squares of `2 radius + 1` pixels, fewer at the borders.
fn box_mean(values: &[f32], width: usize, height: usize, radius: usize) -> Vec<f32> {
    let mut rows = Vec::with_capacity(values.len());
    for row in values.chunks(width.max(1)) {
        for column in 0..width {
            let range = near(width, column, radius);
            let count = range.len() as f32;
            rows.push(row[range].iter().sum::<f32>() / count);
        }
    }
    let mut out = Vec::with_capacity(values.len());
    for row in 0..height {
        let range = near(height, row, radius);
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
    /// Share of its weight that a pixel keeps.
    trust: Vec<f32>,
    width: usize,
    height: usize,
}

impl Guide<'_> {
    /// Filtered light of some rows.
    fn filter(&self, halves: &[Light; 2], rows: Range<usize>) -> Vec<[f32; 3]> {
        let mut sums = vec![[[0.0f32; 4]; 2]; rows.len() * self.width];
        let radius = self.settings.radius as isize;
        let mut distances = [Vec::new(), Vec::new()];
        for dy in -radius..=radius {
            for dx in -radius..=radius {
                for half in 0..2 {
                    distances[half] = self.patch_distances(&halves[half], &rows, [dx, dy]);
                }
                for (row, line) in rows.clone().zip(0..) {
                    let Some(other) = shifted(row, dy, self.height) else {
                        continue;
                    };
                    for column in self.columns(dx) {
                        let p = row * self.width + column;
                        let q = other * self.width + column.wrapping_add_signed(dx);
                        let trust = match p == q {
                            true => self.trust[q].max(LEAST_OWN_TRUST),
                            false => self.trust[q],
                        };
                        let same = self.same_surface(p, q) * trust;
                        if same == 0.0 {
                            continue;
                        }
                        let at = line * self.width + column;
                        for half in 0..2 {
                            // The other half decides.
                            let weight = same * falloff(distances[1 - half][at]);
                            let light = &halves[half][q];
                            let sum = &mut sums[at][half];
                            for k in 0..3 {
                                sum[k] += weight * light[k];
                            }
                            sum[3] += weight;
                        }
                    }
                }
            }
        }
        let mean = |[a, b]: &[[f32; 4]; 2]| {
            std::array::from_fn(|k| 0.5 * (a[k] / a[3].max(1e-12) + b[k] / b[3].max(1e-12)))
        };
        sums.iter().map(mean).collect()
    }

    /// Columns that stay in the picture when moved.
    fn columns(&self, dx: isize) -> Range<usize> {
        let first = (-dx).max(0) as usize;
        let last = self.width as isize - dx.max(0);
        first..(last.max(first as isize) as usize)
    }

    /// For each pixel of some rows: how far the patch around it differs from the moved one, beyond
    /// what noise explains.
    fn patch_distances(&self, light: &Light, rows: &Range<usize>, by: [isize; 2]) -> Vec<f32> {
        let (width, patch) = (self.width, self.settings.patch_radius);
        let columns = self.columns(by[0]);
        let above = rows.start.saturating_sub(patch);
        let below = self.height.min(rows.end + patch);
        let mut single = vec![0.0; (below - above) * width];
        let mut valid = vec![false; below - above];
        for (line, row) in (above..below).enumerate() {
            let Some(other) = shifted(row, by[1], self.height) else {
                continue;
            };
            valid[line] = true;
            for column in columns.clone() {
                let q = other * width + column.wrapping_add_signed(by[0]);
                single[line * width + column] = self.pixel_distance(light, row * width + column, q);
            }
        }
        let scale = 1.0 / (self.settings.noise * self.settings.noise);
        let mut out = vec![0.0; rows.len() * width];
        let mut column_sums = vec![0.0f32; width];
        for (line, row) in rows.clone().enumerate() {
            column_sums.fill(0.0);
            let mut count = 0;
            for near in row.saturating_sub(patch)..self.height.min(row + patch + 1) {
                if valid[near - above] {
                    count += 1;
                    let line = &single[(near - above) * width..][..width];
                    for (sum, value) in column_sums.iter_mut().zip(line) {
                        *sum += value;
                    }
                }
            }
            for column in columns.clone() {
                let left = column.saturating_sub(patch).max(columns.start);
                let right = (column + patch + 1).min(columns.end);
                let sum: f32 = column_sums[left..right].iter().sum();
                out[line * width + column] = scale * sum / ((right - left) * count.max(1)) as f32;
            }
        }
        out
    }

    /// Squared difference of two pixels less the noise, in units of the noise. Fireflies tell
    /// nothing.
    #[inline]
    fn pixel_distance(&self, light: &Light, p: usize, q: usize) -> f32 {
        let (vp, vq) = (self.variance[p], self.variance[q]);
        let difference = (0..3)
            .map(|k| (light[p][k] - light[q][k]).powi(2))
            .sum::<f32>()
            / 3.0;
        let trust = self.trust[p].min(self.trust[q]);
        trust * (difference - (vp + vp.min(vq))) / (vp + vq + 1e-6)
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
        falloff(exponent)
    }
}

/// Weight for a distance: close to exp(-x), 0 from x = 4 on.
#[inline]
fn falloff(distance: f32) -> f32 {
    let base = (1.0 - 0.25 * distance.max(0.0)).max(0.0);
    let square = base * base;
    square * square
}

/// Index moved by an offset, if it stays in range.
#[inline]
fn shifted(at: usize, by: isize, count: usize) -> Option<usize> {
    at.checked_add_signed(by).filter(|moved| *moved < count)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wall of two colours, half lit and half in shade, with noise.
    fn noisy() -> (Rendering, Picture) {
        noisy_by(0.5)
    }

    /// With noise of this share of the light.
    fn noisy_by(noise: f32) -> (Rendering, Picture) {
        let (width, height) = (48, 32);
        let mut truth = Picture::filled(width, height, [0.0; 3]);
        let mut rendering = Rendering {
            picture: truth.clone(),
            variance: Picture::filled(width, height, [0.0; 3]),
            halves: [truth.clone(), truth.clone()],
            albedo: truth.clone(),
            normal: Picture::filled(width, height, [0.0, 0.0, 1.0]),
            depth_m: vec![1.0; width * height],
        };
        let mut state = 1u64;
        let mut number = move || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            (state >> 40) as f32 / (1u64 << 24) as f32 - 0.5
        };
        for at in 0..width * height {
            let (column, row) = (at % width, at / width);
            let albedo = if column / 3 % 2 == 0 { 0.8 } else { 0.2 };
            let light = if row < height / 2 { 1.0 } else { 0.3 };
            truth.pixels[at] = [albedo * light; 3];
            rendering.albedo.pixels[at] = [albedo; 3];
            let sigma = noise * light;
            let [a, b] = [(); 2].map(|()| albedo * (light + sigma * 12f32.sqrt() * number()));
            rendering.halves[0].pixels[at] = [a; 3];
            rendering.halves[1].pixels[at] = [b; 3];
            rendering.picture.pixels[at] = [0.5 * (a + b); 3];
            rendering.variance.pixels[at] = [0.5 * (albedo * sigma).powi(2); 3];
        }
        (rendering, truth)
    }

    #[test]
    fn noise_shrinks_and_edges_stay() {
        let (rendering, truth) = noisy();
        let before = rendering.picture.rmse(&truth).unwrap();
        let picture = denoise(&rendering, &DenoiseSettings::default());
        let after = picture.rmse(&truth).unwrap();
        assert!(after < 0.35 * before, "{before} to {after}");
        // The stripes of the texture keep their contrast.
        let row = |r: usize| (0..48).map(move |c| (c, r));
        for (column, row) in row(5).chain(row(26)) {
            let [found, wanted] = [&picture, &truth].map(|p| p.at(column, row)[0]);
            assert!(
                (found / wanted - 1.0).abs() < 0.35,
                "{column}, {row}: {found} {wanted}"
            );
        }
    }

    #[test]
    fn a_clean_picture_stays_as_it_is() {
        let (mut rendering, truth) = noisy();
        rendering.picture = truth.clone();
        rendering.halves = [truth.clone(), truth.clone()];
        rendering.variance.pixels.fill([0.0; 3]);
        let picture = denoise(&rendering, &DenoiseSettings::default());
        assert!(picture.rmse(&truth).unwrap() < 1e-4);
    }

    /// One path of many that is `factor` times the mean of all pixels after all are averaged.
    fn add_firefly(rendering: &mut Rendering, at: usize, factor: f32) {
        let mean = rendering.picture.mean()[0] as f32;
        let extra = factor * mean;
        for value in &mut rendering.picture.pixels[at] {
            *value += extra;
        }
        for value in &mut rendering.halves[0].pixels[at] {
            *value += 2.0 * extra;
        }
        for value in &mut rendering.variance.pixels[at] {
            *value += extra * extra;
        }
    }

    #[test]
    fn fireflies_leave_no_squares() {
        let (clean, truth) = noisy_by(0.1);
        let settings = DenoiseSettings::default();
        let wanted = denoise(&clean, &settings);
        // In the middle, near another, and in a corner.
        let places = [(20, 10), (25, 12), (47, 31)];
        let mut rendering = clean;
        for ((column, row), factor) in places.iter().zip([1000.0, 50.0, 1000.0]) {
            add_firefly(&mut rendering, row * 48 + column, factor);
        }
        let found = denoise(&rendering, &settings);
        for (at, (found, wanted)) in found.pixels.iter().zip(&wanted.pixels).enumerate() {
            let ratio = found[0] / wanted[0];
            // Spread evenly, 1000 means would be 4.4 means a pixel.
            let place = (at % 48, at / 48);
            assert!((ratio - 1.0).abs() < 0.04, "{place:?}: {ratio}");
        }
        let [before, after] = [&wanted, &found].map(|p| p.rmse(&truth).unwrap());
        assert!(after < 1.05 * before, "{before} to {after}");
    }

    #[test]
    fn what_many_paths_see_is_no_firefly() {
        let (mut rendering, _) = noisy();
        let of = |rendering: &Rendering| {
            let albedo = vec![[1.0; 3]; 48 * 32];
            let halves = [0, 1].map(|half: usize| rendering.halves[half].pixels.clone());
            let of_paths = variance_of_paths(rendering, &albedo);
            trust(&halves, &of_paths, [48, 32], 7)
        };
        assert!(of(&rendering).iter().all(|t| *t == 1.0));
        // A glint that a quarter of 64 paths meet.
        let at = 10 * 48 + 20;
        for picture in [&mut rendering.picture]
            .into_iter()
            .chain(&mut rendering.halves)
        {
            picture.pixels[at] = [300.0; 3];
        }
        rendering.variance.pixels[at] = [300.0f32.powi(2) * 3.0 / 64.0; 3];
        assert!(of(&rendering).iter().all(|t| *t == 1.0));
    }
}
