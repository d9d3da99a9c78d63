//! Joint non-local means filter.
//!
//! All data lie in planes of one value per pixel and are processed row by row, so that loops
//! vectorise. No multiply-add is fused: all processors give the same bits.

use std::ops::Range;

use super::noise::{noise, trust, variance_of_paths};
use super::{Light, add};
use crate::renderer::Rendering;

/// Radius of the patches, px.
const PATCH_RADIUS: usize = 2;
/// Tolerated patch difference, standard deviations of the noise.
const NOISE_TOLERANCE: f32 = 0.6;
/// Albedo difference at which a pixel's weight has fallen to 1/e.
const ALBEDO_TOLERANCE: f32 = 0.2;
/// The same for 1 − cosine between the normals.
const NORMAL_TOLERANCE: f32 = 0.05;
/// The same for the relative depth difference.
const DEPTH_TOLERANCE: f32 = 0.02;
/// Minimum weight of a pixel for itself, so that outliers keep their light.
const MIN_OWN_TRUST: f32 = 1e-6;
/// Distance between environment and surface; exceeds the reach of any weight.
const SKY_DISTANCE: f32 = 1e6;

/// One value per pixel.
type Plane = Vec<f32>;
/// One plane per colour channel.
type Planes = [Plane; 3];

/// Features from which the weights are computed.
pub(super) struct Guide {
    /// Radius of the search window, px.
    radius: usize,
    /// Width and height, px.
    size: [usize; 2],
    /// Light of both halves of the paths.
    halves: [Planes; 2],
    albedo: Planes,
    normal: Planes,
    depth_m: Plane,
    /// 1 / depth; 0 for the environment.
    nearness: Plane,
    /// 1 for the environment, 0 for surfaces.
    sky: Plane,
    /// Variance of the light of one half.
    variance: Plane,
    /// Weight factor of each pixel; below 1 for fireflies.
    trust: Plane,
    /// Weight factor of each pixel for itself.
    own_trust: Plane,
}

/// Buffers reused for every displacement.
struct Scratch {
    /// Pixel distances for both halves, from the first compared column.
    single: [Plane; 2],
    /// Sums of pixel distances over the rows of a patch.
    padded: Plane,
    /// Patch distances for both halves.
    distance: [Plane; 2],
    /// Surface weights of a row.
    same: Plane,
}

impl Scratch {
    fn new(rows: usize, width: usize, patch: usize) -> Self {
        let single = vec![0.0; (rows + 2 * patch) * width];
        let distance = vec![0.0; rows * width];
        Self {
            single: [single.clone(), single],
            padded: vec![0.0; width + 2 * patch],
            distance: [distance.clone(), distance],
            same: vec![0.0; width],
        }
    }
}

/// Run of pixels `p` in a row and the displaced pixels `q` they are compared with.
struct PixelRun {
    p: usize,
    q: usize,
    len: usize,
}

impl Guide {
    /// `halves` is the light of the halves of the paths, demodulated by `albedo`.
    pub(super) fn new(
        rendering: &Rendering,
        radius: usize,
        halves: &[Light; 2],
        albedo: &[[f32; 3]],
    ) -> Self {
        let size = [rendering.image.width, rendering.image.height];
        let of_paths = variance_of_paths(rendering, albedo);
        let trust = trust(halves, &of_paths, size, radius);
        let depth_m = rendering.depth_m.clone();
        let is_surface = |z: &f32| *z > 0.0;
        Self {
            radius,
            size,
            halves: halves.each_ref().map(|light| planes(light)),
            albedo: planes(&rendering.albedo.pixels),
            normal: planes(&rendering.normal.pixels),
            nearness: depth_m
                .iter()
                .map(|z| if is_surface(z) { 1.0 / z } else { 0.0 })
                .collect(),
            sky: depth_m
                .iter()
                .map(|z| if is_surface(z) { 0.0 } else { 1.0 })
                .collect(),
            depth_m,
            variance: noise(halves, &of_paths, &trust, size),
            own_trust: trust.iter().map(|t| t.max(MIN_OWN_TRUST)).collect(),
            trust,
        }
    }

    /// Returns the filtered light of some rows.
    pub(super) fn filter(&self, rows: Range<usize>) -> Vec<[f32; 3]> {
        pulp::Arch::new().dispatch(|| self.filter_lanes(&rows))
    }

