//! Fits LEDs to presses: positions by downhill simplex, non-negative intensities, which enter
//! linearly, by coordinate descent.

use super::press_set::PressSet;
use super::score::{CentreDistance, observe};
use super::simplex::minimise;
use super::sums::normals_of;
use crate::led::PointLight;
use crate::{Led, LedShading, Smoothing};

/// Approximate number of pixels used per press.
const PIXELS_PER_PRESS: usize = 400;
/// Pixels up to this distance from the border of a contact are fitted.
const FIT_PX: f64 = 30.0;
/// Candidate Phong exponents.
const SHININESS: [u32; 4] = [2, 4, 8, 16];
/// Simplex evaluations per exponent.
const EVALUATIONS: usize = 220;
/// Sweeps of the coordinate descent.
const SWEEPS: usize = 60;
/// Ridge on the intensities, relative to the mean diagonal.
const RIDGE: f64 = 1e-3;
/// Plausible distances of LEDs from the centre and heights above the face, m.
const REACH_M: std::ops::RangeInclusive<f64> = 4e-3..=60e-3;
const ABOVE_M: std::ops::RangeInclusive<f64> = 1e-3..=40e-3;

/// A pixel of a press: position (m), normal (nx, ny, nz − 1), change (grey levels).
struct Sample {
    position: [f32; 2],
    normal: [f32; 3],
    change: [f64; 3],
}

/// Fits three LEDs to some presses of a set for a given gel shape.
pub(super) fn fit_leds(set: &PressSet, train: &[usize], smoothing: &Smoothing) -> LedShading {
    let samples = samples(set, train, smoothing);
    let guess = LedShading::mini_guess();
    let start: Vec<f64> = guess
        .leds
        .iter()
        .flat_map(|led| {
            let [x, y, z] = led.position_m;
            [y.atan2(x), x.hypot(y) * 1e3, z * 1e3]
        })
        .collect();
    let steps = [0.6, 4.0, 3.0].repeat(3);
    let mut best: Option<(f64, LedShading)> = None;
    for shininess in SHININESS {
        let mut value = |unknowns: &[f64]| fit_intensities(&samples, unknowns, shininess).0;
        let (unknowns, error) = minimise(&start, &steps, EVALUATIONS, 1e-9, &mut value);
        if best
            .as_ref()
            .is_none_or(|(best_error, _)| error < *best_error)
        {
            best = Some((error, fit_intensities(&samples, &unknowns, shininess).1));
        }
    }
    best.map_or(guess, |(_, shading)| shading)
}

fn samples(set: &PressSet, train: &[usize], smoothing: &Smoothing) -> Vec<Sample> {
    let mut samples = Vec::new();
    for index in train {
        let press = &set.presses[*index];
        let normals = normals_of(set, press, smoothing);
        let observed = observe(set, press);
        let distance = CentreDistance::new(press);
        let near: Vec<usize> = (0..normals.x.len())
            .filter(|i| distance.at(*i) < press.radius_px + FIT_PX)
            .collect();
        // Odd stride: no common factor with the image sides.
        let stride = (near.len() / PIXELS_PER_PRESS).max(1) | 1;
        for i in near.into_iter().step_by(stride) {
            let (x, y) = (i % set.geometry.width, i / set.geometry.width);
            let [x, y] = set.geometry.pixel_to_gel_m(x as f64, y as f64);
            samples.push(Sample {
                position: [x as f32, y as f32],
                normal: [normals.x[i], normals.y[i], normals.z_less_1[i]],
                change: std::array::from_fn(|c| f64::from(observed.change[c][i])),
            });
        }
    }
    samples
}

/// LEDs at positions given by azimuth (rad), distance and height (mm) of each.
fn leds_at(unknowns: &[f64]) -> Vec<Led> {
    unknowns
        .chunks_exact(3)
        .map(|u| {
            let (sin, cos) = u[0].sin_cos();
            let reach = (u[1] * 1e-3).clamp(*REACH_M.start(), *REACH_M.end());
            let above = (u[2] * 1e-3).clamp(*ABOVE_M.start(), *ABOVE_M.end());
            Led {
                position_m: [reach * cos, reach * sin, above],
                diffuse: [0.0; 3],
                specular: [0.0; 3],
            }
        })
        .collect()
}

