//! Deformation of the gel around an object as an obstacle problem.
//!
//! The face is a stretched membrane on an elastic foundation, indented by the object: u minimises ∫
//! λ²|∇u|² + u² subject to u ≥ h, with the object's depth h below the untouched face. Where the
//! face is free, u = λ²∇²u: it leaves the object without a kink and decays over the length λ. A
//! ball in contact over the radius a sinks by a further λ · tan φ · K₀(a/λ)/K₁(a/λ), with the slope
//! φ at the border (modified Bessel functions).
//!
//! Solved coarse to fine by red-black projected SOR down to half the resolution; on the full grid u
//! is the maximum of h and the interpolation.

use super::bessel::{k0, k1};

/// Sweeps per level; each level starts from the coarser one.
const SWEEPS: usize = 10;
/// Over-relaxation factor.
const OMEGA: f32 = 1.4;
/// Minimum shorter side of the coarsest level, pixels.
const MIN_COARSE_SIDE: usize = 6;

/// Depth of the border of a ball's contact below the untouched face, m.
///
/// `contact_m` is the contact radius, `ball_m` the ball radius, `length_m` the length λ.
pub fn ball_sink_m(contact_m: f64, ball_m: f64, length_m: f64) -> f64 {
    if length_m <= 0.0 || contact_m <= 0.0 {
        return 0.0;
    }
    let slope = contact_m / (ball_m * ball_m - contact_m * contact_m).max(0.0).sqrt();
    let x = contact_m / length_m;
    slope * length_m * k0(x) / k1(x)
}

/// Multigrid levels, coarsest last; level 0 has half the resolution of the image.
#[derive(Clone, Debug)]
pub(super) struct Membrane {
    length_px: f64,
    levels: Vec<Level>,
    red_black: RedBlack,
}

#[derive(Clone, Debug, Default)]
struct Level {
    width: usize,
    height: usize,
    obstacle: Vec<f32>,
    face: Vec<f32>,
}

impl Membrane {
    /// Prepares a membrane of length λ, pixels.
    pub(super) fn new(length_px: f64) -> Self {
        Self {
            length_px,
            levels: Vec::new(),
            red_black: RedBlack::default(),
        }
    }

    /// Replaces the object's depth by the depth of the face, in place.
    pub(super) fn solve(&mut self, depth: &mut [f32], width: usize) {
        if self.length_px <= 0.0 || depth.iter().all(|d| *d == 0.0) {
            return;
        }
        self.allocate(width, depth.len() / width);
        downsample(depth, width, &mut self.levels[0]);
        for i in 1..self.levels.len() {
            let (finer, coarser) = self.levels.split_at_mut(i);
            let finer = &finer[i - 1];
            downsample(&finer.obstacle, finer.width, &mut coarser[0]);
        }
        for i in (0..self.levels.len()).rev() {
            let length = self.length_px / (2 << i) as f64;
            let (finer, coarser) = self.levels.split_at_mut(i + 1);
            let level = &mut finer[i];
            match coarser.first() {
                Some(coarser) => {
                    level.face.copy_from_slice(&level.obstacle);
                    upsample_max(&mut level.face, level.width, coarser);
                }
                None => level.face.copy_from_slice(&level.obstacle),
            }
            level.relax((length * length) as f32, &mut self.red_black);
        }
        upsample_max(depth, width, &self.levels[0]);
    }

    fn allocate(&mut self, width: usize, height: usize) {
        let (mut w, mut h) = (width.div_ceil(2), height.div_ceil(2));
        if self
            .levels
            .first()
            .is_some_and(|level| (level.width, level.height) == (w, h))
        {
            return;
        }
        self.levels.clear();
        loop {
            self.levels.push(Level {
                width: w,
                height: h,
                obstacle: vec![0.0; w * h],
                face: vec![0.0; w * h],
            });
            if w.min(h) < 2 * MIN_COARSE_SIDE {
                return;
            }
            (w, h) = (w.div_ceil(2), h.div_ceil(2));
        }
    }
}

impl Level {
    fn relax(&mut self, length_square: f32, red_black: &mut RedBlack) {
        let weight = length_square / (1.0 + 4.0 * length_square);
        red_black.split(self);
        for sweep in 0..2 * SWEEPS {
            for y in 0..self.height {
                red_black.relax_row(y, (y + sweep) % 2, weight);
            }
        }
        red_black.merge(&mut self.face);
    }
}

