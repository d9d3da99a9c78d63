//! Slope of the skin from its change of colour.
//!
//! The shading of a sensor profile maps a slope to a change of colour. Its inverse is a search of
//! a table: first among widely spaced slopes, then among the neighbours of the best one.

use crate::gaussian::Region;
use crate::normals::Normals;
use crate::press_depth::SensorGeometry;
use crate::profile::{SensorProfile, ShadingModel};
use gripcast_base::error::Result;

/// Slopes along each axis of the table.
const SIDE: usize = 33;
/// Spacing of the slopes that are searched first.
const COARSE: usize = 4;
/// Maximum sine of the slope where the shading names none.
const STEEPEST: f64 = 0.4;
/// Positions along x and y at which the shading is tabulated.
const POSITIONS: [usize; 2] = [5, 4];

/// Changes of colour by slope, at some positions of the image.
#[derive(Clone, Debug)]
pub(super) struct SlopeResponse {
    /// Tables by position, row-major; each has the slopes along x fastest.
    tables: Vec<Vec<[f32; 3]>>,
    step: f32,
}

impl SlopeResponse {
    /// Tabulates the shading of a profile.
    ///
    /// # Errors
    /// `Config` if the profile is invalid.
    pub(super) fn new(profile: &SensorProfile) -> Result<Self> {
        profile.validate()?;
        let steepest = match &profile.shading {
            ShadingModel::Polynomial(shading) => shading.steepest.min(STEEPEST),
            ShadingModel::Leds(_) => STEEPEST,
        };
        let step = (2.0 * steepest / (SIDE - 1) as f64) as f32;
        let [columns, rows] = POSITIONS;
        let positions = (0..rows).flat_map(|row| (0..columns).map(move |column| [column, row]));
        let table = |at: [usize; 2]| table(profile, at, step);
        Ok(Self {
            tables: positions.map(table).collect(),
            step,
        })
    }

    /// Slope (∂u/∂x, ∂u/∂y) of the depth u whose change of colour is nearest to `change` (grey
    /// levels), at a position of the image in fractions of its width and height.
    pub(super) fn slope(&self, change: [f32; 3], at: [f32; 2]) -> [f32; 2] {
        let [column, row] = [0, 1].map(|axis| cell_of(at[axis], POSITIONS[axis]));
        let table = &self.tables[row * POSITIONS[0] + column];
        let mut best = (f32::INFINITY, [SIDE / 2; 2]);
        let consider = |best: &mut (f32, [usize; 2]), i: usize, j: usize| {
            let expected = table[j * SIDE + i];
            let square = (0..3)
                .map(|c| (expected[c] - change[c]).powi(2))
                .sum::<f32>();
            if square < best.0 {
                *best = (square, [i, j]);
            }
        };
        for j in (0..SIDE).step_by(COARSE) {
            for i in (0..SIDE).step_by(COARSE) {
                consider(&mut best, i, j);
            }
        }
        let near = |i: usize| i.saturating_sub(COARSE)..(i + COARSE + 1).min(SIDE);
        let [column, row] = best.1;
        for j in near(row) {
            for i in near(column) {
                consider(&mut best, i, j);
            }
        }
        let [sx, sy] = best.1.map(|i| (i as f32 - (SIDE / 2) as f32) * self.step);
        let cosine = (1.0 - sx * sx - sy * sy).max(0.01).sqrt();
        [sx / cosine, sy / cosine]
    }
}

/// Index of the table cell of a position, 0 to 1.
fn cell_of(at: f32, cells: usize) -> usize {
    ((at.max(0.0) * cells as f32) as usize).min(cells - 1)
}

/// Changes of colour of all slopes at one position; NaN for slopes beyond the steepest.
fn table(profile: &SensorProfile, at: [usize; 2], step: f32) -> Vec<[f32; 3]> {
    let SensorGeometry { width, height, .. } = profile.geometry;
    let middle_of = |i: usize, count: usize, size: usize| (2 * i + 1) * size / (2 * count);
    let [x, y] = [
        middle_of(at[0], POSITIONS[0], width),
        middle_of(at[1], POSITIONS[1], height),
    ];
    let pixel = y * width + x;
    let mut normals = Normals {
        width,
        x: vec![0.0; width * height],
        y: vec![0.0; width * height],
        z_less_1: vec![0.0; width * height],
        region: Some(Region {
            x0: x,
            x1: x + 1,
            y0: y,
            y1: y + 1,
        }),
    };
    let mut planes: [Vec<f32>; 3] = std::array::from_fn(|_| vec![0.0; width * height]);
    let middle = (SIDE / 2) as f32;
    let change = |k: usize| {
        let [sx, sy] = [k % SIDE, k / SIDE].map(|i| (i as f32 - middle) * step);
        if sx.hypot(sy) > (middle + 0.5) * step {
            return [f32::NAN; 3];
        }
        normals.x[pixel] = -sx;
        normals.y[pixel] = -sy;
        normals.z_less_1[pixel] = (1.0 - sx * sx - sy * sy).max(0.0).sqrt() - 1.0;
        for plane in &mut planes {
            plane[pixel] = 0.0;
        }
        match &profile.shading {
            ShadingModel::Polynomial(s) => s.add(&profile.geometry, &normals, &mut planes),
            ShadingModel::Leds(s) => s.add(&profile.geometry, &normals, &mut planes),
        }
        planes.each_ref().map(|plane| plane[pixel])
    };
    (0..SIDE * SIDE).map(change).collect()
}
