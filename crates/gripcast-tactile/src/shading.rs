//! Polynomial shading: change of the image as a function of the gel's slope.
//!
//! For each channel the change relative to the untouched gel, grey levels, is d(n, x, y) = Σ_k
//! t_k(n) · Σ_p c_kp · q_p(x, y), with terms t_k of the unit normal (linear: nx, ny, nz − 1;
//! quadratic adds nx², ny², nx ny, nx (nz − 1), ny (nz − 1); cubic adds nx³, ny³, nx² ny, nx ny²)
//! and terms q_p of the position (constant: 1; linear: x, y; quadratic: x², y², xy). x and y are 0
//! at the image centre and ±1 at the ends of its longer side. GelSight's `gssim` uses the same
//! form, with one polynomial of the position per light.

use serde::{Deserialize, Serialize};

use super::ensure;
use super::normals::Normals;
use super::press_depth::SensorGeometry;
use gripcast_base::error::{Error, Result};

/// Order of a polynomial shading in the normal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NormalOrder {
    /// 3 terms.
    Linear,
    /// 8 terms.
    Quadratic,
    /// 12 terms.
    Cubic,
}

/// Order of a polynomial shading in the position.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PositionOrder {
    /// 1 term: uniform over the image.
    Constant,
    /// 3 terms.
    Linear,
    /// 6 terms.
    Quadratic,
}

/// Maximum number of terms of the normal.
pub(super) const NORMAL_TERMS: usize = 12;
/// Maximum number of terms of the position.
pub(super) const POSITION_TERMS: usize = 6;

impl NormalOrder {
    /// All orders, ascending.
    pub const ALL: [Self; 3] = [Self::Linear, Self::Quadratic, Self::Cubic];

    /// Number of terms.
    pub fn terms(self) -> usize {
        match self {
            Self::Linear => 3,
            Self::Quadratic => 8,
            Self::Cubic => NORMAL_TERMS,
        }
    }
}

impl PositionOrder {
    /// All orders, ascending.
    pub const ALL: [Self; 3] = [Self::Constant, Self::Linear, Self::Quadratic];

    /// Number of terms.
    pub fn terms(self) -> usize {
        match self {
            Self::Constant => 1,
            Self::Linear => 3,
            Self::Quadratic => POSITION_TERMS,
        }
    }
}

/// Returns a vector scaled to length 1; 0 for 0.
pub(super) fn direction([x, y]: [f64; 2]) -> [f64; 2] {
    let length = x.hypot(y);
    if length > 0.0 {
        [x / length, y / length]
    } else {
        [0.0; 2]
    }
}

/// Returns all terms of a normal (nx, ny, nz − 1).
pub(super) fn normal_terms(x: f32, y: f32, z: f32) -> [f32; NORMAL_TERMS] {
    [
        x,
        y,
        z,
        x * x,
        y * y,
        x * y,
        x * z,
        y * z,
        x * x * x,
        y * y * y,
        x * x * y,
        x * y * y,
    ]
}

/// Returns all terms of a position.
pub(super) fn position_terms(x: f32, y: f32) -> [f32; POSITION_TERMS] {
    [1.0, x, y, x * x, y * y, x * y]
}

/// Position of a pixel, ±1 at the ends of the longer side.
pub(super) fn normalised_position(
    geometry: &SensorGeometry,
    column: usize,
    row: usize,
) -> [f32; 2] {
    let half = 0.5 * (geometry.width.max(geometry.height).max(2) as f64 - 1.0);
    let from_middle = |i: usize, n: usize| (i as f64 - 0.5 * (n as f64 - 1.0)) / half;
    [
        from_middle(column, geometry.width) as f32,
        from_middle(row, geometry.height) as f32,
    ]
}

/// Coefficients of a polynomial shading; the module documents the formula.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PolynomialShading {
    /// Order in the normal.
    pub normal: NormalOrder,
    /// Order in the position.
    pub position: PositionOrder,
    /// Maximum sine of the slope in the fitted data, above 0 to 1. Steeper slopes are limited to
    /// it, since a polynomial does not extrapolate.
    pub steepest: f64,
    /// Red coefficients, grey levels: for each term of the normal all terms of the position.
    pub red: Vec<f64>,
    /// Green coefficients, same order.
    pub green: Vec<f64>,
    /// Blue coefficients, same order.
    pub blue: Vec<f64>,
}

