//! Image of the untouched gel: a smooth fit stored in the profile.

use image::RgbImage;
use serde::{Deserialize, Serialize};

use super::ensure;
use gripcast_base::error::{Error, Result};

/// Maximum degree of a fit.
const MAX_DEGREE: usize = 12;

/// Smooth fit of the background: per channel Σ c_ij P_i(x) P_j(y), i + j ≤ degree, with Legendre
/// polynomials P and x, y in ±1 across the columns and rows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BackgroundFit {
    /// Maximum i + j, up to 12.
    pub degree: usize,
    /// Red coefficients, grey levels: i = 0 with all j, then i = 1, …
    pub red: Vec<f64>,
    /// Green coefficients, same order.
    pub green: Vec<f64>,
    /// Blue coefficients, same order.
    pub blue: Vec<f64>,
}

impl BackgroundFit {
    /// Fits an image of at least 2 × 2 pixels by least squares.
    ///
    /// The sampled polynomials are nearly orthogonal, so a few Gauss-Seidel sweeps over the normal
    /// equations suffice.
    pub fn from_image(image: &RgbImage, degree: usize) -> Self {
        let degree = degree.min(MAX_DEGREE);
        let (width, height) = (image.width() as usize, image.height() as usize);
        let (columns, rows) = (legendre(width, degree), legendre(height, degree));
        let (column_products, row_products) = (products(&columns), products(&rows));
        let [red, green, blue] = std::array::from_fn(|channel| {
            let target = moments(image, channel, &columns, &rows);
            let mut values = vec![0.0; terms(degree).count()];
            for _ in 0..SWEEPS {
                for (term, (i, j)) in terms(degree).enumerate() {
                    let fitted = |((k, l), value): ((usize, usize), &f64)| {
                        value * column_products[i][k] * row_products[j][l]
                    };
                    let found: f64 = terms(degree).zip(&values).map(fitted).sum();
                    let norm = column_products[i][i] * row_products[j][j];
                    values[term] += (target[i][j] - found) / norm;
                }
            }
            values
        });
        Self {
            degree,
            red,
            green,
            blue,
        }
    }

    /// Checks the degree and the number of coefficients.
    ///
    /// # Errors
    /// `Config` with the channel, the expected and the found number.
    pub fn validate(&self) -> Result<()> {
        let degree = self.degree;
        ensure(degree <= MAX_DEGREE, || {
            Error::config(format!(
                "background.degree must be 0 to {MAX_DEGREE}, found {degree}"
            ))
        })?;
        let expected = terms(degree).count();
        let channels = [&self.red, &self.green, &self.blue];
        for (name, values) in ["red", "green", "blue"].into_iter().zip(channels) {
            let found = values.len();
            ensure(
                found == expected && values.iter().all(|v| v.is_finite()),
                || {
                    Error::config(format!(
                        "background.{name} must be {expected} finite coefficients for degree \
                     {degree}, found {found}"
                    ))
                },
            )?;
        }
        Ok(())
    }

    /// Evaluates the fit on a grid: planes of red, green, blue, grey levels.
    pub fn planes(&self, width: usize, height: usize) -> [Vec<f32>; 3] {
        let (columns, rows) = (legendre(width, self.degree), legendre(height, self.degree));
        [&self.red, &self.green, &self.blue].map(|values| {
            let mut plane = vec![0.0f64; width * height];
            for ((i, j), value) in terms(self.degree).zip(values) {
                subtract(&mut plane, &columns[i], &rows[j], -value);
            }
            plane.into_iter().map(|v| v as f32).collect()
        })
    }
}

/// Gauss-Seidel sweeps of the fit.
const SWEEPS: usize = 4;

/// Iterates over the degrees (i, j) of all terms.
fn terms(degree: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..=degree).flat_map(move |i| (0..=degree - i).map(move |j| (i, j)))
}

