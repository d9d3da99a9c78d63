//! Relief of the skin from the change of a tactile image.
//!
//! The change since the untouched gel is averaged over cells of 4 pixels, without the gel markers
//! of both images. Its smooth part, the drift of lamps and camera, is the mean of the cells that
//! hardly change. What remains is the slope of the skin ([`SlopeResponse`]), and the relief is the
//! surface whose slopes are nearest to it in the least-squares sense (Frankot and Chellappa 1988,
//! with free borders by a cosine transform). Its constant is unknown: the relief counts from its
//! lowest tenth.

use image::RgbImage;

use super::slope_response::SlopeResponse;
use crate::profile::SensorProfile;
use gripcast_base::error::{Error, Result};
use gripcast_base::statistics::quantile;
use gripcast_shear::{MarkerField, covered};

/// Side of a cell, px.
const CELL_PX: usize = 4;
/// Change of a cell below which it counts as drift, grey levels.
const DRIFT_LEVELS: f32 = 4.0;
/// Change of a cell below which the skin counts as flat, grey levels.
const FLAT_LEVELS: f32 = 2.0;
/// Pixels around a gel marker that its colour reaches.
const HALO_PX: f32 = 2.0;
/// Minimum pixels of a cell that no gel marker covers.
const MIN_FREE: u32 = 4;
/// Sweeps that fill the cells below gel markers.
const FILL_SWEEPS: usize = 12;
/// Fraction of the cells that lie below the zero of the relief.
const ZERO_FRACTION: f64 = 0.1;

/// Relief of the skin in one image.
#[derive(Clone, Debug)]
pub(super) struct Relief {
    /// Depth by cell, row-major, m; noise makes some of it negative.
    pub(super) depth_m: Vec<f32>,
    /// Slope of each cell, the length of the gradient.
    pub(super) slope: Vec<f32>,
    /// Area of a cell, m².
    pub(super) cell_m2: f64,
}

/// Measures the relief of one sensor.
#[derive(Clone, Debug)]
pub(super) struct ReliefSensor {
    response: SlopeResponse,
    size: [usize; 2],
    pixel_m: f64,
    marker_px: f32,
    cosines: [Vec<f32>; 2],
}

impl ReliefSensor {
    /// # Errors
    /// `Config` if the profile is invalid or its image is smaller than a few cells.
    pub(super) fn new(profile: &SensorProfile) -> Result<Self> {
        let geometry = profile.geometry;
        let size = [geometry.width, geometry.height];
        let cells = size.map(|n| n / CELL_PX);
        if cells[0] < 8 || cells[1] < 8 {
            let what = format!("expected an image of at least 32×32 pixels, found {size:?}");
            return Err(Error::config(what));
        }
        let diameter_m = profile.markers.as_ref().map_or(0.0, |m| m.diameter_m);
        Ok(Self {
            response: SlopeResponse::new(profile)?,
            size,
            pixel_m: geometry.pixel_m,
            marker_px: (diameter_m / geometry.pixel_m) as f32,
            cosines: cells.map(cosine_table),
        })
    }

    /// Relief of `now` against the untouched gel.
    ///
    /// # Errors
    /// `Input` for an image of another size than the sensor's.
    pub(super) fn relief(
        &self,
        initial: &RgbImage,
        now: &RgbImage,
        markers: Option<&MarkerField>,
    ) -> Result<Relief> {
        for image in [initial, now] {
            let found = [image.width() as usize, image.height() as usize];
            if found != self.size {
                let [width, height] = self.size;
                let what = format!(
                    "expected a tactile image of {width}×{height} pixels, found {}×{}",
                    found[0], found[1]
                );
                return Err(Error::input(what)
                    .remedy("crop the image as the sensor profile's `crop_profile` says"));
            }
        }
        let changes = without_drift(&self.cell_changes(initial, now, markers));
        let [columns, rows] = self.cells();
        let gradient: Vec<[f32; 2]> = (0..columns * rows)
            .map(|i| {
                let change = changes[i];
                if length(change) < FLAT_LEVELS {
                    return [0.0; 2];
                }
                let at = [i % columns, i / columns];
                let at = [
                    (at[0] as f32 + 0.5) / columns as f32,
                    (at[1] as f32 + 0.5) / rows as f32,
                ];
                self.response.slope(change, at)
            })
            .collect();
        let side_m = CELL_PX as f64 * self.pixel_m;
        Ok(Relief {
            depth_m: self.integrate(&gradient, side_m as f32),
            slope: gradient.iter().map(|[x, y]| x.hypot(*y)).collect(),
            cell_m2: side_m * side_m,
        })
    }

