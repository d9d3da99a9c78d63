//! Noise that repeats: every function has period 1 along x and y.

use crate::render::seed::lattice;

/// Gradient-free value noise with quintic interpolation, 0 to 1, over a lattice of
/// `cells` × `cells` cells in the unit square.
pub(super) fn value(seed: u64, x: f32, y: f32, cells: [u32; 2]) -> f32 {
    let along = |c: f32, n: u32| {
        let scaled = c.rem_euclid(1.0) * n as f32;
        let low = (scaled as i64).min(i64::from(n) - 1);
        let t = scaled - low as f32;
        let smooth = t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
        (low, (low + 1) % i64::from(n), smooth)
    };
    let [nx, ny] = cells.map(|n| n.max(1));
    let (x0, x1, tx) = along(x, nx);
    let (y0, y1, ty) = along(y, ny);
    let level = i64::from(nx) * 8191 + i64::from(ny);
    let at = |x, y| lattice(seed, x, y, level);
    let low = mix(at(x0, y0), at(x1, y0), tx);
    let high = mix(at(x0, y1), at(x1, y1), tx);
    mix(low, high, ty)
}

/// Sum of `octaves` of value noise, each twice as fine and half as strong, 0 to 1.
pub(super) fn fractal(seed: u64, x: f32, y: f32, cells: [u32; 2], octaves: u32) -> f32 {
    let (mut sum, mut weights, mut weight) = (0.0, 0.0, 1.0);
    for octave in 0..octaves {
        let n = cells.map(|n| n << octave);
        sum += weight * value(seed.wrapping_add(u64::from(octave)), x, y, n);
        weights += weight;
        weight *= 0.5;
    }
    sum / weights
}

/// Distances to the nearest and the second nearest of one random point in each cell of a
/// `cells` × `cells` lattice, in cells, and a number of the nearest in 0..1 (Worley, 1996).
pub(super) fn cellular(seed: u64, x: f32, y: f32, cells: u32) -> (f32, f32, f32) {
    let n = i64::from(cells.max(1));
    let (sx, sy) = (x.rem_euclid(1.0) * n as f32, y.rem_euclid(1.0) * n as f32);
    let (cx, cy) = (sx as i64, sy as i64);
    let mut best = (f32::MAX, f32::MAX, 0.0);
    for j in cy - 1..=cy + 1 {
        for i in cx - 1..=cx + 1 {
            let (wi, wj) = (i.rem_euclid(n), j.rem_euclid(n));
            let px = i as f32 + lattice(seed, wi, wj, 1);
            let py = j as f32 + lattice(seed, wi, wj, 2);
            let distance = (px - sx).hypot(py - sy);
            if distance < best.0 {
                best = (distance, best.0, lattice(seed, wi, wj, 3));
            } else if distance < best.1 {
                best.1 = distance;
            }
        }
    }
    best
}

pub(super) fn mix(a: f32, b: f32, t: f32) -> f32 {
    a + (b - a) * t
}

pub(super) fn mix_color(a: [f32; 3], b: [f32; 3], t: f32) -> [f32; 3] {
    std::array::from_fn(|c| mix(a[c], b[c], t))
}

/// 0 below `low`, 1 above `high`, smooth between.
pub(super) fn smoothstep(low: f32, high: f32, x: f32) -> f32 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_repeats_and_stays_in_range() {
        for i in 0..200 {
            let (x, y) = (i as f32 * 0.0137, i as f32 * 0.0311);
            let a = fractal(5, x, y, [4, 6], 4);
            let b = fractal(5, x + 1.0, y - 2.0, [4, 6], 4);
            assert!((a - b).abs() < 2e-3, "{a} {b}");
            assert!((0.0..=1.0).contains(&a));
            let (near, far, id) = cellular(5, x, y, 7);
            assert!(near <= far && near < 1.5 && (0.0..1.0).contains(&id));
        }
    }

    #[test]
    fn noise_is_continuous_over_the_border() {
        for i in 0..50 {
            let y = i as f32 / 50.0;
            let (left, right) = (value(9, 0.0, y, [8, 8]), value(9, 0.999_999, y, [8, 8]));
            assert!((left - right).abs() < 1e-3, "{left} {right}");
        }
    }
}
