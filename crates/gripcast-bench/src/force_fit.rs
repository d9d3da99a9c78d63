//! Fit of the force model by non-negative least squares.

use std::collections::BTreeMap;

use gripcast_base::error::{Error, Result};
use gripcast_base::linear::Symmetric;
use gripcast_tactile::force::{ForceSpread, ForceTerm, NormalForce, ShearTerm};

use crate::force_samples::Sample;

/// Force from which a residual counts relative to the force, in units of E h²: about 0.6 N on a gel
/// of 0.6 MPa.
const SMALL: f64 = 0.06;
/// Force below which residuals give the floor of the spread.
const FLOOR_BELOW: f64 = 0.05;
/// Regularisation of the columns, which are nearly dependent.
const RIDGE: f64 = 1e-9;
/// Minimum correlation of a column with the residual for it to be used.
const MIN_GAIN: f64 = 1e-6;
/// Maximum number of exchanges of columns.
const MAX_EXCHANGES: usize = 400;
/// Maximum sum of a product's exponents.
const MAX_DEGREE: f64 = 2.5;

/// Products of powers of which the fit chooses.
fn candidates() -> Vec<ForceTerm> {
    let half_steps = [0.0, 0.5, 1.0];
    let mut terms = Vec::new();
    for volume in half_steps {
        for square in [0.0, 0.5] {
            for slope in [0.0, 0.5, 1.0, 1.5] {
                for bending in [0.0, 0.5] {
                    for deep_area in half_steps {
                        let degree = volume + square + slope + bending + deep_area;
                        if degree == 0.0 || degree > MAX_DEGREE {
                            continue;
                        }
                        terms.extend(half_steps.map(|constrained| ForceTerm {
                            weight: 0.0,
                            exponents: [volume, square, 0.0, slope, bending, 0.0, deep_area, 0.0],
                            constrained,
                        }));
                    }
                }
            }
        }
    }
    terms
}

/// Fits the normal force to samples.
///
/// # Errors
/// `Internal` if no product explains the forces.
pub(crate) fn fit_normal(samples: &[&Sample]) -> Result<NormalForce> {
    let terms = candidates();
    let weight = |sample: &Sample| 1.0 / (sample.normal + SMALL);
    let rows: Vec<Vec<f64>> = samples
        .iter()
        .map(|s| {
            terms
                .iter()
                .map(|t| weight(s) * t.product(&s.features, s.poisson))
                .collect()
        })
        .collect();
    let values: Vec<f64> = samples.iter().map(|s| weight(s) * s.normal).collect();
    let weights = non_negative(&rows, &values)?;
    let chosen = terms
        .into_iter()
        .zip(weights)
        .filter(|(_, weight)| *weight > 0.0);
    Ok(NormalForce {
        spread: ForceSpread {
            fraction: 0.0,
            floor: 0.0,
        },
        terms: chosen
            .map(|(term, weight)| ForceTerm { weight, ..term })
            .collect(),
    })
}

/// Non-negative least squares by active sets (Lawson and Hanson 1974).
fn non_negative(rows: &[Vec<f64>], values: &[f64]) -> Result<Vec<f64>> {
    let count = rows.first().map_or(0, Vec::len);
    let scales: Vec<f64> = (0..count)
        .map(|k| rows.iter().map(|row| row[k] * row[k]).sum::<f64>().sqrt())
        .map(|scale| scale.max(f64::MIN_POSITIVE))
        .collect();
    let product = |a: usize, b: usize| {
        let sum: f64 = rows.iter().map(|row| row[a] * row[b]).sum();
        sum / (scales[a] * scales[b]) + if a == b { RIDGE } else { 0.0 }
    };
    let target: Vec<f64> = (0..count)
        .map(|k| {
            let sum: f64 = rows
                .iter()
                .zip(values)
                .map(|(row, value)| row[k] * value)
                .sum();
            sum / scales[k]
        })
        .collect();
    // Rows of the Gram matrix of the columns that were in use.
    let mut gram: BTreeMap<usize, Vec<f64>> = BTreeMap::new();
    let mut active: Vec<usize> = Vec::new();
    let mut weights = vec![0.0; count];
    for _ in 0..MAX_EXCHANGES {
        let gain = |k: usize| {
            let explained: f64 = active.iter().map(|a| gram[a][k] * weights[*a]).sum();
            target[k] - explained
        };
        let best = (0..count)
            .filter(|k| !active.contains(k))
            .map(|k| (gain(k), k));
        let Some((gain, next)) = best.max_by(|a, b| a.0.total_cmp(&b.0)) else {
            break;
        };
        if gain <= MIN_GAIN {
            break;
        }
        gram.entry(next)
            .or_insert_with(|| (0..count).map(|k| product(next, k)).collect());
        active.push(next);
        loop {
            let solved = solve(&active, &gram, &target)?;
            let step = active
                .iter()
                .zip(&solved)
                .filter(|(_, solved)| **solved <= 0.0)
                .map(|(k, solved)| weights[*k] / (weights[*k] - solved))
                .filter(|step| step.is_finite())
                .reduce(f64::min);
            let Some(step) = step else {
                for (k, solved) in active.iter().zip(&solved) {
                    weights[*k] = *solved;
                }
                break;
            };
            for (k, solved) in active.iter().zip(&solved) {
                weights[*k] += step * (solved - weights[*k]);
            }
            active.retain(|k| weights[*k] > 1e-12);
            (0..count)
                .filter(|k| !active.contains(k))
                .for_each(|k| weights[k] = 0.0);
            if active.is_empty() {
                break;
            }
        }
    }
    if active.is_empty() {
        return Err(Error::internal(
            "no product of features explains the forces",
        ));
    }
    Ok(weights
        .iter()
        .zip(&scales)
        .map(|(weight, scale)| weight / scale)
        .collect())
}

/// Least squares of the active columns.
fn solve(active: &[usize], gram: &BTreeMap<usize, Vec<f64>>, target: &[f64]) -> Result<Vec<f64>> {
    let mut system = Symmetric::zero(active.len());
    for (i, a) in active.iter().enumerate() {
        for (j, b) in active.iter().enumerate().take(i + 1) {
            system.add(i, j, gram[a][*b]);
        }
    }
    let right: Vec<f64> = active.iter().map(|k| target[*k]).collect();
    let factor = system.factor();
    let factor = factor.ok_or_else(|| Error::internal("the products of features are dependent"))?;
    Ok(factor.solve(&right))
}

/// Residuals of estimates, pairs of estimate and truth.
pub(crate) fn spread(pairs: &[[f64; 2]]) -> ForceSpread {
    let rms =
        |squares: Vec<f64>| (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt();
    let (small, large): (Vec<&[f64; 2]>, Vec<&[f64; 2]>) =
        pairs.iter().partition(|[_, truth]| *truth < FLOOR_BELOW);
    ForceSpread {
        fraction: rms(large.iter().map(|[e, t]| (e / t - 1.0).powi(2)).collect()),
        floor: rms(small.iter().map(|[e, t]| (e - t).powi(2)).collect()),
    }
}

/// Fits a shear force to pairs of motion, in units of the model, and force.
pub(crate) fn fit_shear(pairs: &[[f64; 2]]) -> ShearTerm {
    let own: f64 = pairs.iter().map(|[motion, _]| motion * motion).sum();
    let both: f64 = pairs.iter().map(|[motion, force]| motion * force).sum();
    ShearTerm {
        weight: both / own.max(f64::MIN_POSITIVE),
        spread: ForceSpread {
            fraction: 0.0,
            floor: 0.0,
        },
    }
}
