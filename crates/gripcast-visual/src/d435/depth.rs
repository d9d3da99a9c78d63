//! Model of the stereo depth camera: exact depth to measured depth.

use rayon::prelude::*;

use super::{BASELINE_M, LEFT_IMAGER_M};
use crate::camera::Camera;
use crate::material::ensure;
use gripcast_base::error::{Error, Result};
use gripcast_base::random::{SeedStream, gaussians};
use gripcast_imaging::DepthImage;

/// Focal length of the stereo images of 640 × 360 with 87°, px.
const STEREO_FOCAL_PX: f64 = 337.0;
/// Fraction of the noise variance that is correlated between neighbours within about 4 pixels.
const CORRELATED_FRACTION: f64 = 0.7;
/// Disparity steps per pixel.
const DISPARITY_STEPS: f64 = 32.0;
/// Maximum disparity, px: closer than `f · b / max_disparity` there is no depth.
const MAX_DISPARITY_PX: f64 = 126.0;
/// Minimum depth of stereo images of 640 × 360, m. It grows with the width of the images: about
/// 0.1 m at 480 × 270, 0.2 m at 848 × 480 (D400 series data sheet).
const MIN_DEPTH_M: f64 = STEREO_FOCAL_PX * BASELINE_M / MAX_DISPARITY_PX;
/// Side of the cells in which stereo matching succeeds or fails, px.
const CELL: usize = 12;
/// Maximum depth, m.
const MAX_DEPTH_M: f64 = 10.0;
/// Minimum angle between a surface and the viewing ray, rad; below it stereo matching fails.
const GRAZING_RAD: f64 = 7.0 * std::f64::consts::PI / 180.0;

/// Settings of the stereo depth module.
///
/// The error of a triangulated depth is `z² · s / (f · b)` for an error `s` of the disparity
/// (Intel, *Best-known-methods for tuning D400 series depth cameras*).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthSettings {
    /// Standard deviation of the disparity noise, px.
    pub disparity_std_px: f64,
    /// Depth unit, m.
    pub unit_m: f64,
    /// Minimum depth of the mode, m.
    pub min_depth_m: f64,
    /// Fraction of the image without a match, as on surfaces without texture.
    pub hole_fraction: f64,
}

impl Default for DepthSettings {
    /// Noise of a textured scene at 640 × 360, 1 mm units.
    fn default() -> Self {
        Self {
            disparity_std_px: 0.08,
            unit_m: 1e-3,
            min_depth_m: MIN_DEPTH_M,
            hole_fraction: 0.0,
        }
    }
}

impl DepthSettings {
    /// Draws settings of a mode that sees the object between the fingers; `spread` 0 gives the
    /// default, 1 the full range of noise and holes.
    pub fn sample(seed: u64, spread: f64) -> Self {
        let mut draw = SeedStream::named(seed, "depth");
        let default = Self::default();
        let modes_m = draw.between(0.75, 1.15);
        Self {
            disparity_std_px: default.disparity_std_px * (spread * draw.between(-0.7, 1.1)).exp(),
            min_depth_m: default.min_depth_m * (1.0 + spread * (modes_m - 1.0)),
            hole_fraction: (spread * draw.between(-0.1, 0.2)).clamp(0.0, 0.5),
            ..default
        }
    }

    /// Standard deviation of a measured depth, m.
    pub fn depth_std_m(&self, depth_m: f64) -> f64 {
        depth_m * depth_m * self.disparity_std_px / (STEREO_FOCAL_PX * BASELINE_M)
    }

    fn validate(&self) -> Result<()> {
        let (std_px, unit_m) = (self.disparity_std_px, self.unit_m);
        ensure(std_px >= 0.0, || {
            format!("the disparity noise must not be negative, found {std_px} px")
        })?;
        ensure(unit_m.is_finite() && unit_m > 0.0, || {
            format!("the depth unit must be positive, found {unit_m} m")
        })?;
        let (min_m, holes) = (self.min_depth_m, self.hole_fraction);
        ensure(min_m.is_finite() && min_m >= 0.0, || {
            format!("the minimum depth must not be negative, found {min_m} m")
        })?;
        ensure((0.0..=1.0).contains(&holes), || {
            format!("the fraction of holes must lie in 0 to 1, found {holes}")
        })
    }
}