    fn cells(&self) -> [usize; 2] {
        self.size.map(|n| n / CELL_PX)
    }

    /// Mean change of each cell; cells below gel markers take that of their neighbours.
    fn cell_changes(
        &self,
        initial: &RgbImage,
        now: &RgbImage,
        markers: Option<&MarkerField>,
    ) -> Vec<[f32; 3]> {
        let [width, _] = self.size;
        let [columns, rows] = self.cells();
        let is_covered = self.covered(markers);
        let mut sums = vec![([0_i32; 3], 0_u32); columns * rows];
        let before = initial.as_raw().chunks_exact(3);
        let after = now.as_raw().chunks_exact(3);
        for (at, (a, b)) in before.zip(after).enumerate() {
            let (column, row) = (at % width / CELL_PX, at / width / CELL_PX);
            if column >= columns || row >= rows || is_covered[at] {
                continue;
            }
            let (sum, count) = &mut sums[row * columns + column];
            for (sum, (a, b)) in sum.iter_mut().zip(a.iter().zip(b)) {
                *sum += i32::from(*b) - i32::from(*a);
            }
            *count += 1;
        }
        let mean = |(sum, count): &([i32; 3], u32)| {
            (*count >= MIN_FREE).then(|| sum.map(|s| s as f32 / *count as f32))
        };
        let known: Vec<Option<[f32; 3]>> = sums.iter().map(mean).collect();
        filled(&known, columns)
    }

    /// Pixels below the gel markers of both images.
    fn covered(&self, markers: Option<&MarkerField>) -> Vec<bool> {
        let markers = markers
            .iter()
            .flat_map(|field| field.markers.iter().flatten());
        let centres = markers.flat_map(|m| [m.rest_px, m.position_px]);
        covered(self.size, centres, 0.5 * self.marker_px + HALO_PX)
    }

    /// Surface whose slopes are nearest to `gradient`, from its zero, m.
    fn integrate(&self, gradient: &[[f32; 2]], side_m: f32) -> Vec<f32> {
        let [columns, rows] = self.cells();
        let at = |column: usize, row: usize| row * columns + column;
        let mut sources = vec![0.0_f32; columns * rows];
        for row in 0..rows {
            for column in 0..columns {
                let here = at(column, row);
                if column + 1 < columns {
                    let next = at(column + 1, row);
                    let rise = 0.5 * side_m * (gradient[here][0] + gradient[next][0]);
                    sources[here] -= rise;
                    sources[next] += rise;
                }
                if row + 1 < rows {
                    let next = at(column, row + 1);
                    let rise = 0.5 * side_m * (gradient[here][1] + gradient[next][1]);
                    sources[here] -= rise;
                    sources[next] += rise;
                }
            }
        }
        let mut waves = self.transform(&sources, false);
        let stiffness =
            |k: usize, n: usize| 2.0 - 2.0 * (std::f32::consts::PI * k as f32 / n as f32).cos();
        for row in 0..rows {
            for column in 0..columns {
                let sum = stiffness(column, columns) + stiffness(row, rows);
                let wave = &mut waves[at(column, row)];
                *wave = if sum > 0.0 { *wave / sum } else { 0.0 };
            }
        }
        let mut depth = self.transform(&waves, true);
        let mut sorted: Vec<f64> = depth.iter().map(|d| f64::from(*d)).collect();
        sorted.sort_by(f64::total_cmp);
        let zero = quantile(&sorted, ZERO_FRACTION).unwrap_or_default() as f32;
        depth.iter_mut().for_each(|d| *d -= zero);
        depth
    }