    #[inline(always)]
    fn filter_lanes(&self, rows: &Range<usize>) -> Vec<[f32; 3]> {
        let width = self.size[0];
        let mut sums: [[Plane; 4]; 2] = Default::default();
        for plane in sums.as_flattened_mut() {
            plane.resize(rows.len() * width, 0.0);
        }
        let mut scratch = Scratch::new(rows.len(), width, PATCH_RADIUS);
        let radius = self.radius as isize;
        for dy in -radius..=radius {
            for dx in -radius..=radius {
                self.add_moved(rows, [dx, dy], &mut sums, &mut scratch);
            }
        }
        let [a, b] = &sums;
        let mean = |sums: &[Plane; 4], k: usize, at: usize| sums[k][at] / sums[3][at].max(1e-12);
        (0..rows.len() * width)
            .map(|at| std::array::from_fn(|k| 0.5 * (mean(a, k, at) + mean(b, k, at))))
            .collect()
    }

    /// Adds the displaced, weighted pixels to the sums of some rows.
    #[inline(always)]
    fn add_moved(
        &self,
        rows: &Range<usize>,
        by: [isize; 2],
        sums: &mut [[Plane; 4]; 2],
        scratch: &mut Scratch,
    ) {
        let width = self.size[0];
        let columns = self.columns(by[0]);
        if columns.is_empty() {
            return;
        }
        self.patch_distances(rows, &columns, by, scratch);
        let trust = if by == [0, 0] {
            &self.own_trust
        } else {
            &self.trust
        };
        for (line, row) in rows.clone().enumerate() {
            let Some(pair) = self.pair(row, &columns, by) else {
                continue;
            };
            self.same_surface(&pair, trust, &mut scratch.same);
            let at = line * width + columns.start;
            let same = &scratch.same[..pair.len];
            for (half, sums) in sums.iter_mut().enumerate() {
                // The weights of one half come from the other half.
                let distance = &scratch.distance[1 - half][at..][..pair.len];
                let [r, g, b] = three(&self.halves[half], pair.q, pair.len);
                let [r_sum, g_sum, b_sum, weights] =
                    sums.each_mut().map(|sum| &mut sum[at..][..pair.len]);
                for i in 0..pair.len {
                    let weight = same[i] * falloff(distance[i]);
                    r_sum[i] += weight * r[i];
                    g_sum[i] += weight * g[i];
                    b_sum[i] += weight * b[i];
                    weights[i] += weight;
                }
            }
        }
    }

    /// Columns that stay in the image after a displacement.
    fn columns(&self, dx: isize) -> Range<usize> {
        let first = (-dx).max(0);
        let last = self.size[0] as isize - dx.max(0);
        first as usize..last.max(first) as usize
    }

    /// Pixels of a row with their displaced counterparts, if these lie in the image.
    #[inline(always)]
    fn pair(&self, row: usize, columns: &Range<usize>, [dx, dy]: [isize; 2]) -> Option<PixelRun> {
        let [width, height] = self.size;
        let other = row.checked_add_signed(dy).filter(|other| *other < height)?;
        Some(PixelRun {
            p: row * width + columns.start,
            q: (other * width + columns.start).wrapping_add_signed(dx),
            len: columns.len(),
        })
    }

    /// Computes for each pixel of some rows the distance between its patch and the displaced one,
    /// beyond the expected noise.
    #[inline(always)]
    fn patch_distances(
        &self,
        rows: &Range<usize>,
        columns: &Range<usize>,
        by: [isize; 2],
        scratch: &mut Scratch,
    ) {
        let [width, height] = self.size;
        let (patch, len) = (PATCH_RADIUS, columns.len());
        let above = rows.start.saturating_sub(patch);
        for row in above..height.min(rows.end + patch) {
            if let Some(pair) = self.pair(row, columns, by) {
                let at = (row - above) * width;
                let single = scratch.single.each_mut().map(|s| &mut s[at..][..len]);
                self.pixel_distances(&pair, single);
            }
        }
        let side = 2 * patch + 1;
        let scale = 1.0 / (NOISE_TOLERANCE * NOISE_TOLERANCE);
        for (line, row) in rows.clone().enumerate() {
            let near = row.saturating_sub(patch)..height.min(row + patch + 1);
            let lines = near.filter(|row| self.pair(*row, columns, by).is_some());
            let whole = scale / (side * lines.clone().count().max(1)) as f32;
            for half in 0..2 {
                // Pixels beside the columns contribute nothing.
                scratch.padded[..len + 2 * patch].fill(0.0);
                for row in lines.clone() {
                    let single = &scratch.single[half][(row - above) * width..][..len];
                    add(&mut scratch.padded[patch..][..len], single);
                }
                let out = &mut scratch.distance[half][line * width + columns.start..][..len];
                out.fill(0.0);
                for k in 0..side {
                    add(out, &scratch.padded[k..][..len]);
                }
                out.iter_mut().for_each(|value| *value *= whole);
                // Patches are truncated at the image sides.
                for i in (0..len.min(patch)).chain(len.saturating_sub(patch).max(patch)..len) {
                    let found = (i + patch + 1).min(len) - i.saturating_sub(patch);
                    out[i] *= side as f32 / found as f32;
                }
            }
        }
    }