/// Simulates the depth camera: converts exact depths along the optical axis (m, row-major; 0 or not
/// finite without a surface) to depth codes in units of `unit_m`, aligned to the colour image.
///
/// Code 0 means no depth: too near or far, visible to only one imager (the shadow beside near
/// edges), or a surface at a grazing angle. Glass and mirrors get the depth of their surface; a
/// real D435 often sees through them.
///
/// # Errors
/// `Input` if the number of depths is not that of the camera's pixels, or settings are invalid.
pub fn measure_depth(
    depth_m: &[f32],
    camera: &Camera,
    settings: &DepthSettings,
    seed: u64,
) -> Result<DepthImage> {
    settings.validate()?;
    let (width, height) = (camera.width, camera.height);
    let found = depth_m.len();
    ensure(found > 0 && found == width * height, || {
        format!("a depth image of {width}×{height} must have as many depths, found {found}")
    })?;
    let noise = DisparityNoise::new(width, height, settings.hole_fraction, seed);
    let mut codes = vec![0_u16; depth_m.len()];
    codes
        .par_chunks_mut(width)
        .enumerate()
        .for_each(|(row, codes)| {
            let line = &depth_m[row * width..(row + 1) * width];
            let visible = visible_to_both(line, camera);
            for (column, code) in codes.iter_mut().enumerate() {
                let pixel = (column, row);
                let is_matched = visible[column] && !noise.is_hole(pixel);
                if is_matched && !is_grazing(depth_m, pixel, camera) {
                    *code = measured(line[column], pixel, settings, &noise);
                }
            }
        });
    DepthImage::from_vec(width as u32, height as u32, codes)
        .ok_or_else(|| Error::internal("the depth image has the wrong size"))
}

/// Measures one depth with noise and quantisation.
fn measured(
    depth: f32,
    pixel: (usize, usize),
    settings: &DepthSettings,
    noise: &DisparityNoise,
) -> u16 {
    let depth = f64::from(depth);
    let scale = STEREO_FOCAL_PX * BASELINE_M;
    if !(settings.min_depth_m..=MAX_DEPTH_M).contains(&depth) {
        return 0;
    }
    let noise = settings.disparity_std_px * noise.at(pixel);
    let steps = ((scale / depth + noise) * DISPARITY_STEPS).round();
    let disparity = steps / DISPARITY_STEPS;
    if disparity <= 0.0 {
        return 0;
    }
    // Codes beyond 16 bits are invalid.
    let code = (scale / disparity / settings.unit_m).round();
    if code <= f64::from(u16::MAX) {
        code as u16
    } else {
        0
    }
}

/// Side of the cells of the lattice that neighbours share, px.
const SPACING: usize = 4;

/// Noise of the disparity in an image: values of the cells that pixels share, computed once.
struct DisparityNoise {
    seed: u64,
    /// Values of the lattice, row by row, and their number in a row.
    lattice: Vec<f64>,
    lattice_width: usize,
    /// Cells in which matching fails, row by row, and their number in a row.
    holes: Vec<bool>,
    hole_width: usize,
}

impl DisparityNoise {
    fn new(width: usize, height: usize, hole_fraction: f64, seed: u64) -> Self {
        let grid = |cell: usize, more: usize| {
            let [columns, rows] = [width, height].map(|side| side.div_ceil(cell) + more);
            let items =
                (0..rows).flat_map(move |row| (0..columns).map(move |column| (row, column)));
            let items = items.map(|(row, column)| (row as u64) << 32 | column as u64);
            (columns, items)
        };
        let (lattice_width, items) = grid(SPACING, 1);
        let lattice = items.map(|item| f64::from(gaussians(seed ^ 0x5a5a_1234, item)[0]));
        let lattice = lattice.collect();
        let (hole_width, items) = grid(CELL, 0);
        let is_hole = |cell| {
            let normal = f64::from(gaussians(seed ^ 0x0f0f_9876, cell)[0]);
            // The logistic function nearly is the normal distribution function.
            1.0 / (1.0 + (-1.702 * normal).exp()) < hole_fraction
        };
        Self {
            seed,
            lattice,
            lattice_width,
            holes: match hole_fraction > 0.0 {
                true => items.map(is_hole).collect(),
                false => Vec::new(),
            },
            hole_width,
        }
    }

    /// Whether matching fails at a pixel.
    fn is_hole(&self, (column, row): (usize, usize)) -> bool {
        let cell = row / CELL * self.hole_width + column / CELL;
        self.holes.get(cell).is_some_and(|is_hole| *is_hole)
    }

