//! Detects the contact of a ball in an image.
//!
//! The shape of a pressed ball depends on its centre and contact radius only. For each trial,
//! quadratic shading is fitted to the change around the contact, and the residual is minimised by
//! downhill simplex. The shading need not be known.

use image::RgbImage;

use super::press_set::PressSet;
use super::score::{ChangePlanes, observe_where};
use super::simplex::minimise;
use crate::bessel::k1;
use crate::gaussian::{Gaussian, Region};
use crate::shading::{NormalOrder, normal_terms};
use gripcast_base::linear::Cholesky;
use gripcast_base::statistics::median;

/// Assumed decay length around a contact, m.
const SINK_LENGTH_M: f64 = 1e-3;
/// Half size of the window around the contact, m.
const WINDOW_M: f64 = 3.6e-3;
/// Maximum residual fraction of the best trial.
const MAX_RESIDUAL: f64 = 0.6;
/// Maximum contact radius relative to the ball radius.
const MAX_CONTACT: f64 = 0.95;
/// Quadratic shading terms and a constant.
const TERMS: usize = 9;
/// Minimum change of a contact, grey levels.
const MIN_CHANGE: f32 = 8.0;

/// Returns centre and radius of the contact, px, or the reason why none is found.
pub(super) fn find_contact(set: &PressSet, image: &RgbImage) -> Result<([f64; 2], f64), String> {
    let change = change_of(set, image);
    let energy = energy_of(&change, set.geometry.width);
    let (centre, spread) = centre_of_energy(&energy, set)?;
    let window = Window::around(set, &change, centre);
    let ball_px = set.ball_m / set.geometry.pixel_m;
    let largest = MAX_CONTACT * ball_px;
    let start = [centre[0], centre[1], (0.8 * spread).min(0.8 * largest)];
    let (best, residual) = minimise(
        &start,
        &[0.15 * spread, 0.15 * spread, 0.25 * start[2]],
        200,
        1e-6,
        &mut |trial| window.residual_fraction([trial[0], trial[1]], trial[2], ball_px),
    );
    let radius = best[2].clamp(MIN_RADIUS_PX, largest);
    if !residual.is_finite() || residual > MAX_RESIDUAL {
        return Err(format!(
            "no contact of a ball found in the image (the best fit leaves {:.0} % of the change)",
            100.0 * residual
        ));
    }
    Ok(([best[0], best[1]], radius))
}

/// Minimum contact radius, px.
const MIN_RADIUS_PX: f64 = 2.0;

/// Returns the change, with the background fitted to the pixels that look untouched.
fn change_of(set: &PressSet, image: &RgbImage) -> ChangePlanes {
    let mut observed = observe_where(set, image, |_| true);
    for _ in 0..6 {
        let limits: [f32; 3] =
            std::array::from_fn(|c| 2.5 * spread_of(&observed.change[c]).max(1.0));
        let before = observed.change;
        observed = observe_where(set, image, |i| {
            (0..3).all(|c| before[c][i].abs() < limits[c])
        });
    }
    observed.change
}

/// Robust standard deviation: 1.4826 × median of |value|.
fn spread_of(plane: &[f32]) -> f32 {
    let sizes = plane.iter().step_by(7).map(|v| f64::from(v.abs()));
    1.4826 * median(sizes).unwrap_or(0.0) as f32
}

/// Squared change over all channels, slightly smoothed.
fn energy_of(change: &ChangePlanes, width: usize) -> Vec<f32> {
    let mut gaussian = Gaussian::new(2.0);
    let mut energy = vec![0.0f32; change[0].len()];
    for plane in change {
        let mut plane = plane.clone();
        if let Some(region) = Region::nonzero(&plane, width) {
            gaussian.apply(&mut plane, width, region);
        }
        for (sum, value) in energy.iter_mut().zip(&plane) {
            *sum += value * value;
        }
    }
    energy
}

/// Returns the centre of the strongest change and the RMS distance from it, px.
fn centre_of_energy(energy: &[f32], set: &PressSet) -> Result<([f64; 2], f64), String> {
    let width = set.geometry.width;
    let mut blurred = energy.to_vec();
    if let Some(region) = Region::nonzero(energy, width) {
        Gaussian::new(12.0).apply(&mut blurred, width, region);
    }
    let Some(peak) = (0..blurred.len()).max_by(|a, b| blurred[*a].total_cmp(&blurred[*b])) else {
        return Err("the image has no pixels".to_owned());
    };
    let strongest = energy.iter().copied().fold(0.0, f32::max).sqrt();
    if strongest < MIN_CHANGE {
        return Err(format!(
            "no contact in the image: the maximum change is {strongest:.1} grey levels, at least \
             {MIN_CHANGE} are required"
        ));
    }
    let mut centre = [(peak % width) as f64, (peak / width) as f64];
    let mut spread = WINDOW_M / set.geometry.pixel_m / 2.2;
    for _ in 0..20 {
        let near = |i: usize| {
            let (x, y) = (
                (i % width) as f64 - centre[0],
                (i / width) as f64 - centre[1],
            );
            x.hypot(y) < 2.2 * spread
        };
        let inside: Vec<usize> = (0..energy.len()).filter(|i| near(*i)).collect();
        let floor = 0.15 * inside.iter().map(|i| energy[*i]).fold(0.0, f32::max);
        let weight = |i: usize| f64::from((energy[i] - floor).max(0.0));
        let sum: f64 = inside.iter().map(|i| weight(*i)).sum();
        let mean = |value: &dyn Fn(usize) -> f64| {
            inside.iter().map(|i| weight(*i) * value(*i)).sum::<f64>() / sum.max(1e-12)
        };
        centre = [mean(&|i| (i % width) as f64), mean(&|i| (i / width) as f64)];
        let square = mean(&|i| {
            ((i % width) as f64 - centre[0]).powi(2) + ((i / width) as f64 - centre[1]).powi(2)
        });
        spread = square.sqrt().max(3.0);
    }
    Ok((centre, spread))
}

