//! Normal-equation sums of a press, from which any polynomial shading is fitted and scored.

use super::press_set::{LabelledPress, PressSet};
use super::score::{CentreDistance, ChangePlanes, in_patch};
use crate::normals::Normals;
use crate::shading::{
    NORMAL_TERMS, NormalOrder, POSITION_TERMS, PositionOrder, normal_terms, normalised_position,
    position_terms,
};
use crate::{Smoother, Smoothing};

/// Maximum distance of fitted pixels from the contact border.
const FIT_PX: f64 = 50.0;
/// Subsampling along both axes, px.
const STRIDE: usize = 2;
/// Terms of the largest shading.
const TERMS: usize = NORMAL_TERMS * POSITION_TERMS;

/// Sums over pixels: terms × terms, terms × change, change².
#[derive(Clone, Debug)]
pub(super) struct SquareSums {
    pub(super) gram: Vec<[f64; TERMS]>,
    pub(super) cross: Vec<[f64; 3]>,
    pub(super) square: f64,
}

/// Sums of one press.
#[derive(Clone, Debug)]
pub(super) struct PressSums {
    /// Over the fitted pixels.
    pub(super) fit: SquareSums,
    /// Over the scored patch.
    pub(super) patch: SquareSums,
    /// Maximum sine of the slope in the press.
    pub(super) steepest: f64,
}

/// Indices of a shading's terms among those of the largest.
pub(super) fn term_indices(normal: NormalOrder, position: PositionOrder) -> Vec<usize> {
    (0..normal.terms())
        .flat_map(|k| (0..position.terms()).map(move |p| k * POSITION_TERMS + p))
        .collect()
}

/// Normals of a labelled contact for a gel shape.
pub(super) fn normals_of(set: &PressSet, press: &LabelledPress, smoothing: &Smoothing) -> Normals {
    let depth = set.contact(press).press(smoothing.sink_length_m);
    let mut normals = Normals::default();
    let mut smoother = Smoother::new(smoothing, set.geometry.pixel_m);
    normals.compute(smoother.smooth(&depth), &set.geometry);
    normals
}

impl PressSums {
    /// Computes the sums of a press from its observed change.
    pub(super) fn new(
        set: &PressSet,
        press: &LabelledPress,
        change: &ChangePlanes,
        smoothing: &Smoothing,
    ) -> Self {
        let normals = normals_of(set, press, smoothing);
        let distance = CentreDistance::new(press);
        let radius = press.radius_px;
        let over = |chosen: &dyn Fn(f64) -> bool| {
            let (width, height) = (set.geometry.width, set.geometry.height);
            let pixels: Vec<usize> = (0..height)
                .step_by(STRIDE)
                .flat_map(|y| (0..width).step_by(STRIDE).map(move |x| y * width + x))
                .filter(|i| chosen(distance.at(*i)))
                .collect();
            SquareSums::over(set, &pixels, &normals, change)
        };
        Self {
            fit: over(&|d| d < radius + FIT_PX),
            patch: over(&|d| in_patch(d, radius)),
            steepest: normals
                .x
                .iter()
                .zip(&normals.y)
                .map(|(x, y)| f64::from(x.hypot(*y)))
                .fold(0.0, f64::max),
        }
    }
}

impl SquareSums {
    fn zero() -> Self {
        Self {
            gram: vec![[0.0; TERMS]; TERMS],
            cross: vec![[0.0; 3]; TERMS],
            square: 0.0,
        }
    }

    fn over(set: &PressSet, pixels: &[usize], normals: &Normals, change: &ChangePlanes) -> Self {
        let width = set.geometry.width;
        let mut sums = Self::zero();
        for i in pixels {
            let t = normal_terms(normals.x[*i], normals.y[*i], normals.z_less_1[*i]);
            let [x, y] = normalised_position(&set.geometry, i % width, i / width);
            let q = position_terms(x, y);
            let mut terms = [0.0; TERMS];
            for (terms, t) in terms.as_chunks_mut::<POSITION_TERMS>().0.iter_mut().zip(t) {
                *terms = q.map(|q| f64::from(t * q));
            }
            let values = [0, 1, 2].map(|c| f64::from(change[c][*i]));
            sums.square += values.iter().map(|v| v * v).sum::<f64>();
            for (k, term) in terms.iter().enumerate() {
                // Symmetric.
                for (sum, other) in sums.gram[k][..=k].iter_mut().zip(&terms) {
                    *sum += term * other;
                }
                for (sum, value) in sums.cross[k].iter_mut().zip(values) {
                    *sum += term * value;
                }
            }
        }
        for i in 0..TERMS {
            for j in i + 1..TERMS {
                sums.gram[i][j] = sums.gram[j][i];
            }
        }
        sums
    }

    /// Adds up the sums of several presses in order.
    pub(super) fn total<'a>(parts: impl Iterator<Item = &'a Self>) -> Self {
        let mut total = Self::zero();
        for part in parts {
            let gram = total.gram.as_flattened_mut().iter_mut();
            let cross = total.cross.as_flattened_mut().iter_mut();
            let others = part.gram.as_flattened().iter();
            for (sum, other) in gram.zip(others).chain(cross.zip(part.cross.as_flattened())) {
                *sum += other;
            }
            total.square += part.square;
        }
        total
    }

    /// Squared error of coefficients of the terms at `indices`.
    pub(super) fn error(&self, indices: &[usize], coefficients: &[Vec<f64>; 3]) -> f64 {
        let mut error = self.square;
        for (c, coefficients) in coefficients.iter().enumerate() {
            for (a, w) in indices.iter().zip(coefficients) {
                let image: f64 = indices
                    .iter()
                    .zip(coefficients)
                    .map(|(b, w)| self.gram[*a][*b] * w)
                    .sum();
                error += w * (image - 2.0 * self.cross[*a][c]);
            }
        }
        error
    }
}