    /// Noise of unit variance: the sum of the lattice and of independent noise.
    fn at(&self, (column, row): (usize, usize)) -> f64 {
        let own = f64::from(gaussians(self.seed, (row as u64) << 32 | column as u64)[0]);
        let (cx, cy) = (column / SPACING, row / SPACING);
        let offset = |c: usize| (c % SPACING) as f64 / SPACING as f64 + 0.5 / SPACING as f64;
        let (fx, fy) = (offset(column), offset(row));
        let at = |i: usize, j: usize| self.lattice[(cy + j) * self.lattice_width + cx + i];
        let weights = [
            (1.0 - fx) * (1.0 - fy),
            fx * (1.0 - fy),
            (1.0 - fx) * fy,
            fx * fy,
        ];
        let lattice = [at(0, 0), at(1, 0), at(0, 1), at(1, 1)];
        let sum: f64 = weights.iter().zip(lattice).map(|(w, g)| w * g).sum();
        let norm = weights.iter().map(|w| w * w).sum::<f64>().sqrt();
        CORRELATED_FRACTION.sqrt() * sum / norm + (1.0 - CORRELATED_FRACTION).sqrt() * own
    }
}

/// Marks the pixels of a row visible to both imagers: a surface is occluded if a nearer one lies on
/// the same line of sight.
fn visible_to_both(line: &[f32], camera: &Camera) -> Vec<bool> {
    let mut visible: Vec<bool> = line.iter().map(|z| z.is_finite() && *z > 0.0).collect();
    for imager_m in [LEFT_IMAGER_M, LEFT_IMAGER_M + BASELINE_M] {
        let shift = camera.focal_px[0] * imager_m;
        let column_of = |column: usize, depth: f32| column as f64 - shift / f64::from(depth);
        // Seen from further right, near surfaces shift left over far ones: a pixel is occluded if
        // one to its right lands at or left of it.
        let mut leftmost = f64::INFINITY;
        for column in (0..line.len()).rev() {
            if !(line[column].is_finite() && line[column] > 0.0) {
                continue;
            }
            let there = column_of(column, line[column]);
            if there > leftmost {
                visible[column] = false;
            }
            leftmost = leftmost.min(there);
        }
    }
    visible
}

