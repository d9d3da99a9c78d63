//! Sums of squares of a press, from which any polynomial shading is fitted and scored.

use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, Par};

use super::press_set::{LabelledPress, PressSet};
use super::score::{ChangePlanes, Distance, in_patch};
use crate::normals::Normals;
use crate::shading::{
    NORMAL_TERMS, NormalOrder, POSITION_TERMS, PositionOrder, normal_terms, normalised_place,
    position_terms,
};
use crate::{Smoother, Smoothing};

/// Pixels up to this distance from the border of a contact are fitted.
const FIT_PX: f64 = 50.0;
/// Every so many pixels along both axes are taken.
const STRIDE: usize = 2;
/// Terms of the largest shading.
const TERMS: usize = NORMAL_TERMS * POSITION_TERMS;

/// Sums over pixels: terms × terms, terms × change, change².
#[derive(Clone, Debug)]
pub(super) struct SquareSums {
    pub(super) gram: Mat<f64>,
    pub(super) cross: Mat<f64>,
    pub(super) square: f64,
    pub(super) count: f64,
}

/// Sums of one press.
#[derive(Clone, Debug)]
pub(super) struct PressSums {
    /// Where shading is fitted.
    pub(super) fit: SquareSums,
    /// Where it is scored.
    pub(super) patch: SquareSums,
    /// Sine of the steepest tilt in the press.
    pub(super) steepest: f64,
}

/// Places of the terms of a smaller shading among those of the largest.
pub(super) fn term_places(normal: NormalOrder, position: PositionOrder) -> Vec<usize> {
    (0..normal.terms())
        .flat_map(|k| (0..position.terms()).map(move |p| k * POSITION_TERMS + p))
        .collect()
}

/// Normals of a labelled contact under a shape of the gel.
pub(super) fn normals_of(set: &PressSet, press: &LabelledPress, smoothing: &Smoothing) -> Normals {
    let depth = set.contact(press).press(smoothing.sink_length_m);
    let mut normals = Normals::default();
    let mut smoother = Smoother::new(smoothing, set.geometry.pixel_m);
    normals.take(smoother.smooth(&depth), &set.geometry);
    normals
}

impl PressSums {
    /// Sums of a press whose change was observed.
    pub(super) fn take(
        set: &PressSet,
        press: &LabelledPress,
        change: &ChangePlanes,
        smoothing: &Smoothing,
    ) -> Self {
        let normals = normals_of(set, press, smoothing);
        let distance = Distance::of(press);
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
    fn over(set: &PressSet, pixels: &[usize], normals: &Normals, change: &ChangePlanes) -> Self {
        let width = set.geometry.width;
        let mut terms = Mat::<f64>::zeros(pixels.len(), TERMS);
        for (row, i) in pixels.iter().enumerate() {
            let t = normal_terms(normals.x[*i], normals.y[*i], normals.z_less_1[*i]);
            let [x, y] = normalised_place(&set.geometry, i % width, i / width);
            let q = position_terms(x, y);
            for (k, t) in t.iter().enumerate() {
                for (p, q) in q.iter().enumerate() {
                    terms[(row, k * POSITION_TERMS + p)] = f64::from(t * q);
                }
            }
        }
        let values = Mat::from_fn(pixels.len(), 3, |row, c| f64::from(change[c][pixels[row]]));
        let mut sums = Self {
            gram: Mat::zeros(TERMS, TERMS),
            cross: Mat::zeros(TERMS, 3),
            square: values.norm_l2().powi(2),
            count: pixels.len() as f64,
        };
        let turned = terms.transpose();
        matmul(
            &mut sums.gram,
            Accum::Replace,
            turned,
            &terms,
            1.0,
            Par::Seq,
        );
        matmul(
            &mut sums.cross,
            Accum::Replace,
            turned,
            &values,
            1.0,
            Par::Seq,
        );
        sums
    }

    /// Sums of several presses, in their order.
    pub(super) fn total<'a>(parts: impl Iterator<Item = &'a Self>) -> Self {
        let mut total = Self {
            gram: Mat::zeros(TERMS, TERMS),
            cross: Mat::zeros(TERMS, 3),
            square: 0.0,
            count: 0.0,
        };
        for part in parts {
            total.gram += &part.gram;
            total.cross += &part.cross;
            total.square += part.square;
            total.count += part.count;
        }
        total
    }

    /// Squared error that coefficients of the terms at `places` leave.
    pub(super) fn error(&self, places: &[usize], coefficients: &Mat<f64>) -> f64 {
        let mut error = self.square;
        for c in 0..3 {
            for (i, a) in places.iter().enumerate() {
                let w = coefficients[(i, c)];
                let image: f64 = places
                    .iter()
                    .enumerate()
                    .map(|(j, b)| self.gram[(*a, *b)] * coefficients[(j, c)])
                    .sum();
                error += w * (image - 2.0 * self.cross[(*a, c)]);
            }
        }
        error
    }
}
