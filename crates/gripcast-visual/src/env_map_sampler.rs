//! Environment map prepared for importance sampling of directions by luminance.
//!
//! Between four texel centres radiance is bilinear, and so is the sampling density: luminance times
//! the sine of the polar angle at each row of centres. A patch between centres is selected by
//! inverting cumulative distributions, which keeps low-discrepancy points well distributed, and the
//! position in it by inverting two linear densities. Cache misses dominate the cost, so the tables
//! are small: cumulative sums over groups of patches only, 8-byte texels.

use std::f32::consts::PI;

use glam::{Vec3, Vec4};

use super::env_map::EnvMap;
use super::linear_image::luminance;
use super::trigonometry::{sin_cos_turns, turns_of};

/// Minimum sine of the polar angle in densities.
const MIN_SINE: f32 = 1e-6;

/// Radiance from a direction, with its sampling density.
#[derive(Clone, Copy, Debug)]
pub(super) struct EnvSample {
    /// Unit vector towards the light.
    pub(super) direction: Vec3,
    pub(super) radiance: Vec3,
    /// Sampling density of the direction, 1/sr.
    pub(super) pdf: f32,
}

impl EnvSample {
    /// Carries no light.
    pub(super) const NONE: Self = Self {
        direction: Vec3::ZERO,
        radiance: Vec3::ZERO,
        pdf: 0.0,
    };
}

/// Patches of a row per entry of the cumulative distribution.
const GROUP: usize = 4;

/// Guide intervals per entry.
const INTERVALS: usize = 2;

/// Radiance of a texel: three 18-bit mantissas and their common exponent.
#[derive(Clone, Copy, Debug)]
struct Texel(u64);

impl Texel {
    const BITS: u32 = 18;
    const MASK: u64 = (1 << Self::BITS) - 1;
    /// Radiance below this is stored as 0.
    const MIN: f32 = 1e-30;

    fn new(rgb: [f32; 3]) -> Self {
        let largest = rgb.into_iter().fold(0.0, f32::max);
        if largest < Self::MIN {
            return Self(0);
        }
        // Exponent field of the quantisation step, a power of two.
        let step = (largest.to_bits() >> 23) + 1 - Self::BITS;
        let unit = f32::from_bits(step << 23);
        let [r, g, b] = rgb.map(|v| ((v / unit).round() as u64).min(Self::MASK));
        Self(u64::from(step) << (3 * Self::BITS) | b << (2 * Self::BITS) | g << Self::BITS | r)
    }

    /// Returns red, green, blue and luminance.
    #[inline(always)]
    fn decode(self) -> Vec4 {
        let unit = f32::from_bits(((self.0 >> (3 * Self::BITS)) as u32) << 23);
        let r = (self.0 & Self::MASK) as i32 as f32;
        let g = (self.0 >> Self::BITS & Self::MASK) as i32 as f32;
        let b = (self.0 >> (2 * Self::BITS) & Self::MASK) as i32 as f32;
        Vec4::new(r, g, b, luminance([r, g, b])) * unit
    }
}

/// Cumulative distributions with the same number of entries.
#[derive(Debug)]
struct CdfTable {
    entries: usize,
    /// `entries + 1` values from 0 to 1 for each distribution.
    sums: Vec<f32>,
    /// For each of `INTERVALS * entries` equal intervals of [0, 1), the entry that contains its
    /// start.
    guide: Vec<u16>,
}

/// Samples and evaluates an environment map.
#[derive(Debug)]
pub(super) struct EnvMapSampler {
    width: usize,
    height: usize,
    /// Row by row.
    texels: Vec<Texel>,
    /// Sine of the polar angle at the edges of the rows of patches: the poles and the rows of texel
    /// centres.
    sines: Vec<f32>,
    /// Distribution over the rows of patches.
    rows: CdfTable,
    /// Distribution over the groups of patches of each row.
    groups: CdfTable,
    /// 1 / integral of the density over the unit square; 0 for a black map.
    inverse_total: f32,
    /// Rotation, turns.
    rotation_turns: f32,
}

/// Position in a patch; `fx` and `fy` run from 0 to 1.
struct PatchPoint {
    row: usize,
    column: usize,
    fx: f32,
    fy: f32,
}

impl CdfTable {
    fn new(entries: usize, distributions: usize) -> Self {
        Self {
            entries,
            sums: Vec::with_capacity((entries + 1) * distributions),
            guide: Vec::with_capacity(INTERVALS * entries * distributions),
        }
    }

    /// Appends a distribution proportional to `weights`; returns their sum.
    fn push(&mut self, weights: impl Iterator<Item = f64> + Clone) -> f64 {
        let total: f64 = weights.clone().sum();
        let scale = if total > 0.0 { 1.0 / total } else { 0.0 };
        let first = self.sums.len();
        let mut sum = 0.0;
        self.sums.push(0.0);
        for weight in weights {
            sum += weight;
            self.sums.push(((sum * scale) as f32).min(1.0));
        }
        let sums = &self.sums[first..];
        let mut entry = 0;
        for interval in 0..INTERVALS * self.entries {
            let start = interval as f32 / (INTERVALS * self.entries) as f32;
            while entry + 1 < self.entries && sums[entry + 1] <= start {
                entry += 1;
            }
            self.guide.push(entry as u16);
        }
        total
    }