    /// Orthonormal cosine transform along both axes, or its inverse.
    fn transform(&self, plane: &[f32], inverse: bool) -> Vec<f32> {
        let [columns, rows] = self.cells();
        let [across, down] = &self.cosines;
        let mut half = vec![0.0_f32; columns * rows];
        for (line, out) in plane
            .chunks_exact(columns)
            .zip(half.chunks_exact_mut(columns))
        {
            for (k, out) in out.iter_mut().enumerate() {
                let weights = |i: usize| match inverse {
                    false => across[k * columns + i],
                    true => across[i * columns + k],
                };
                *out = line.iter().enumerate().map(|(i, v)| weights(i) * v).sum();
            }
        }
        let mut whole = vec![0.0_f32; columns * rows];
        for (k, out) in whole.chunks_exact_mut(columns).enumerate() {
            for (i, line) in half.chunks_exact(columns).enumerate() {
                let weight = match inverse {
                    false => down[k * rows + i],
                    true => down[i * rows + k],
                };
                for (out, v) in out.iter_mut().zip(line) {
                    *out += weight * v;
                }
            }
        }
        whole
    }
}

/// Rows of the orthonormal cosine transform of `n` values.
fn cosine_table(n: usize) -> Vec<f32> {
    let mut table = Vec::with_capacity(n * n);
    for k in 0..n {
        let norm = if k == 0 { 1.0 } else { 2.0 } / n as f64;
        for i in 0..n {
            let angle = std::f64::consts::PI * k as f64 * (i as f64 + 0.5) / n as f64;
            table.push((norm.sqrt() * angle.cos()) as f32);
        }
    }
    table
}

fn length(change: [f32; 3]) -> f32 {
    change.iter().map(|c| c * c).sum::<f32>().sqrt()
}

/// Changes less their drift: the mean of the cells that hardly change.
fn without_drift(changes: &[[f32; 3]]) -> Vec<[f32; 3]> {
    let mut drift = [0.0_f32; 3];
    for _ in 0..3 {
        let less = |change: &[f32; 3]| [0, 1, 2].map(|c| change[c] - drift[c]);
        let quiet = changes
            .iter()
            .filter(|change| length(less(change)) < DRIFT_LEVELS);
        let (sum, count) = quiet.fold(([0.0_f32; 3], 0_u32), |(sum, count), change| {
            ([0, 1, 2].map(|c| sum[c] + change[c]), count + 1)
        });
        if count == 0 {
            break;
        }
        drift = sum.map(|s| s / count as f32);
    }
    let less = |change: &[f32; 3]| [0, 1, 2].map(|c| change[c] - drift[c]);
    changes.iter().map(less).collect()
}

/// Fills unknown cells with the mean of their neighbours, from their rim inwards.
fn filled(known: &[Option<[f32; 3]>], columns: usize) -> Vec<[f32; 3]> {
    let rows = known.len() / columns;
    let mut cells = known.to_vec();
    for _ in 0..FILL_SWEEPS {
        let before = cells.clone();
        for (i, cell) in cells.iter_mut().enumerate() {
            if known[i].is_some() {
                continue;
            }
            let (x, y) = (i % columns, i / columns);
            let around = [
                (x > 0).then(|| i - 1),
                (x + 1 < columns).then(|| i + 1),
                (y > 0).then(|| i - columns),
                (y + 1 < rows).then(|| i + columns),
            ];
            let near: Vec<[f32; 3]> = around.iter().flatten().filter_map(|n| before[*n]).collect();
            if !near.is_empty() {
                let count = near.len() as f32;
                *cell = Some([0, 1, 2].map(|c| near.iter().map(|v| v[c]).sum::<f32>() / count));
            }
        }
    }
    cells.iter().map(|cell| cell.unwrap_or_default()).collect()
}
