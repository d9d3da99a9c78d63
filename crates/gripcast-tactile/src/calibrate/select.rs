//! Chooses shape of the gel, terms and ridge by cross-validation inside the presses to fit.

use rayon::prelude::*;
use serde::Serialize;

use super::press_set::PressSet;
use super::score::{ObservedChange, observe};
use super::sums::{PressSums, SquareSums, term_indices};
use crate::shading::normalised_position;
use crate::{NormalOrder, PolynomialShading, PositionOrder, Smoothing};
use gripcast_base::error::{Error, Result};
use gripcast_base::linear::Symmetric;

/// Lengths over which the gel comes up around a contact that are tried, m.
const SINK_LENGTHS_M: [f64; 5] = [5e-4, 7e-4, 1e-3, 1.4e-3, 2e-3];
/// Gaussians that are tried, m.
const SIGMAS_M: [f64; 4] = [5e-5, 1e-4, 2e-4, 3e-4];
/// The Gaussian while the length is chosen, m.
const FIRST_SIGMA_M: f64 = 1e-4;
/// Ridges that are tried, of the mean square of nx and ny.
const RIDGES: [f64; 7] = [1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1];
/// Most folds of the cross-validation.
const MAX_FOLDS: usize = 7;
/// The model with fewest terms within this distance of the best is taken.
const FVE_TOLERANCE: f64 = 0.002;
/// Standard deviation of the contacts' places, of half the longer side, from which terms of the
/// place can be told apart: linear, quadratic.
const MIN_SPREAD: [f64; 2] = [0.06, 0.1];

/// A shading model and how it was chosen.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ChosenModel {
    /// Powers of the normal.
    pub normal: NormalOrder,
    /// Powers of the place.
    pub position: PositionOrder,
    /// Penalty on squared coefficients, of the mean square of nx and ny.
    pub ridge: f64,
    /// Shape of the gel.
    pub smoothing: Smoothing,
    /// Fraction of variance explained in the cross-validation.
    pub cv_fve: f64,
}

/// Limits of a choice.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Terms {
    /// Powers of the normal; none = chosen.
    pub normal: Option<NormalOrder>,
    /// Powers of the place; none = chosen among those that the presses' places can tell apart.
    pub position: Option<PositionOrder>,
}

/// Chooses and fits a polynomial shading on presses of a set, by index.
///
/// # Errors
/// `Input` if there are fewer than two presses to fit.
pub(super) fn choose(
    set: &PressSet,
    train: &[usize],
    terms: Terms,
) -> Result<(ChosenModel, PolynomialShading)> {
    if train.len() < 2 {
        return Err(Error::input(format!(
            "at least 2 presses are needed to fit, found {}",
            train.len()
        ))
        .remedy("take more presses, 5 or more all over the pad, or fit a larger fraction"));
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
        return Err(Error::internal("no shape of the gel was tried"));
    };
    let places = term_indices(model.normal, model.position);
    let all = SquareSums::total(sums.iter().map(|s| &s.fit));
    let solution = solve(&all, &places, model.ridge)?;
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

/// Terms to try, few before many.
fn candidates(set: &PressSet, train: &[usize], terms: Terms) -> Vec<(NormalOrder, PositionOrder)> {
    let highest = max_position_order(set, train);
    let mut all: Vec<(NormalOrder, PositionOrder)> = NormalOrder::ALL
        .into_iter()
        .flat_map(|n| PositionOrder::ALL.into_iter().map(move |p| (n, p)))
        .filter(|(n, p)| {
            terms.normal.is_none_or(|wanted| wanted == *n)
                && match terms.position {
                    Some(wanted) => wanted == *p,
                    None => *p <= highest,
                }
        })
        .collect();
    all.sort_by_key(|(n, p)| n.terms() * p.terms());
    all
}

/// Highest power of the place that the contacts are spread enough for.
fn max_position_order(set: &PressSet, train: &[usize]) -> PositionOrder {
    let places: Vec<[f32; 2]> = train
        .iter()
        .map(|i| {
            let [x, y] = set.presses[*i].centre_px;
            normalised_position(&set.geometry, x.max(0.0) as usize, y.max(0.0) as usize)
        })
        .collect();
    let spread = |axis: usize| {
        let count = places.len() as f64;
        let mean = places.iter().map(|p| f64::from(p[axis])).sum::<f64>() / count;
        let square = places.iter().map(|p| (f64::from(p[axis]) - mean).powi(2));
        (square.sum::<f64>() / count).sqrt()
    };
    let least = spread(0).min(spread(1));
    if least >= MIN_SPREAD[1] {
        PositionOrder::Quadratic
    } else if least >= MIN_SPREAD[0] {
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
    /// Best terms and ridge for a shape of the gel, and the sums of the presses.
    fn evaluate(&self, smoothing: Smoothing) -> (ChosenModel, Vec<PressSums>) {
        let sums: Vec<PressSums> = self
            .train
            .par_iter()
            .zip(&self.observed)
            .map(|(i, seen)| {
                PressSums::new(self.set, &self.set.presses[*i], &seen.change, &smoothing)
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
        let place = scores
            .iter()
            .position(|s| *s >= best - FVE_TOLERANCE)
            .unwrap_or(0);
        let (normal, position, ridge) = trials[place];
        let model = ChosenModel {
            normal,
            position,
            ridge,
            smoothing,
            cv_fve: scores[place],
        };
        (model, sums)
    }
}

/// Mean fraction of variance explained in the patches of presses left out of the fit.
fn cross_validated(
    sums: &[PressSums],
    without: &[SquareSums],
    places: &[usize],
    ridge: f64,
) -> f64 {
    let folds = without.len();
    let mut total = 0.0;
    for (fold, fitted) in without.iter().enumerate() {
        let Ok(solution) = solve(fitted, places, ridge) else {
            return f64::NEG_INFINITY;
        };
        for press in sums.iter().skip(fold).step_by(folds) {
            total += 1.0 - press.patch.error(places, &solution) / press.patch.square;
        }
    }
    total / sums.len() as f64
}

/// Ridge regression: (G + ρ τ I) w = b, τ the sum of the squares of nx and ny halved.
fn solve(sums: &SquareSums, places: &[usize], ridge: f64) -> Result<[Vec<f64>; 3]> {
    // Terms 0 and POSITION_TERMS of the largest shading are nx and ny at constant place.
    let scale = 0.5 * (sums.gram[places[0]][places[0]] + sums.gram[NY][NY]);
    let mut matrix = Symmetric::zero(places.len());
    for (i, a) in places.iter().enumerate() {
        for (j, b) in places.iter().enumerate() {
            matrix.add(i, j, sums.gram[*a][*b]);
        }
        matrix.add(i, i, ridge * scale);
    }
    let factor = matrix.factor().ok_or_else(|| {
        Error::input("the presses do not determine the shading: no slope is seen in any of them")
    })?;
    Ok([0, 1, 2].map(|c| {
        let right: Vec<f64> = places.iter().map(|place| sums.cross[*place][c]).collect();
        factor.solve(&right)
    }))
}

/// Place of ny among the terms of the largest shading.
const NY: usize = crate::shading::POSITION_TERMS;
