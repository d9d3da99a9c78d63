//! Noise estimate and firefly detection.

use std::ops::Range;

use super::{Light, add};
use crate::renderer::Rendering;

/// Radius over which the noise is averaged, px.
const NOISE_RADIUS: usize = 3;
/// Variance of a clipped firefly relative to the mean of its neighbourhood.
const FIREFLY_VARIANCE: f32 = 16.0;
/// Rounds of firefly detection.
const FIREFLY_ROUNDS: usize = 8;
/// A pixel is not a firefly if at least this number of equally bright paths would explain its
/// variance; with half as many it may be one entirely.
const SOLID_PATHS: f32 = 8.0;

/// Variance of one half's light among its paths, assuming independent paths.
pub(super) fn variance_of_paths(rendering: &Rendering, albedo: &[[f32; 3]]) -> Vec<f32> {
    let values = rendering.variance.pixels.iter().zip(albedo);
    values
        .map(|(v, a)| (0..3).map(|k| 2.0 * v[k] / (a[k] * a[k])).sum::<f32>() / 3.0)
        .collect()
}

/// Returns the weight factor of each pixel: below 1 for fireflies.
///
/// With the variance v of a pixel and the mean m of v over the other pixels of its window, a
/// firefly gets the factor c · m / v. Clipped in this way, the brightest adds √c standard
/// deviations of its neighbours to the sum over the window.
pub(super) fn trust(
    halves: &[Light; 2],
    of_paths: &[f32],
    size: [usize; 2],
    radius: usize,
) -> Vec<f32> {
    let mut trust = vec![1.0; of_paths.len()];
    let suspicion: Vec<f32> = of_paths
        .iter()
        .zip(halves[0].iter().zip(&halves[1]))
        .map(|(v, (a, b))| {
            let square = (0..3).map(|k| (0.5 * (a[k] + b[k])).powi(2)).sum::<f32>() / 3.0;
            // The image has half the variance of its halves.
            let paths = square / (0.5 * v).max(f32::MIN_POSITIVE);
            (2.0 - 2.0 * paths / SOLID_PATHS).clamp(0.0, 1.0)
        })
        .collect();
    // Later rounds find fireflies that brighter ones hid.
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

/// Returns the variance of one half's light per pixel: the variance among the paths, scaled by the
/// actual difference of the halves, because stratified paths differ less than independent ones.
/// Fireflies count with their weight factor.
pub(super) fn noise(
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
            // Half own value, half neighbourhood: single paths are rarely representative.
            true => 0.5 * (own + paths) * (halves / paths).min(1.0),
            false => *halves,
        })
        .collect()
}

/// Indices up to `radius` away along a side.
fn near(side: usize, at: usize, radius: usize) -> Range<usize> {
    at.saturating_sub(radius)..(at + radius + 1).min(side)
}

/// Mean over windows of `2 radius + 1` pixels, truncated at the borders.
fn box_mean(values: &[f32], width: usize, height: usize, radius: usize) -> Vec<f32> {
    let mut rows = vec![0.0; values.len()];
    let mut padded = vec![0.0; width + 2 * radius];
    let fractions: Vec<f32> = (0..width)
        .map(|column| 1.0 / near(width, column, radius).len() as f32)
        .collect();
    let lines = rows.chunks_mut(width.max(1));
    for (sums, row) in lines.zip(values.chunks(width.max(1))) {
        padded[radius..][..width].copy_from_slice(row);
        for k in 0..=2 * radius {
            add(sums, &padded[k..][..width]);
        }
        for (sum, fraction) in sums.iter_mut().zip(&fractions) {
            *sum *= fraction;
        }
    }
    let mut out = vec![0.0; values.len()];
    for (row, sums) in out.chunks_mut(width.max(1)).enumerate() {
        let range = near(height, row, radius);
        let fraction = 1.0 / range.len() as f32;
        for other in range {
            add(sums, &rows[other * width..][..width]);
        }
        for sum in sums {
            *sum *= fraction;
        }
    }
    out
}