impl PolynomialShading {
    /// Returns the red, green and blue coefficients.
    pub fn channels(&self) -> [&[f64]; 3] {
        [&self.red, &self.green, &self.blue]
    }

    /// Tilt of the normal (x, y), of length 1, that brightens red, green and blue most in the middle
    /// of the image; 0 for a channel that no tilt brightens.
    pub(super) fn brightening_slope(&self) -> [[f64; 2]; 3] {
        let terms = self.position.terms();
        self.channels().map(|c| direction([c[0], c[terms]]))
    }

    /// Checks counts and ranges.
    ///
    /// # Errors
    /// `Config` with the channel, the expected and the found number.
    pub fn validate(&self) -> Result<()> {
        let steepest = self.steepest;
        ensure(steepest > 0.0 && steepest <= 1.0, || {
            Error::config(format!(
                "shading.steepest must be above 0 and at most 1, found {steepest}"
            ))
        })?;
        let (normal, position) = (self.normal, self.position);
        let expected = normal.terms() * position.terms();
        for (name, values) in ["red", "green", "blue"].into_iter().zip(self.channels()) {
            let found = values.len();
            ensure(
                found == expected && values.iter().all(|v| v.is_finite()),
                || {
                    Error::config(format!(
                        "shading.{name} must be {expected} finite coefficients for {normal:?} normals \
                     and {position:?} position, found {found}"
                    ))
                },
            )?;
        }
        Ok(())
    }

    /// Adds the change of each pixel, grey levels, to the red, green and blue planes.
    pub(super) fn add(
        &self,
        geometry: &SensorGeometry,
        normals: &Normals,
        planes: &mut [Vec<f32>; 3],
    ) {
        let Some(region) = normals.region else {
            return;
        };
        let positions: Vec<f32> = (region.x0..region.x1)
            .map(|x| normalised_position(geometry, x, 0)[0])
            .collect();
        let terms = self.normal.terms();
        for row in region.y0..region.y1 {
            let span = row * geometry.width + region.x0..row * geometry.width + region.x1;
            let [_, y] = normalised_position(geometry, 0, row);
            let coefficients = self.channels().map(|values| {
                let mut along = [[0.0; 3]; NORMAL_TERMS];
                for (k, along) in along.iter_mut().enumerate().take(terms) {
                    *along = self.along_row(values, k, y);
                }
                along
            });
            let normal = [&normals.x, &normals.y, &normals.z_less_1].map(|n| &n[span.clone()]);
            let [red, green, blue] = &mut *planes;
            let out = [red, green, blue].map(|plane| &mut plane[span.clone()]);
            if self.position == PositionOrder::Constant {
                add_row::<false>(terms, normal, &positions, &coefficients, out);
            } else {
                add_row::<true>(terms, normal, &positions, &coefficients, out);
            }
        }
    }

    /// Coefficients of term `k` in the row at `y` as a polynomial of x: c0 + c1 x + c2 x².
    fn along_row(&self, values: &[f64], k: usize, y: f32) -> [f32; 3] {
        let count = self.position.terms();
        let mut c = [0.0f32; POSITION_TERMS];
        for (c, value) in c.iter_mut().zip(&values[k * count..(k + 1) * count]) {
            *c = *value as f32;
        }
        [c[0] + y * (c[2] + y * c[4]), c[1] + y * c[5], c[3]]
    }
}

/// Pixels shaded together.
const LANES: usize = 16;