/// Even and odd columns of a level as separate planes: the pixels of one colour of a row are
/// contiguous.
#[derive(Clone, Debug, Default)]
struct RedBlack {
    height: usize,
    widths: [usize; 2],
    obstacle: [Vec<f32>; 2],
    face: [Vec<f32>; 2],
    /// The columns of a row at the border, which replicates them.
    border: Vec<f32>,
}

impl RedBlack {
    fn split(&mut self, level: &Level) {
        self.height = level.height;
        self.widths = [level.width.div_ceil(2), level.width / 2];
        let planes = [
            (&level.obstacle, &mut self.obstacle),
            (&level.face, &mut self.face),
        ];
        for (plane, halves) in planes {
            for (first, half) in halves.iter_mut().enumerate() {
                half.clear();
                for row in plane.chunks_exact(level.width) {
                    half.extend(row.iter().skip(first).step_by(2));
                }
            }
        }
    }

    fn merge(&self, face: &mut [f32]) {
        let [even, odd] = self.widths;
        for (y, row) in face.chunks_exact_mut(even + odd).enumerate() {
            for (first, half) in self.face.iter().enumerate() {
                let columns = row.iter_mut().skip(first).step_by(2);
                for (to, from) in columns.zip(&half[y * self.widths[first]..]) {
                    *to = *from;
                }
            }
        }
    }

    /// Relaxes the even columns of a row, or the odd ones; replicated border.
    fn relax_row(&mut self, y: usize, odd: usize, weight: f32) {
        let (width, other_width) = (self.widths[odd], self.widths[1 - odd]);
        let [evens, odds] = &mut self.face;
        let (own, other) = match odd {
            0 => (evens, odds),
            _ => (odds, evens),
        };
        let other = &other[y * other_width..][..other_width];
        let obstacle = &self.obstacle[odd][y * width..][..width];
        let (before, rest) = own.split_at_mut(y * width);
        let (row, after) = rest.split_at_mut(width);
        let is_last = y + 1 == self.height;
        if y == 0 || is_last {
            self.border.clear();
            self.border.extend_from_slice(row);
        }
        let above = match y {
            0 => &self.border[..],
            _ => &before[(y - 1) * width..],
        };
        let below = match is_last {
            true => &self.border[..],
            false => &after[..width],
        };
        let relaxed = |old: f32, [left, right, above, below]: [f32; 4], obstacle: f32| {
            let free = old + OMEGA * (weight * (left + right + above + below) - old);
            free.max(obstacle)
        };
        // Column i + first lies between the other columns i and i + 1.
        let first = 1 - odd;
        let inner = width
            .saturating_sub(first)
            .min(other_width.saturating_sub(1));
        for x in (0..first.min(width)).chain(first + inner..width) {
            let beside = |at: Option<usize>| at.and_then(|at| other.get(at)).copied();
            let left = beside((x + odd).checked_sub(1)).unwrap_or(row[x]);
            let right = beside(Some(x + odd)).unwrap_or(row[x]);
            row[x] = relaxed(row[x], [left, right, above[x], below[x]], obstacle[x]);
        }
        if inner == 0 {
            return;
        }
        let (left, right) = (&other[..inner], &other[1..][..inner]);
        let columns = first..first + inner;
        let (above, below) = (&above[columns.clone()], &below[columns.clone()]);
        let (row, obstacle) = (&mut row[columns.clone()], &obstacle[columns]);
        for i in 0..inner {
            let neighbours = [left[i], right[i], above[i], below[i]];
            row[i] = relaxed(row[i], neighbours, obstacle[i]);
        }
    }
}

/// Averages 2 × 2 pixels into a level's obstacle.
fn downsample(fine: &[f32], width: usize, coarse: &mut Level) {
    for (rows, out) in fine
        .chunks(2 * width)
        .zip(coarse.obstacle.chunks_exact_mut(coarse.width))
    {
        let (upper, lower) = rows.split_at(width);
        // An odd last row or column counts twice.
        let lower = if lower.is_empty() { upper } else { lower };
        for (out, (u, l)) in out.iter_mut().zip(upper.chunks(2).zip(lower.chunks(2))) {
            *out = 0.25 * (u[0] + u[u.len() - 1] + l[0] + l[l.len() - 1]);
        }
    }
}