/// Fits intensities at given positions; returns the relative squared error and the shading.
fn fit_intensities(samples: &[Sample], unknowns: &[f64], shininess: u32) -> (f64, LedShading) {
    let mut leds = leds_at(unknowns);
    let unit: Vec<PointLight> = leds
        .iter()
        .map(|led| PointLight::new(led, shininess))
        .collect();
    let count = 2 * unit.len();
    let mut gram = vec![0.0; count * count];
    let mut cross = vec![[0.0; 3]; count];
    let mut square = 0.0;
    let mut terms = vec![0.0; count];
    for sample in samples {
        for (light, out) in unit.iter().zip(terms.chunks_exact_mut(2)) {
            let [diffuse, specular] = light.change(sample.position, sample.normal);
            out.copy_from_slice(&[f64::from(diffuse), f64::from(specular)]);
        }
        for (i, a) in terms.iter().enumerate() {
            for (sum, b) in gram[i * count..].iter_mut().zip(&terms) {
                *sum += a * b;
            }
            for (sum, value) in cross[i].iter_mut().zip(sample.change) {
                *sum += a * value;
            }
        }
        square += sample.change.iter().map(|v| v * v).sum::<f64>();
    }
    let mean = (0..count).map(|i| gram[i * count + i]).sum::<f64>() / count as f64;
    for i in 0..count {
        gram[i * count + i] += RIDGE * mean + 1e-12;
    }
    let mut error = square;
    for channel in 0..3 {
        let right: Vec<f64> = cross.iter().map(|row| row[channel]).collect();
        let solution = non_negative_least_squares(&gram, &right);
        for (i, w) in solution.iter().enumerate() {
            let image: f64 = (0..count).map(|j| gram[i * count + j] * solution[j]).sum();
            error += w * (image - 2.0 * right[i]);
        }
        for (led, pair) in leds.iter_mut().zip(solution.chunks_exact(2)) {
            (led.diffuse[channel], led.specular[channel]) = (pair[0], pair[1]);
        }
    }
    (error / square.max(1e-12), LedShading { shininess, leds })
}

/// Non-negative least squares by coordinate descent.
fn non_negative_least_squares(gram: &[f64], right: &[f64]) -> Vec<f64> {
    let count = right.len();
    let mut solution = vec![0.0f64; count];
    for _ in 0..SWEEPS {
        for i in 0..count {
            let image: f64 = (0..count).map(|j| gram[i * count + j] * solution[j]).sum();
            let step = (right[i] - image) / gram[i * count + i];
            solution[i] = (solution[i] + step).max(0.0);
        }
    }
    solution
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn negative_solutions_are_clamped_to_zero() {
        let solution = non_negative_least_squares(&[2.0, 0.5, 0.5, 1.0], &[3.0, -1.0]);
        assert!((solution[0] - 1.5).abs() < 1e-9 && solution[1] == 0.0);
    }

    #[test]
    fn intensities_of_known_leds_are_recovered() {
        let unknowns = [0.3, 12.0, 5.0, 2.4, 14.0, 6.0, -1.8, 13.0, 4.0];
        let mut truth = leds_at(&unknowns);
        for (i, led) in truth.iter_mut().enumerate() {
            led.diffuse[i] = 100.0;
            led.specular = [5.0, 10.0, 15.0];
        }
        let samples: Vec<Sample> = (0..900)
            .map(|i| {
                let (a, b) = ((i % 30) as f32 / 15.0 - 1.0, (i / 30) as f32 / 15.0 - 1.0);
                let length = (1.0 + a * a + b * b).sqrt();
                let position = [4e-3 * b, 3e-3 * a * b];
                let normal = [a / length, b / length, 1.0 / length - 1.0];
                let change = std::array::from_fn(|c| {
                    truth
                        .iter()
                        .map(|led| {
                            let [d, s] = PointLight::new(led, 8).change(position, normal);
                            led.diffuse[c] * f64::from(d) + led.specular[c] * f64::from(s)
                        })
                        .sum()
                });
                Sample {
                    position,
                    normal,
                    change,
                }
            })
            .collect();
        let (error, shading) = fit_intensities(&samples, &unknowns, 8);
        assert!(error < 1e-3, "{error}");
        assert!((shading.leds[1].diffuse[1] - 100.0).abs() < 10.0);
    }
}
