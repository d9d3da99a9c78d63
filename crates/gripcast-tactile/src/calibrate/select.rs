//! Selects gel shape, shading terms and ridge by cross-validation on the presses to fit.

use rayon::prelude::*;
use serde::Serialize;

use super::press_set::PressSet;
use super::score::{ObservedChange, observe};
use super::sums::{PressSums, SquareSums, term_indices};
use crate::shading::normalised_position;
use crate::{NormalOrder, PolynomialShading, PositionOrder, Smoothing};
use gripcast_base::error::{Error, Result};
use gripcast_base::linear::Symmetric;

/// Candidate decay lengths, m.
const SINK_LENGTHS_M: [f64; 5] = [5e-4, 7e-4, 1e-3, 1.4e-3, 2e-3];
/// Candidate Gaussians, m.
const SIGMAS_M: [f64; 4] = [5e-5, 1e-4, 2e-4, 3e-4];
/// Gaussian while the length is selected, m.
const FIRST_SIGMA_M: f64 = 1e-4;
/// Candidate ridges, relative to the mean square of nx and ny.
const RIDGES: [f64; 7] = [1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1];
/// Maximum number of folds.
const MAX_FOLDS: usize = 7;
/// The simplest model within this FVE of the best is selected.
const FVE_TOLERANCE: f64 = 0.002;
/// Minimum standard deviation of the contact positions, relative to half the longer side, for
/// linear and quadratic position terms.
const MIN_SPREAD: [f64; 2] = [0.06, 0.1];

/// A selected shading model.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ChosenModel {
    /// Order in the normal.
    pub normal: NormalOrder,
    /// Order in the position.
    pub position: PositionOrder,
    /// Ridge penalty, relative to the mean square of nx and ny.
    pub ridge: f64,
    /// Gel shape.
    pub smoothing: Smoothing,
    /// Cross-validated fraction of variance explained.
    pub cv_fve: f64,
}

/// Orders of the shading; unset ones are selected.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Terms {
    /// Order in the normal; `None` = selected.
    pub normal: Option<NormalOrder>,
    /// Order in the position; `None` = selected among those that the contact positions can
    /// identify.
    pub position: Option<PositionOrder>,
}

/// Selects and fits a polynomial shading on some presses of a set.
///
/// # Errors
/// `Input` if there are fewer than two presses.
pub(super) fn choose(
    set: &PressSet,
    train: &[usize],
    terms: Terms,
) -> Result<(ChosenModel, PolynomialShading)> {
    if train.len() < 2 {
        let unusable = match &*set.skipped {
            [] => String::new(),
            [first, ..] => format!(
                "; {} unusable ({}: {})",
                set.skipped.len(),
                first.file,
                first.reason
            ),
        };
        return Err(Error::input(format!(
            "at least 2 presses are required to fit, found {}{unusable}",
            train.len()
        ))
        .remedy("take more presses, 5 or more spread over the pad, or fit more of them"));
    }
    let observed: Vec<ObservedChange> = train
        .par_iter()
        .map(|i| observe(set, &set.presses[*i]))
        .collect();
    let cross_validation = CrossValidation {
        set,
        train,
        observed,
        candidates: candidates(set, train, terms),
    };
    let mut best: Option<(ChosenModel, Vec<PressSums>)> = None;
    let mut try_smoothing = |sink_length_m: f64, sigma_m: f64| {
        let (model, sums) = cross_validation.evaluate(Smoothing {
            sink_length_m,
            sigma_m,
        });
        if best.as_ref().is_none_or(|b| model.cv_fve > b.0.cv_fve) {
            best = Some((model, sums));
        }
        best.as_ref()
            .map_or(sink_length_m, |b| b.0.smoothing.sink_length_m)
    };
    let mut length = 0.0;
    for candidate in SINK_LENGTHS_M {
        length = try_smoothing(candidate, FIRST_SIGMA_M);
    }
    for sigma in SIGMAS_M.into_iter().filter(|s| *s != FIRST_SIGMA_M) {
        try_smoothing(length, sigma);
    }
    let Some((model, sums)) = best else {
        return Err(Error::internal("no gel shape was evaluated"));
    };
    let indices = term_indices(model.normal, model.position);
    let all = SquareSums::total(sums.iter().map(|s| &s.fit));
    let solution = solve(&all, &indices, model.ridge)?;
    let [red, green, blue] = solution;
    let shading = PolynomialShading {
        normal: model.normal,
        position: model.position,
        steepest: sums
            .iter()
            .map(|s| s.steepest)
            .fold(0.0, f64::max)
            .clamp(0.05, 1.0),
        red,
        green,
        blue,
    };
    Ok((model, shading))
}