/// Raises a plane to the interpolation of a level of half its resolution.
fn upsample_max(fine: &mut [f32], width: usize, coarse: &Level) {
    let mut blended = vec![0.0f32; coarse.width];
    for (y, row) in fine.chunks_exact_mut(width).enumerate() {
        let near = &coarse.face[y / 2 * coarse.width..][..coarse.width];
        let other = adjacent_row(y, coarse.height) * coarse.width;
        let far = &coarse.face[other..][..coarse.width];
        for (out, (near, far)) in blended.iter_mut().zip(near.iter().zip(far)) {
            *out = 0.75 * near + 0.25 * far;
        }
        for (x, pixels) in row.chunks_mut(2).enumerate() {
            let left = 0.25 * blended[x.saturating_sub(1)] + 0.75 * blended[x];
            pixels[0] = pixels[0].max(left);
            if let Some(pixel) = pixels.get_mut(1) {
                let right = 0.25 * blended[(x + 1).min(coarse.width - 1)] + 0.75 * blended[x];
                *pixel = pixel.max(right);
            }
        }
    }
}

/// Returns the coarse row on the other side of fine row `y`.
fn adjacent_row(y: usize, height: usize) -> usize {
    if y.is_multiple_of(2) {
        (y / 2).saturating_sub(1)
    } else {
        (y / 2 + 1).min(height - 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ball pressed until its contact has the radius `a`, all in pixels.
    fn pressed(width: usize, height: usize, a: f64, ball: f64, length: f64) -> Vec<f32> {
        let sink = ball_sink_m(a, ball, length);
        let border = (ball * ball - a * a).sqrt();
        let depth = |i: usize| {
            let x = (i % width) as f64 - 0.5 * (width as f64 - 1.0);
            let y = (i / width) as f64 - 0.5 * (height as f64 - 1.0);
            let square = ball * ball - x * x - y * y;
            if square <= 0.0 {
                return 0.0;
            }
            (square.sqrt() - border + sink).max(0.0) as f32
        };
        (0..width * height).map(depth).collect()
    }

    #[test]
    fn pressed_ball_matches_closed_form() {
        let (width, height, a, ball, length) = (320, 240, 40.0, 46.0, 20.0);
        let object = pressed(width, height, a, ball, length);
        let mut face = object.clone();
        Membrane::new(length).solve(&mut face, width);
        let sink = ball_sink_m(a, ball, length);
        for i in 0..face.len() {
            let x = (i % width) as f64 - 159.5;
            let y = (i / width) as f64 - 119.5;
            let d = x.hypot(y);
            let expected = if d < a {
                f64::from(object[i])
            } else {
                sink * k0(d / length) / k0(a / length)
            };
            let error = (f64::from(face[i]) - expected).abs();
            assert!(error < 0.05 * sink, "{d}: {} {expected}", face[i]);
        }
    }

    #[test]
    fn face_stays_below_object_and_length_0_is_identity() {
        let object = pressed(101, 77, 20.0, 30.0, 9.0);
        let mut face = object.clone();
        Membrane::new(9.0).solve(&mut face, 101);
        assert!(face.iter().zip(&object).all(|(u, h)| u >= h));
        let mut same = object.clone();
        Membrane::new(0.0).solve(&mut same, 101);
        assert_eq!(same, object);
    }

    #[test]
    fn relaxation_equals_sor_pixel_by_pixel() {
        for (width, height) in [(1, 1), (1, 4), (2, 3), (3, 1), (4, 4), (7, 5), (40, 9)] {
            let object: Vec<f32> = (0..width * height)
                .map(|i| ((i * 37 % 11) as f32 - 6.0).max(0.0))
                .collect();
            let mut level = Level {
                width,
                height,
                obstacle: object.clone(),
                face: object.clone(),
            };
            level.relax(4.0, &mut RedBlack::default());
            let weight = 4.0 / (1.0 + 4.0 * 4.0);
            let mut face = object.clone();
            for sweep in 0..2 * SWEEPS {
                for y in 0..height {
                    for x in ((y + sweep) % 2..width).step_by(2) {
                        let at = |x: usize, y: usize| face[y * width + x];
                        let sum = at(x.saturating_sub(1), y)
                            + at((x + 1).min(width - 1), y)
                            + at(x, y.saturating_sub(1))
                            + at(x, (y + 1).min(height - 1));
                        let free = at(x, y) + OMEGA * (weight * sum - at(x, y));
                        face[y * width + x] = free.max(object[y * width + x]);
                    }
                }
            }
            assert_eq!(level.face, face, "{width}×{height}");
        }
    }

    #[test]
    fn odd_and_tiny_grids_work() {
        for (width, height) in [(1, 1), (2, 2), (3, 1), (13, 7)] {
            let mut face = vec![0.0; width * height];
            face[0] = 1.0;
            Membrane::new(3.0).solve(&mut face, width);
            assert!(face.iter().all(|u| (0.0..=1.0).contains(u)));
        }
    }
}