    /// Returns the entry of a distribution that contains `u` in [0, 1), and the position in the
    /// entry.
    #[inline(always)]
    fn invert(&self, distribution: usize, u: f32) -> (usize, f32) {
        let intervals = INTERVALS * self.entries;
        let interval = ((u * intervals as f32) as usize).min(intervals - 1);
        let mut entry = usize::from(self.guide[distribution * intervals + interval]);
        let sums = &self.sums[distribution * (self.entries + 1)..][..self.entries + 1];
        // The first steps are branchless: a mispredicted branch that waits for memory would end the
        // overlap with the next lookup. The last value is 1 and never passed.
        entry += usize::from(sums[entry + 1] <= u);
        entry += usize::from(sums[(entry + 1).min(self.entries)] <= u);
        while entry + 1 < self.entries && sums[entry + 1] <= u {
            entry += 1;
        }
        let entry = entry.min(self.entries - 1);
        let (low, high) = (sums[entry], sums[entry + 1]);
        let width = high - low;
        let within = if width > 0.0 { (u - low) / width } else { 0.5 };
        (entry, within.clamp(0.0, 1.0))
    }
}

/// Inverts the CDF of the density on [0, 1] that runs linearly from `a` to `b`.
#[inline(always)]
fn invert_linear(a: f32, b: f32, u: f32) -> f32 {
    let root = (a * a + (b * b - a * a) * u).max(0.0).sqrt();
    let t = u * (a + b) / (a + root);
    if t.is_finite() { t.min(1.0) } else { u }
}

#[inline(always)]
fn lerp(a: f32, b: f32, t: f32) -> f32 {
    a + (b - a) * t
}

impl EnvMapSampler {
    /// Prepares a valid environment map.
    pub(super) fn new(env_map: &EnvMap) -> Self {
        let (width, height) = (env_map.map.width, env_map.map.height);
        let texel = |p: &[f32; 3]| {
            // Clamps radiance to the range of [`Texel`].
            Texel::new(p.map(|v| (v * env_map.intensity).min(1e30)))
        };
        let edge = |e: usize| (e as f64 - 0.5).clamp(0.0, height as f64) / height as f64;
        let sines: Vec<f32> = (0..height + 2)
            .map(|e| (std::f64::consts::PI * edge(e)).sin() as f32)
            .collect();
        let mut sampler = Self {
            width,
            height,
            texels: env_map.map.pixels.iter().map(texel).collect(),
            sines,
            rows: CdfTable::new(height + 1, 1),
            groups: CdfTable::new(0, 0),
            inverse_total: 0.0,
            rotation_turns: (env_map.rotation_rad / (2.0 * PI)).rem_euclid(1.0),
        };
        let group_count = width.div_ceil(GROUP);
        let mut groups = CdfTable::new(group_count, height + 1);
        let mut masses = Vec::with_capacity(height + 1);
        for row in 0..=height {
            let weight = |column: usize| {
                let [a, b, c, d] = sampler.corners(row, column).map(|t| f64::from(t.w));
                let [top, bottom] = [row, row + 1].map(|e| f64::from(sampler.sines[e]));
                0.25 * (top * (a + b) + bottom * (c + d))
            };
            let group = |g: usize| (g * GROUP..width.min((g + 1) * GROUP)).map(weight).sum();
            let weights: Vec<f64> = (0..group_count).map(group).collect();
            let mass = groups.push(weights.into_iter());
            masses.push(mass * (edge(row + 1) - edge(row)) / width as f64);
        }
        sampler.groups = groups;
        let total = sampler.rows.push(masses.iter().copied());
        if total > 0.0 {
            sampler.inverse_total = (1.0 / total) as f32;
        }
        sampler
    }

    /// Returns the corner texels of a patch: top left, top right, bottom left, bottom right.
    #[inline(always)]
    fn corners(&self, row: usize, column: usize) -> [Vec4; 4] {
        let next = if column + 1 == self.width {
            0
        } else {
            column + 1
        };
        let top = row.saturating_sub(1) * self.width;
        let bottom = row.min(self.height - 1) * self.width;
        [
            self.texels[top + column].decode(),
            self.texels[top + next].decode(),
            self.texels[bottom + column].decode(),
            self.texels[bottom + next].decode(),
        ]
    }

