//! Tileable noise: every function has period 1 along x and y.
//!
//! Lattice values are computed once, since an image reads each of them often.

use gripcast_base::random::lattice;

/// Value noise with quintic interpolation, 0 to 1.
pub(super) struct ValueNoise {
    cells: [usize; 2],
    /// Values at the lattice points, row-major.
    levels: Vec<f32>,
}

impl ValueNoise {
    /// Noise on a lattice of `cells` × `cells` cells in the unit square.
    pub(super) fn new(seed: u64, cells: [u32; 2]) -> Self {
        let [nx, ny] = cells.map(|n| i64::from(n.max(1)));
        let layer = nx * 8191 + ny;
        let row = |y| (0..nx).map(move |x| lattice(seed, x, y, layer));
        Self {
            cells: [nx, ny].map(|n| n as usize),
            levels: (0..ny).flat_map(row).collect(),
        }
    }

    pub(super) fn at(&self, x: f32, y: f32) -> f32 {
        let along = |c: f32, n: usize| {
            let scaled = wrapped(c) * n as f32;
            let low = (scaled as usize).min(n - 1);
            let t = scaled - low as f32;
            let smooth = t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
            (low, if low + 1 == n { 0 } else { low + 1 }, smooth)
        };
        let [nx, ny] = self.cells;
        let (x0, x1, tx) = along(x, nx);
        let (y0, y1, ty) = along(y, ny);
        let at = |x: usize, y: usize| self.levels[y * nx + x];
        let low = mix(at(x0, y0), at(x1, y0), tx);
        let high = mix(at(x0, y1), at(x1, y1), tx);
        mix(low, high, ty)
    }
}

/// Fractal noise: octaves of value noise, each twice as fine and half as strong, 0 to 1.
pub(super) struct FractalNoise {
    octaves: Vec<ValueNoise>,
}

impl FractalNoise {
    /// The coarsest octave has `cells` × `cells` cells in the unit square.
    pub(super) fn new(seed: u64, cells: [u32; 2], octaves: u32) -> Self {
        let octave =
            |o: u32| ValueNoise::new(seed.wrapping_add(u64::from(o)), cells.map(|n| n << o));
        Self {
            octaves: (0..octaves).map(octave).collect(),
        }
    }

    pub(super) fn at(&self, x: f32, y: f32) -> f32 {
        let (mut sum, mut weights, mut weight) = (0.0, 0.0, 1.0);
        for octave in &self.octaves {
            sum += weight * octave.at(x, y);
            weights += weight;
            weight *= 0.5;
        }
        sum / weights
    }
}

/// Cellular noise: one random point per cell (Worley, 1996).
pub(super) struct WorleyNoise {
    count: i64,
    /// Position in its cell and a random number in [0, 1) of each point, row-major.
    points: Vec<[f32; 3]>,
}

impl WorleyNoise {
    /// Noise with `count` × `count` cells in the unit square.
    pub(super) fn new(seed: u64, count: u32) -> Self {
        let n = i64::from(count.max(1));
        let point = |x, y| [1, 2, 3].map(|z| lattice(seed, x, y, z));
        Self {
            count: n,
            points: (0..n)
                .flat_map(|y| (0..n).map(move |x| point(x, y)))
                .collect(),
        }
    }

    /// Returns the distances to the nearest and second nearest point, in cells, and the random
    /// number of the nearest.
    pub(super) fn at(&self, x: f32, y: f32) -> (f32, f32, f32) {
        let n = self.count;
        let (sx, sy) = (wrapped(x) * n as f32, wrapped(y) * n as f32);
        let (cx, cy) = (sx as i64, sy as i64);
        let around = |c: i64| match c {
            c if c < 0 => c + n,
            c if c >= n => (c - n).min(n - 1),
            c => c,
        };
        let mut best = (f32::MAX, f32::MAX, 0.0);
        for j in cy - 1..=cy + 1 {
            let row = around(j) * n;
            for i in cx - 1..=cx + 1 {
                let [px, py, number] = self.points[(row + around(i)) as usize];
                let distance = (i as f32 + px - sx).hypot(j as f32 + py - sy);
                if distance < best.0 {
                    best = (distance, best.0, number);
                } else if distance < best.1 {
                    best.1 = distance;
                }
            }
        }
        best
    }
}

/// Wraps a coordinate to the unit square.
fn wrapped(c: f32) -> f32 {
    if (0.0..1.0).contains(&c) {
        c
    } else {
        c.rem_euclid(1.0)
    }
}

pub(super) fn mix(a: f32, b: f32, t: f32) -> f32 {
    a + (b - a) * t
}

pub(super) fn mix_colour(a: [f32; 3], b: [f32; 3], t: f32) -> [f32; 3] {
    std::array::from_fn(|c| mix(a[c], b[c], t))
}

/// Smoothstep from 0 at `low` to 1 at `high`.
pub(super) fn smoothstep(low: f32, high: f32, x: f32) -> f32 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_is_periodic_and_in_range() {
        let (fractal, cells) = (FractalNoise::new(5, [4, 6], 4), WorleyNoise::new(5, 7));
        for i in 0..200 {
            let (x, y) = (i as f32 * 0.0137, i as f32 * 0.0311);
            let a = fractal.at(x, y);
            let b = fractal.at(x + 1.0, y - 2.0);
            assert!((a - b).abs() < 2e-3, "{a} {b}");
            assert!((0.0..=1.0).contains(&a));
            let (near, far, id) = cells.at(x, y);
            assert!(near <= far && near < 1.5 && (0.0..1.0).contains(&id));
        }
    }

    #[test]
    fn noise_is_continuous_across_border() {
        let noise = ValueNoise::new(9, [8, 8]);
        for i in 0..50 {
            let y = i as f32 / 50.0;
            let (left, right) = (noise.at(0.0, y), noise.at(0.999_999, y));
            assert!((left - right).abs() < 1e-3, "{left} {right}");
        }
    }

    #[test]
    fn coordinates_beyond_the_border_wrap() {
        for cells in [1, 2, 9] {
            let noise = (ValueNoise::new(1, [cells; 2]), WorleyNoise::new(1, cells));
            for c in [-1e-9, 1.0, -3.0, 1e9] {
                assert!((0.0..=1.0).contains(&noise.0.at(c, c)));
                assert!(noise.1.at(c, c).0.is_finite());
            }
        }
    }
}