/// Adds the first `terms` terms of the normals of a row to its three channels. Without `ALONG_X`
/// only the first coefficient counts.
fn add_row<const ALONG_X: bool>(
    terms: usize,
    normals: [&[f32]; 3],
    positions: &[f32],
    coefficients: &[[[f32; 3]; NORMAL_TERMS]; 3],
    mut out: [&mut [f32]; 3],
) {
    for start in (0..positions.len()).step_by(LANES) {
        let [nx, ny, nz] = normals;
        let (nx, ny, nz) = (block(nx, start), block(ny, start), block(nz, start));
        let x = block(positions, start);
        let mut values = [[0.0f32; LANES]; NORMAL_TERMS];
        for lane in 0..LANES {
            let of_lane = normal_terms(nx[lane], ny[lane], nz[lane]);
            for (value, of_lane) in values.iter_mut().zip(of_lane) {
                value[lane] = of_lane;
            }
        }
        for (out, coefficients) in out.iter_mut().zip(coefficients) {
            let mut sum = block(out, start);
            for (value, [c0, c1, c2]) in values.iter().zip(coefficients).take(terms) {
                for lane in 0..LANES {
                    let coefficient = match ALONG_X {
                        true => c0 + x[lane] * (c1 + x[lane] * c2),
                        false => *c0,
                    };
                    sum[lane] += value[lane] * coefficient;
                }
            }
            match out[start..].first_chunk_mut() {
                Some(out) => *out = sum,
                None => out[start..]
                    .iter_mut()
                    .zip(sum)
                    .for_each(|(out, sum)| *out = sum),
            }
        }
    }
}

/// The pixels of a row from `start`, 0 behind its end.
#[inline]
fn block(row: &[f32], start: usize) -> [f32; LANES] {
    let rest = &row[start..];
    rest.first_chunk().copied().unwrap_or_else(|| {
        let mut block = [0.0; LANES];
        block[..rest.len()].copy_from_slice(rest);
        block
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn geometry() -> SensorGeometry {
        SensorGeometry {
            width: 20,
            height: 14,
            pixel_m: 1e-4,
            gel_thickness_m: 4e-3,
        }
    }

    #[test]
    fn row_shading_equals_sum_of_terms() {
        let geometry = geometry();
        let map: Vec<f32> = (0..280)
            .map(|i| 1e-4 * ((i % 20) as f32 * 0.7).sin() * ((i / 20) as f32 * 0.5).cos())
            .collect();
        let mut normals = Normals::default();
        normals.compute(&map, &geometry);
        for normal in NormalOrder::ALL {
            for position in PositionOrder::ALL {
                let values: Vec<f64> = (0..normal.terms() * position.terms())
                    .map(|i| ((i * 7 % 11) as f64 - 5.0) * 3.0)
                    .collect();
                let shading = PolynomialShading {
                    normal,
                    position,
                    steepest: 1.0,
                    red: values.clone(),
                    green: values.iter().map(|v| -v).collect(),
                    blue: values.iter().rev().copied().collect(),
                };
                shading.validate().unwrap();
                let mut planes = std::array::from_fn(|_| vec![1.0; 280]);
                shading.add(&geometry, &normals, &mut planes);
                for i in [0, 57, 133, 279] {
                    let t = normal_terms(normals.x[i], normals.y[i], normals.z_less_1[i]);
                    let [x, y] = normalised_position(&geometry, i % 20, i / 20);
                    let q = position_terms(x, y);
                    let expected: f64 = (0..normal.terms())
                        .flat_map(|k| (0..position.terms()).map(move |p| (k, p)))
                        .map(|(k, p)| values[k * position.terms() + p] * f64::from(t[k] * q[p]))
                        .sum();
                    assert!((f64::from(planes[0][i]) - 1.0 - expected).abs() < 1e-3);
                    assert!((f64::from(planes[1][i]) - 1.0 + expected).abs() < 1e-3);
                }
            }
        }
    }

    #[test]
    fn invalid_coefficients_are_refused() {
        let mut shading = PolynomialShading {
            normal: NormalOrder::Linear,
            position: PositionOrder::Linear,
            steepest: 1.0,
            red: vec![0.0; 9],
            green: vec![0.0; 8],
            blue: vec![0.0; 9],
        };
        let text = shading.validate().unwrap_err().to_string();
        assert!(text.contains("green") && text.contains("found 8"), "{text}");
        shading.green = vec![f64::NAN; 9];
        assert!(shading.validate().is_err());
        shading.green = vec![0.0; 9];
        shading.steepest = 0.0;
        assert!(shading.validate().is_err());
    }

    #[test]
    fn position_is_1_at_ends_of_longer_side() {
        assert_eq!(normalised_position(&geometry(), 0, 0)[0], -1.0);
        assert_eq!(normalised_position(&geometry(), 19, 0)[0], 1.0);
        assert!(normalised_position(&geometry(), 0, 13)[1] < 0.7);
    }
}