    /// Selects a patch of a group in proportion to its weight; returns its column, the rescaled
    /// random number, and its corners.
    #[inline(always)]
    fn select_patch(&self, row: usize, group: usize, u: f32) -> (usize, f32, [Vec4; 4]) {
        let first = group * GROUP;
        let count = GROUP.min(self.width - first);
        let top = row.saturating_sub(1) * self.width;
        let bottom = row.min(self.height - 1) * self.width;
        let [sine_top, sine_bottom] = [self.sines[row], self.sines[row + 1]];
        let mut above = [Vec4::ZERO; GROUP + 1];
        let mut below = [Vec4::ZERO; GROUP + 1];
        // Absent patches are never selected.
        let mut sums = [f32::INFINITY; GROUP + 1];
        sums[0] = 0.0;
        for k in 0..=count {
            let column = first + k;
            let column = if column == self.width { 0 } else { column };
            above[k] = self.texels[top + column].decode();
            below[k] = self.texels[bottom + column].decode();
            if k > 0 {
                let weight = sine_top * (above[k - 1].w + above[k].w)
                    + sine_bottom * (below[k - 1].w + below[k].w);
                sums[k] = sums[k - 1] + weight;
            }
        }
        let target = u * sums[count];
        let mut k = 0;
        for end in &sums[1..GROUP] {
            k += usize::from(*end <= target);
        }
        let k = k.min(count - 1);
        let width = sums[k + 1] - sums[k];
        let rest = if width > 0.0 {
            (target - sums[k]) / width
        } else {
            0.5
        };
        let corners = [above[k], above[k + 1], below[k], below[k + 1]];
        (first + k, rest.clamp(0.0, 1.0), corners)
    }

    /// Evaluates radiance and density at a point of the patch with the given corners.
    #[inline(always)]
    fn eval_patch(&self, point: &PatchPoint, corners: &[Vec4; 4], direction: Vec3) -> EnvSample {
        let [a, b, c, d] = *corners;
        let top = a + (b - a) * point.fx;
        let bottom = c + (d - c) * point.fx;
        let radiance = top + (bottom - top) * point.fy;
        let density = lerp(
            self.sines[point.row] * top.w,
            self.sines[point.row + 1] * bottom.w,
            point.fy,
        );
        let flat = direction.x * direction.x + direction.y * direction.y;
        let sine = flat.sqrt().max(MIN_SINE);
        EnvSample {
            direction,
            radiance: radiance.truncate(),
            pdf: density * self.inverse_total / (2.0 * PI * PI * sine),
        }
    }

    /// Returns the radiance from a unit direction with its sampling density.
    #[inline(always)]
    pub(super) fn eval(&self, direction: Vec3) -> EnvSample {
        let azimuth = turns_of(direction.y, direction.x);
        let u = 0.5 - azimuth + self.rotation_turns;
        let flat = (direction.x * direction.x + direction.y * direction.y).sqrt();
        let v = 2.0 * turns_of(flat, direction.z);
        let x = (u - u.floor()) * self.width as f32 - 0.5;
        let low = x.floor();
        let column = if low < 0.0 {
            self.width - 1
        } else {
            low as usize
        };
        let y = v * self.height as f32 + 0.5;
        let row = (y as usize).min(self.height);
        let fy = y - row as f32;
        let fy = if row == 0 {
            2.0 * fy - 1.0
        } else if row == self.height {
            2.0 * fy
        } else {
            fy
        };
        let point = PatchPoint {
            row,
            column: column.min(self.width - 1),
            fx: x - low,
            fy: fy.clamp(0.0, 1.0),
        };
        self.eval_patch(&point, &self.corners(point.row, point.column), direction)
    }

    /// Samples a direction in proportion to luminance from two numbers in [0, 1).
    #[inline(always)]
    pub(super) fn sample(&self, [u1, u2]: [f32; 2]) -> EnvSample {
        let (row, u1) = self.rows.invert(0, u1);
        let (group, u2) = self.groups.invert(row, u2);
        let (column, u2, corners) = self.select_patch(row, group, u2);
        let [a, b, c, d] = [corners[0].w, corners[1].w, corners[2].w, corners[3].w];
        let [top, bottom] = [self.sines[row], self.sines[row + 1]];
        let fy = invert_linear(top * (a + b), bottom * (c + d), u1);
        let left = lerp(top * a, bottom * c, fy);
        let right = lerp(top * b, bottom * d, fy);
        let fx = invert_linear(left, right, u2);
        let y = if row == 0 {
            0.5 * (fy + 1.0)
        } else if row == self.height {
            row as f32 + 0.5 * fy
        } else {
            row as f32 + fy
        };
        let u = (column as f32 + 0.5 + fx) / self.width as f32;
        let v = (y - 0.5) / self.height as f32;
        let azimuth = 0.5 - u + self.rotation_turns;
        let (sin_azimuth, cos_azimuth) = sin_cos_turns(azimuth - azimuth.floor());
        let (sin_polar, cos_polar) = sin_cos_turns(0.5 * v);
        let direction = Vec3::new(sin_polar * cos_azimuth, sin_polar * sin_azimuth, cos_polar);
        let point = PatchPoint {
            row,
            column,
            fx,
            fy,
        };
        self.eval_patch(&point, &corners, direction)
    }
}

#[cfg(test)]
#[path = "env_map_sampler_test.rs"]
mod tests;