/// Whether the surface at a pixel is at a grazing angle or at a depth edge.
fn is_grazing(depth_m: &[f32], (column, row): (usize, usize), camera: &Camera) -> bool {
    let at = |c: usize, r: usize| f64::from(depth_m[r * camera.width + c]);
    let here = at(column, row);
    // Depth change per pixel along an axis, the smaller one of both sides: an edge affects only one
    // side.
    let slope = |low: Option<f64>, high: Option<f64>| {
        let steps = [low.map(|z| here - z), high.map(|z| z - here)];
        let found = steps.into_iter().flatten().filter(|s| s.is_finite());
        found.min_by(|a, b| a.abs().total_cmp(&b.abs()))
    };
    let left = column.checked_sub(1).map(|c| at(c, row));
    let right = (column + 1 < camera.width).then(|| at(column + 1, row));
    let up = row.checked_sub(1).map(|r| at(column, r));
    let down = (row + 1 < camera.height).then(|| at(column, row + 1));
    let (Some(dx), Some(dy)) = (slope(left, right), slope(up, down)) else {
        return true;
    };
    // Gradient of the log depth over the image plane: the surface z(u, v) has the normal (-gx, -gy,
    // 1 + u gx + v gy) with g = f · dz / z.
    let [fx, fy] = camera.focal_px;
    let (gx, gy) = (fx * dx / here, fy * dy / here);
    let u = (column as f64 - camera.principal_px[0]) / fx;
    let v = (row as f64 - camera.principal_px[1]) / fy;
    let along = 1.0 + u * gx + v * gy;
    let normal = (gx * gx + gy * gy + along * along).sqrt();
    let ray = (1.0 + u * u + v * v).sqrt();
    // The dot product of the ray (u, v, 1) and the normal is 1.
    1.0 / (normal * ray) < GRAZING_RAD.sin()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::d435::colour_camera;
    use gripcast_geometry::Pose;

    fn camera() -> Camera {
        colour_camera(320, 240, Pose::IDENTITY)
    }

    fn wall(depth: f32) -> DepthImage {
        let settings = DepthSettings {
            unit_m: 1e-4,
            ..DepthSettings::default()
        };
        measure_depth(&[depth; 320 * 240], &camera(), &settings, 4).unwrap()
    }

    #[test]
    fn noise_grows_with_depth_squared() {
        for depth in [0.4_f32, 0.8, 1.6] {
            let codes = wall(depth);
            let values: Vec<f64> = codes.iter().map(|c| f64::from(*c) * 1e-4).collect();
            let n = values.len() as f64;
            let mean = values.iter().sum::<f64>() / n;
            let deviation = (values.iter().map(|z| (z - mean).powi(2)).sum::<f64>() / n).sqrt();
            let expected = DepthSettings::default().depth_std_m(f64::from(depth));
            assert!(
                (mean - f64::from(depth)).abs() < 0.1 * expected + 5e-5,
                "{mean}"
            );
            assert!(
                (deviation / expected - 1.0).abs() < 0.12,
                "{deviation} {expected}"
            );
        }
    }

    #[test]
    fn codes_are_millimetres_and_0_out_of_range() {
        let settings = DepthSettings::default();
        let code = |depth: f32| {
            let codes = measure_depth(&[depth; 320 * 240], &camera(), &settings, 0).unwrap();
            codes.get_pixel(160, 120).0[0]
        };
        assert_eq!(code(0.133), 0);
        assert_ne!(code(0.136), 0);
        assert_eq!(code(12.0), 0);
        assert_eq!(code(f32::INFINITY), 0);
        assert_eq!(code(0.0), 0);
        assert!((i32::from(code(0.3)) - 300).abs() <= 3, "{}", code(0.3));
    }

    #[test]
    fn mode_and_holes_are_those_of_the_settings() {
        let near = [0.12_f32; 320 * 240];
        let known = |settings: DepthSettings| {
            let codes = measure_depth(&near, &camera(), &settings, 5).unwrap();
            codes.iter().filter(|code| **code > 0).count() as f64 / codes.len() as f64
        };
        let default = DepthSettings::default();
        assert_eq!(known(default), 0.0);
        let small = DepthSettings {
            min_depth_m: 0.1,
            ..default
        };
        assert_eq!(known(small), 1.0);
        let holes = DepthSettings {
            hole_fraction: 0.3,
            ..small
        };
        assert!((known(holes) - 0.7).abs() < 0.06, "{}", known(holes));
        assert_eq!(DepthSettings::sample(3, 0.0), default);
        for seed in 0..20 {
            let drawn = DepthSettings::sample(seed, 1.0);
            assert!((0.09..0.16).contains(&drawn.min_depth_m), "{drawn:?}");
            assert!(drawn.validate().is_ok(), "{drawn:?}");
        }
    }

    #[test]
    fn near_edge_leaves_stereo_shadow_on_one_side() {
        let camera = camera();
        let depth: Vec<f32> = (0..320 * 240)
            .map(|i| {
                if (100..200).contains(&(i % 320)) {
                    0.3
                } else {
                    0.6
                }
            })
            .collect();
        let codes = measure_depth(&depth, &camera, &DepthSettings::default(), 1).unwrap();
        let holes = |from: u32, to: u32| (from..to).filter(|&x| codes.get_pixel(x, 99)[0] == 0);
        // Seen from the right, the near plate occludes pixels to its left.
        let shift = camera.focal_px[0] * (LEFT_IMAGER_M + BASELINE_M) * (1.0 / 0.3 - 1.0 / 0.6);
        let left = holes(0, 100).count() as f64;
        assert!((left - shift).abs() <= 2.0, "{left} {shift}");
        assert!(holes(202, 320).count() == 0);
        assert!(holes(102, 198).count() == 0);
    }

    #[test]
    fn grazing_surface_has_no_depth() {
        let camera = camera();
        let plane = |angle: f64| {
            // A floor whose angle to the optical axis is `angle`, 0.5 m in front.
            let mut depth = Vec::new();
            for row in 0..240 {
                let v = (row as f64 - camera.principal_px[1]) / camera.focal_px[1];
                let z = 0.5 / (1.0 + v / angle.tan());
                depth.extend([z as f32; 320]);
            }
            let codes = measure_depth(&depth, &camera, &DepthSettings::default(), 1).unwrap();
            codes.get_pixel(160, 120)[0]
        };
        assert!(plane(0.6) > 0);
        assert_eq!(plane(0.05), 0);
    }

    #[test]
    fn wrong_size_or_settings_are_refused() {
        let settings = DepthSettings::default();
        let text = measure_depth(&[1.0; 10], &camera(), &settings, 0).unwrap_err();
        assert!(text.to_string().contains("320×240"), "{text}");
        let bad = DepthSettings {
            unit_m: 0.0,
            ..settings
        };
        let text = measure_depth(&[1.0; 320 * 240], &camera(), &bad, 0).unwrap_err();
        assert!(text.to_string().contains("depth unit"), "{text}");
    }
}
