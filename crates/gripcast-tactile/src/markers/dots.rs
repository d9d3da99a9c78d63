//! Drawing of gel markers.
//!
//! A dot dims the light of each channel by darkness · Φ((R − r)/σ), with the radius R at half of
//! the darkness, the edge σ (10 to 90 % is 2.563 σ) and the distance r in the undeformed skin:
//! r = |F⁻¹(p − x)| for a pixel p, the dot's centre x and the gradient F of the skin's motion, so a
//! stretched dot is an ellipse. σ includes the extent of a pixel, which prevents aliasing.
//!
//! The layer of the dots lies below the reflecting coating as seen from the lamps: each lamp's
//! shadow is shifted away from it by about the depth of the layer. On real frames the channels'
//! dots are shifted away from the direction in which the shading of that channel brightens, red
//! down, green left, blue up, which gives them coloured rims.

use gripcast_shear::MarkerPattern;

use super::lattice::MarkerLattice;
use crate::SensorGeometry;
use crate::profile::ShadingModel;

/// Standard deviations of the edge from 10 to 90 %.
const EDGE_SIGMAS: f64 = 2.563;
/// Reach of the edge beyond the radius, standard deviations.
const REACH: f64 = 3.0;
/// Entries of the table of a dot's profile, over the squared distance.
const TABLE: usize = 512;
/// Distance of the points between which the stretch of the skin is measured, m.
const STRETCH_STEP_M: f64 = 1e-4;
/// Limits of the stretch of a dot.
const STRETCH: [f64; 2] = [0.5, 2.0];

/// Draws the gel markers of one sensor.
#[derive(Clone, Debug)]
pub(crate) struct MarkerInk {
    geometry: SensorGeometry,
    pub(crate) lattice: MarkerLattice,
    /// Darkness over the squared distance from the centre, from 0 to `reach_m`².
    table: Vec<f32>,
    reach_m: f64,
    /// Shift of the red, green and blue dots, m.
    shift_m: [[f64; 2]; 3],
    transmission: [Vec<f32>; 3],
}

impl MarkerInk {
    pub(crate) fn new(
        pattern: &MarkerPattern,
        geometry: &SensorGeometry,
        shading: &ShadingModel,
        seed: u64,
    ) -> Self {
        let pixel_sigma_m = geometry.pixel_m / 12f64.sqrt();
        let sigma_m = (pattern.edge_m / EDGE_SIGMAS).hypot(pixel_sigma_m);
        let radius_m = 0.5 * pattern.diameter_m;
        let reach_m = radius_m + REACH * sigma_m;
        let table = (0..TABLE).map(|i| {
            let distance_m = reach_m * (i as f64 / (TABLE - 1) as f64).sqrt();
            (pattern.darkness * normal_cdf((radius_m - distance_m) / sigma_m)) as f32
        });
        Self {
            geometry: *geometry,
            lattice: MarkerLattice::new(pattern, geometry, seed),
            table: table.collect(),
            reach_m,
            shift_m: shading
                .brightening_slope()
                .map(|slope| slope.map(|c| -pattern.depth_m * c)),
            transmission: std::array::from_fn(|_| Vec::new()),
        }
    }

    /// Dims the red, green and blue planes of an image, given as an untouched image and its change:
    /// the change then includes the dots.
    pub(crate) fn dim(
        &mut self,
        motion: &dyn Fn([f64; 2]) -> [f64; 2],
        untouched: &[Vec<f32>; 3],
        change: &mut [Vec<f32>; 3],
    ) {
        let pixels = self.geometry.width * self.geometry.height;
        for plane in &mut self.transmission {
            plane.clear();
            plane.resize(pixels, 1.0);
        }
        for marker in 0..self.lattice.markers.len() {
            let rest_m = self.lattice.markers[marker].rest_m;
            let moved = motion(rest_m);
            let centre_m = [0, 1].map(|axis| rest_m[axis] + moved[axis]);
            let stretch = stretch(motion, rest_m);
            for channel in 0..3 {
                let at = [0, 1].map(|axis| centre_m[axis] + self.shift_m[channel][axis]);
                self.dot(channel, at, stretch);
            }
        }
        for channel in 0..3 {
            let light = untouched[channel].iter().zip(&mut change[channel]);
            for ((bare, change), passes) in light.zip(&self.transmission[channel]) {
                *change = (bare + *change) * passes - bare;
            }
        }
    }

    /// Draws one dot; `stretch` is the gradient of the skin's motion.
    fn dot(&mut self, channel: usize, centre_m: [f64; 2], stretch: [[f64; 2]; 2]) {
        let SensorGeometry {
            width,
            height,
            pixel_m,
            ..
        } = self.geometry;
        let [[a, b], [c, d]] = stretch;
        let inverse = [[d, -b], [-c, a]].map(|row| row.map(|v| v / (a * d - b * c)));
        let [x, y] = self.geometry.gel_m_to_pixel(centre_m);
        let reach = |row: [f64; 2]| self.reach_m * row[0].hypot(row[1]) / pixel_m;
        let span = |at: f64, reach: f64, count: usize| {
            let first = (at - reach).ceil().clamp(0.0, count as f64) as usize;
            let end = ((at + reach).floor() + 1.0).clamp(0.0, count as f64) as usize;
            first..end
        };
        let columns = span(x, reach(stretch[0]), width);
        let per_entry = (TABLE - 1) as f64 / (self.reach_m * self.reach_m);
        for row in span(y, reach(stretch[1]), height) {
            for column in columns.clone() {
                let off = [(column as f64 - x) * pixel_m, (row as f64 - y) * pixel_m];
                let [u, v] = inverse.map(|r| r[0] * off[0] + r[1] * off[1]);
                let entry = (u * u + v * v) * per_entry;
                let lower = entry as usize;
                if lower + 1 >= TABLE {
                    continue;
                }
                let fraction = (entry - lower as f64) as f32;
                let dark =
                    self.table[lower] + fraction * (self.table[lower + 1] - self.table[lower]);
                self.transmission[channel][row * width + column] *= 1.0 - dark;
            }
        }
    }
}

/// Gradient of the motion at a point, rows (x, y) by derivatives (x, y), with its stretches limited.
fn stretch(motion: &dyn Fn([f64; 2]) -> [f64; 2], at: [f64; 2]) -> [[f64; 2]; 2] {
    let h = STRETCH_STEP_M;
    let slope = |axis: usize| {
        let (mut before, mut after) = (at, at);
        before[axis] -= h;
        after[axis] += h;
        let (before, after) = (motion(before), motion(after));
        [0, 1].map(|c| (after[c] - before[c]) / (2.0 * h))
    };
    let (along_x, along_y) = (slope(0), slope(1));
    let gradient = [
        [1.0 + along_x[0], along_y[0]],
        [along_x[1], 1.0 + along_y[1]],
    ];
    let [[a, b], [c, d]] = gradient;
    // The singular values are m ± n.
    let sum = 0.5 * (a + d).hypot(c - b);
    let difference = 0.5 * (a - d).hypot(c + b);
    let [low, high] = STRETCH;
    if a * d - b * c > 0.0 && sum - difference >= low && sum + difference <= high {
        gradient
    } else {
        [[1.0, 0.0], [0.0, 1.0]]
    }
}

/// Cumulative normal distribution, within 2e-4 (Page, 1977).
fn normal_cdf(x: f64) -> f64 {
    let argument = (2.0 / std::f64::consts::PI).sqrt() * x * (1.0 + 0.044_715 * x * x);
    0.5 * (1.0 + argument.tanh())
}

#[cfg(test)]
#[path = "dots_test.rs"]
mod tests;