/// Candidate orders, fewest terms first.
fn candidates(set: &PressSet, train: &[usize], terms: Terms) -> Vec<(NormalOrder, PositionOrder)> {
    let max_position = max_position_order(set, train);
    let mut all: Vec<(NormalOrder, PositionOrder)> = NormalOrder::ALL
        .into_iter()
        .flat_map(|n| PositionOrder::ALL.into_iter().map(move |p| (n, p)))
        .filter(|(n, p)| {
            terms.normal.is_none_or(|wanted| wanted == *n)
                && match terms.position {
                    Some(wanted) => wanted == *p,
                    None => *p <= max_position,
                }
        })
        .collect();
    all.sort_by_key(|(n, p)| n.terms() * p.terms());
    all
}

/// Highest order in the position identifiable from the contact positions.
fn max_position_order(set: &PressSet, train: &[usize]) -> PositionOrder {
    let indices: Vec<[f32; 2]> = train
        .iter()
        .map(|i| {
            let [x, y] = set.presses[*i].centre_px;
            normalised_position(&set.geometry, x.max(0.0) as usize, y.max(0.0) as usize)
        })
        .collect();
    let spread = |axis: usize| {
        let count = indices.len() as f64;
        let mean = indices.iter().map(|p| f64::from(p[axis])).sum::<f64>() / count;
        let square = indices.iter().map(|p| (f64::from(p[axis]) - mean).powi(2));
        (square.sum::<f64>() / count).sqrt()
    };
    let min_spread = spread(0).min(spread(1));
    if min_spread >= MIN_SPREAD[1] {
        PositionOrder::Quadratic
    } else if min_spread >= MIN_SPREAD[0] {
        PositionOrder::Linear
    } else {
        PositionOrder::Constant
    }
}

struct CrossValidation<'a> {
    set: &'a PressSet,
    train: &'a [usize],
    observed: Vec<ObservedChange>,
    candidates: Vec<(NormalOrder, PositionOrder)>,
}

impl CrossValidation<'_> {
    /// Returns the best orders and ridge for a gel shape, and the sums of the presses.
    fn evaluate(&self, smoothing: Smoothing) -> (ChosenModel, Vec<PressSums>) {
        let sums: Vec<PressSums> = self
            .train
            .par_iter()
            .zip(&self.observed)
            .map(|(i, observed)| {
                PressSums::new(
                    self.set,
                    &self.set.presses[*i],
                    &observed.change,
                    &smoothing,
                )
            })
            .collect();
        let folds = sums.len().min(MAX_FOLDS);
        let without: Vec<SquareSums> = (0..folds)
            .map(|fold| {
                let others = sums.iter().enumerate().filter(|(i, _)| i % folds != fold);
                SquareSums::total(others.map(|(_, s)| &s.fit))
            })
            .collect();
        let trials: Vec<(NormalOrder, PositionOrder, f64)> = self
            .candidates
            .iter()
            .flat_map(|(n, p)| RIDGES.into_iter().rev().map(move |ridge| (*n, *p, ridge)))
            .collect();
        let scores: Vec<f64> = trials
            .par_iter()
            .map(|(n, p, ridge)| cross_validated(&sums, &without, &term_indices(*n, *p), *ridge))
            .collect();
        let best = scores.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let index = scores
            .iter()
            .position(|s| *s >= best - FVE_TOLERANCE)
            .unwrap_or(0);
        let (normal, position, ridge) = trials[index];
        let model = ChosenModel {
            normal,
            position,
            ridge,
            smoothing,
            cv_fve: scores[index],
        };
        (model, sums)
    }
}

/// Mean fraction of variance explained in the patches of left-out presses.
fn cross_validated(
    sums: &[PressSums],
    without: &[SquareSums],
    indices: &[usize],
    ridge: f64,
) -> f64 {
    let folds = without.len();
    let mut total = 0.0;
    for (fold, fitted) in without.iter().enumerate() {
        let Ok(solution) = solve(fitted, indices, ridge) else {
            return f64::NEG_INFINITY;
        };
        for press in sums.iter().skip(fold).step_by(folds) {
            total += 1.0 - press.patch.error(indices, &solution) / press.patch.square;
        }
    }
    total / sums.len() as f64
}

/// Ridge regression: (G + ρ τ I) w = b, with τ half the sum of the squares of nx and ny.
fn solve(sums: &SquareSums, indices: &[usize], ridge: f64) -> Result<[Vec<f64>; 3]> {
    // Terms 0 and [`NY`] are nx and ny at constant position.
    let scale = 0.5 * (sums.gram[indices[0]][indices[0]] + sums.gram[NY][NY]);
    let mut matrix = Symmetric::zero(indices.len());
    for (i, a) in indices.iter().enumerate() {
        for (j, b) in indices.iter().enumerate() {
            matrix.add(i, j, sums.gram[*a][*b]);
        }
        matrix.add(i, i, ridge * scale);
    }
    let factor = matrix.factor().ok_or_else(|| {
        Error::input("the presses do not determine the shading: none of them shows a slope")
    })?;
    Ok([0, 1, 2].map(|c| {
        let right: Vec<f64> = indices.iter().map(|index| sums.cross[*index][c]).collect();
        factor.solve(&right)
    }))
}

/// Index of ny among all terms.
const NY: usize = crate::shading::POSITION_TERMS;