/// Evaluates P_0 to P_degree at `count` pixel centres across ±1.
fn legendre(count: usize, degree: usize) -> Vec<Vec<f64>> {
    let positions = (0..count).map(|i| (2.0 * i as f64 + 1.0) / count as f64 - 1.0);
    let positions: Vec<f64> = positions.collect();
    let mut all = vec![vec![1.0; count], positions.clone()];
    for n in 1..degree {
        let next = (0..count).map(|i| {
            let (n, x) = (n as f64, positions[i]);
            ((2.0 * n + 1.0) * x * all[all.len() - 1][i] - n * all[all.len() - 2][i]) / (n + 1.0)
        });
        let next = next.collect();
        all.push(next);
    }
    all
}

/// Gram matrix of some polynomials over the pixels.
fn products(polynomials: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let with = |a: &Vec<f64>| polynomials.iter().map(|b| dot(a, b)).collect();
    polynomials.iter().map(with).collect()
}

/// `[i][j]`: sum over a channel times column polynomial i and row polynomial j.
fn moments(
    image: &RgbImage,
    channel: usize,
    columns: &[Vec<f64>],
    rows: &[Vec<f64>],
) -> Vec<Vec<f64>> {
    let mut sums = vec![vec![0.0; rows.len()]; columns.len()];
    let mut line = Vec::with_capacity(image.width() as usize);
    for (y, pixels) in image.rows().enumerate() {
        line.clear();
        line.extend(pixels.map(|pixel| f64::from(pixel.0[channel])));
        for (sums, column) in sums.iter_mut().zip(columns) {
            let along = dot(&line, column);
            for (sum, row) in sums.iter_mut().zip(rows) {
                *sum += along * row[y];
            }
        }
    }
    sums
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// plane −= step · column ⊗ row.
fn subtract(plane: &mut [f64], column: &[f64], row: &[f64], step: f64) {
    for (line, weight) in plane.chunks_exact_mut(column.len()).zip(row) {
        let weight = step * weight;
        for (value, c) in line.iter_mut().zip(column) {
            *value -= weight * c;
        }
    }
}

/// Returns the red, green and blue planes of an image, grey levels.
pub(super) fn planes_of(image: &RgbImage) -> [Vec<f32>; 3] {
    std::array::from_fn(|c| image.pixels().map(|p| f32::from(p.0[c])).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    #[test]
    fn smooth_image_is_reproduced() {
        let colour = |x: f64, y: f64| [120.0 + 40.0 * x * y, 100.0 - 50.0 * y * y, 80.0 + 20.0 * x];
        let image = RgbImage::from_fn(64, 48, |x, y| {
            let position = |i: u32, n: f64| (2.0 * f64::from(i) + 1.0) / n - 1.0;
            Rgb(colour(position(x, 64.0), position(y, 48.0)).map(|v| v.round() as u8))
        });
        let fit = BackgroundFit::from_image(&image, 4);
        fit.validate().unwrap();
        let planes = fit.planes(64, 48);
        for (i, pixel) in image.pixels().enumerate() {
            for (plane, level) in planes.iter().zip(pixel.0) {
                assert!((plane[i] - f32::from(level)).abs() < 0.8);
            }
        }
        // The same colours at another size.
        let half = fit.planes(32, 24);
        assert!((half[0][12 * 32 + 16] - 120.0).abs() < 1.0);
    }

    #[test]
    fn invalid_fit_is_refused() {
        let mut fit = BackgroundFit::from_image(&RgbImage::new(8, 8), 2);
        fit.green.pop();
        assert!(fit.validate().unwrap_err().to_string().contains("green"));
        fit.degree = 99;
        assert!(fit.validate().is_err());
    }

    #[test]
    fn degree_zero_is_the_mean() {
        let fit = BackgroundFit::from_image(&RgbImage::from_pixel(5, 4, Rgb([7, 8, 9])), 0);
        assert!((fit.red[0] - 7.0).abs() < 1e-9 && fit.blue.len() == 1);
    }
}