    /// Squared difference of pixels less the expected noise, in units of the noise, for both
    /// halves. Fireflies are ignored.
    #[inline(always)]
    fn pixel_distances(&self, &PixelRun { p, q, len }: &PixelRun, [a, b]: [&mut [f32]; 2]) {
        let [vp, vq] = [p, q].map(|at| &self.variance[at..][..len]);
        let [tp, tq] = [p, q].map(|at| &self.trust[at..][..len]);
        let [[ap, aq], [bp, bq]] = self
            .halves
            .each_ref()
            .map(|light| [p, q].map(|at| three(light, at, len)));
        for i in 0..len {
            let expected = vp[i] + min(vp[i], vq[i]);
            let scale = min(tp[i], tq[i]) / (vp[i] + vq[i] + 1e-6);
            a[i] = scale * (square_distance(ap, aq, i) / 3.0 - expected);
            b[i] = scale * (square_distance(bp, bq, i) / 3.0 - expected);
        }
    }

    /// Surface weight (1 for the same first surface, 0 for different ones) times the weight factor
    /// of the displaced pixel.
    #[inline(always)]
    fn same_surface(&self, &PixelRun { p, q, len }: &PixelRun, trust: &[f32], out: &mut [f32]) {
        let [zp, zq] = [p, q].map(|at| &self.depth_m[at..][..len]);
        let [sp, sq] = [p, q].map(|at| &self.sky[at..][..len]);
        let nearness = &self.nearness[p..][..len];
        let trust = &trust[q..][..len];
        let out = &mut out[..len];
        let [ap, aq] = [p, q].map(|at| three(&self.albedo, at, len));
        let [np, nq] = [p, q].map(|at| three(&self.normal, at, len));
        let by_albedo = 1.0 / (ALBEDO_TOLERANCE * ALBEDO_TOLERANCE);
        let by_normal = 0.5 / NORMAL_TOLERANCE;
        let by_depth = 1.0 / DEPTH_TOLERANCE;
        for i in 0..len {
            let depth = (zp[i] - zq[i]) * nearness[i] * by_depth;
            let sky = (sp[i] - sq[i]) * SKY_DISTANCE;
            let distance = square_distance(ap, aq, i) * by_albedo
                + square_distance(np, nq, i) * by_normal
                + depth * depth
                + sky * sky;
            out[i] = falloff(distance) * trust[i];
        }
    }
}

fn planes(pixels: &[[f32; 3]]) -> Planes {
    std::array::from_fn(|k| pixels.iter().map(|pixel| pixel[k]).collect())
}

/// Returns a run of three planes.
#[inline(always)]
fn three(planes: &Planes, at: usize, len: usize) -> [&[f32]; 3] {
    planes.each_ref().map(|plane| &plane[at..][..len])
}

#[inline(always)]
fn square_distance(a: [&[f32]; 3], b: [&[f32]; 3], i: usize) -> f32 {
    let [x, y, z] = [a[0][i] - b[0][i], a[1][i] - b[1][i], a[2][i] - b[2][i]];
    x * x + y * y + z * z
}

/// Compiles to a single instruction, unlike `f32::min`.
#[inline(always)]
fn min(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

#[inline(always)]
fn positive(a: f32) -> f32 {
    if a > 0.0 { a } else { 0.0 }
}

/// Weight of a distance: close to exp(-x), 0 from x = 4 on.
#[inline(always)]
fn falloff(distance: f32) -> f32 {
    let base = positive(1.0 - 0.25 * positive(distance));
    let square = base * base;
    square * square
}