/// Subsampled change around a contact.
struct Window {
    positions: Vec<[f64; 2]>,
    change: Vec<[f64; 3]>,
    square: f64,
    sink_px: f64,
}

impl Window {
    fn around(set: &PressSet, change: &ChangePlanes, centre: [f64; 2]) -> Self {
        let reach = WINDOW_M / set.geometry.pixel_m;
        let step = ((reach / 35.0) as usize).max(1);
        let (width, height) = (set.geometry.width, set.geometry.height);
        let span = |middle: f64, count: usize| {
            let first = (middle - reach).max(0.0) as usize;
            let last = ((middle + reach).max(0.0) as usize + 1).min(count);
            (first.min(count)..last).step_by(step)
        };
        let mut window = Self {
            positions: Vec::new(),
            change: Vec::new(),
            square: 0.0,
            sink_px: SINK_LENGTH_M / set.geometry.pixel_m,
        };
        for y in span(centre[1], height) {
            for x in span(centre[0], width) {
                let values = [0, 1, 2].map(|c| f64::from(change[c][y * width + x]));
                window.square += values.iter().map(|v| v * v).sum::<f64>();
                window.positions.push([x as f64, y as f64]);
                window.change.push(values);
            }
        }
        window
    }

    /// Returns the fraction of the squared change unexplained by the best shading of a trial.
    fn residual_fraction(&self, centre: [f64; 2], radius: f64, ball_px: f64) -> f64 {
        let radius = radius.clamp(MIN_RADIUS_PX, MAX_CONTACT * ball_px);
        let slope = Slope::new(radius, ball_px, self.sink_px);
        let mut gram = [[0.0; TERMS]; TERMS];
        let mut cross = [[0.0; 3]; TERMS];
        for (position, change) in self.positions.iter().zip(&self.change) {
            let terms = slope.terms(position[0] - centre[0], position[1] - centre[1]);
            for (i, a) in terms.iter().enumerate() {
                for (j, b) in terms.iter().enumerate().take(i + 1) {
                    gram[i][j] += a * b;
                }
                for (sum, value) in cross[i].iter_mut().zip(change) {
                    *sum += a * value;
                }
            }
        }
        let ridge = 1e-6 * self.positions.len() as f64;
        for (i, row) in gram.iter_mut().enumerate() {
            row[i] += ridge;
        }
        let Some(factor) = Cholesky::new(&gram) else {
            return f64::INFINITY;
        };
        let mut explained = 0.0;
        for c in 0..3 {
            let right = cross.map(|row| row[c]);
            for (value, right) in factor.solve(&right).into_iter().zip(right) {
                explained += value * (right + ridge * value);
            }
        }
        1.0 - explained / self.square.max(1e-12)
    }
}

/// Radial slope of the gel around a ball, towards the camera.
struct Slope {
    contact: f64,
    ball: f64,
    length: f64,
    at_border: f64,
    k1_at_border: f64,
}

impl Slope {
    fn new(contact: f64, ball: f64, length: f64) -> Self {
        Self {
            contact,
            ball,
            length,
            at_border: contact / (ball * ball - contact * contact).sqrt(),
            k1_at_border: k1(contact / length),
        }
    }

    fn at(&self, distance: f64) -> f64 {
        if distance < self.contact {
            distance / (self.ball * self.ball - distance * distance).sqrt()
        } else {
            self.at_border * k1(distance / self.length) / self.k1_at_border
        }
    }

    /// Shading terms at a position relative to the centre.
    fn terms(&self, x: f64, y: f64) -> [f64; TERMS] {
        let distance = x.hypot(y).max(1e-9);
        let slope = self.at(distance);
        let length = (1.0 + slope * slope).sqrt();
        let side = slope / (length * distance);
        let terms = normal_terms(
            (x * side) as f32,
            (y * side) as f32,
            (1.0 / length - 1.0) as f32,
        );
        let mut out = [1.0; TERMS];
        for (out, term) in out
            .iter_mut()
            .zip(terms.iter().take(NormalOrder::Quadratic.terms()))
        {
            *out = f64::from(*term);
        }
        out
    }
}
