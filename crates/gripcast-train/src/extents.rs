//! Fits the heads that read the extents of the object.

use std::ops::Range;

use super::samples::Samples;
use super::validate::{Logit, Scores, SplitLogits};
use gripcast_base::linear::Symmetric;
use gripcast_nn::predict::contract::Modality;
use gripcast_nn::{EXTENT_UNITS, ExtentHead, Network};

/// Ridge penalty of a weight in units of its feature's standard deviation, relative to the loss of
/// one sample.
const RIDGE: f64 = 3.0;
/// Maximum Newton steps.
const STEPS: usize = 30;
/// Newton decrement below which the fit has converged.
const CONVERGED: f64 = 1e-9;

/// What a network finds on a split.
#[derive(Clone, Copy)]
pub(super) struct Found<'a> {
    pub(super) samples: &'a Samples,
    pub(super) logits: &'a SplitLogits,
}

/// Fits these heads by logistic regression on the training split, both labels with the same weight.
/// A head without samples of both labels keeps the touch head's log-odds. One of both camera images
/// reads the extents of the depth image alone where its loss on the validation split is lower so.
/// Returns the heads, which the network has then.
pub(super) fn fit_extent_heads(
    network: &mut Network,
    train: Found<'_>,
    validation: Found<'_>,
) -> Vec<(Modality, ExtentHead)> {
    let fitted = network.extent_heads().into_iter().map(|inputs| {
        let weights = fit(inputs, train, validation);
        let head = weights.and_then(|weights| head_of(inputs, &weights));
        let head = head.unwrap_or_else(|| ExtentHead {
            touch: 1.0,
            units: vec![0.0; cameras(inputs) * EXTENT_UNITS],
            bias: 0.0,
        });
        (inputs, head)
    });
    let heads: Vec<(Modality, ExtentHead)> = fitted.collect();
    for (inputs, head) in &heads {
        network.set_extent_head(*inputs, head);
    }
    heads
}

/// Number of camera images.
fn cameras(inputs: Modality) -> usize {
    inputs.cameras().map_or(0, |cameras| cameras.inputs().len())
}

/// Features and labels of the samples that have these inputs: the touch head's log-odds, then the
/// extent units of each camera image.
fn features(inputs: Modality, found: Found<'_>) -> Option<Vec<(Vec<f64>, bool)>> {
    let touch = inputs.has_touch().then(|| found.logits.all_of(Modality::T));
    let rows = found.logits.units_of(inputs)?.into_iter();
    let rows = rows.map(|(sample, units)| {
        let logit = touch.and_then(|touch: &[Logit]| touch.get(sample));
        let features = logit.map(|x| x.logit).into_iter().chain(units);
        let is_stable = found.samples.facts()[sample].is_stable;
        (features.collect(), is_stable)
    });
    Some(rows.collect())
}

fn fit(inputs: Modality, train: Found<'_>, validation: Found<'_>) -> Option<Vec<f64>> {
    let rows = features(inputs, train)?;
    if !(inputs.has_vision() && inputs.has_depth()) {
        return logistic_regression(&rows);
    }
    // The colour image is the first camera input.
    let first = usize::from(inputs.has_touch());
    let colour = first..first + EXTENT_UNITS;
    let held_out = features(inputs, validation).unwrap_or_default();
    with_or_without(colour, rows, &held_out)
}

/// Weights of a regression on all features, or on those without a range where these have the lower
/// loss on held-out samples; the range has the weight 0 then.
fn with_or_without(
    range: Range<usize>,
    rows: Vec<(Vec<f64>, bool)>,
    held_out: &[(Vec<f64>, bool)],
) -> Option<Vec<f64>> {
    let all = logistic_regression(&rows)?;
    let mut fewer = rows;
    for (features, _) in &mut fewer {
        // A feature that is constant gets no weight.
        features[range.clone()].fill(0.0);
    }
    let fewer = logistic_regression(&fewer)?;
    Some(if loss(&fewer, held_out) < loss(&all, held_out) {
        fewer
    } else {
        all
    })
}

/// Loss of weights, both labels with the same weight; NaN without samples of both.
fn loss(weights: &[f64], samples: &[(Vec<f64>, bool)]) -> f64 {
    let logits = samples.iter().map(|(features, is_stable)| {
        let terms = features.iter().chain(&[1.0]).zip(weights);
        Logit {
            logit: terms.map(|(x, w)| x * w).sum(),
            is_stable: *is_stable,
        }
    });
    Scores::new(&logits.collect::<Vec<_>>()).loss
}

fn head_of(inputs: Modality, weights: &[f64]) -> Option<ExtentHead> {
    let (bias, weights) = weights.split_last()?;
    let (touch, units) = match inputs.has_touch() {
        true => weights.split_first()?,
        false => (&0.0, weights),
    };
    Some(ExtentHead {
        touch: *touch,
        units: units.to_vec(),
        bias: *bias,
    })
}

/// Weights of the features, then the bias, of a ridge logistic regression by Newton's method
/// (Hastie, Tibshirani and Friedman, *The Elements of Statistical Learning*, 4.4.1); none without
/// samples of both labels.
fn logistic_regression(samples: &[(Vec<f64>, bool)]) -> Option<Vec<f64>> {
    let count = samples.first()?.0.len();
    let n = samples.len() as f64;
    let stable = samples.iter().filter(|(_, stable)| *stable).count() as f64;
    if stable == 0.0 || stable == n {
        return None;
    }
    let mean: Vec<f64> = (0..count)
        .map(|i| samples.iter().map(|(x, _)| x[i]).sum::<f64>() / n)
        .collect();
    let std: Vec<f64> = (0..count)
        .map(|i| {
            let squares = samples.iter().map(|(x, _)| (x[i] - mean[i]).powi(2));
            (squares.sum::<f64>() / n).sqrt()
        })
        .collect();
    // A feature that is constant says nothing.
    let scaled = |x: &[f64]| -> Vec<f64> {
        let scaled = (0..count).map(|i| {
            if std[i] > 1e-9 {
                (x[i] - mean[i]) / std[i]
            } else {
                0.0
            }
        });
        scaled.chain([1.0]).collect()
    };
    let rows: Vec<(Vec<f64>, bool)> = samples.iter().map(|(x, y)| (scaled(x), *y)).collect();
    let mut weights = vec![0.0; count + 1];
    for _ in 0..STEPS {
        let mut hessian = Symmetric::zero(count + 1);
        let mut gradient = vec![0.0; count + 1];
        for i in 0..count {
            hessian.add(i, i, RIDGE);
            gradient[i] += RIDGE * weights[i];
        }
        // The bias is not penalised; this only keeps the system regular.
        hessian.add(count, count, 1e-9);
        for (x, is_stable) in &rows {
            let label = f64::from(u8::from(*is_stable));
            let weight = 0.5 * n / if *is_stable { stable } else { n - stable };
            let logit: f64 = x.iter().zip(&weights).map(|(x, w)| x * w).sum();
            let p = 1.0 / (1.0 + (-logit).exp());
            for (i, a) in x.iter().enumerate() {
                gradient[i] += weight * (p - label) * a;
                for (j, b) in x.iter().enumerate() {
                    hessian.add(i, j, weight * p * (1.0 - p) * a * b);
                }
            }
        }
        let step = hessian.factor()?.solve(&gradient);
        for (weight, step) in weights.iter_mut().zip(&step) {
            *weight -= step;
        }
        let decrement: f64 = step.iter().zip(&gradient).map(|(a, b)| a * b).sum();
        if decrement < CONVERGED {
            break;
        }
    }
    let mut bias = weights[count];
    for i in 0..count {
        weights[i] = if std[i] > 1e-9 {
            weights[i] / std[i]
        } else {
            0.0
        };
        bias -= weights[i] * mean[i];
    }
    weights[count] = bias;
    Some(weights)
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_base::random::SeedStream;

    /// Samples whose log-odds are 2·x0 − 1·x1 + 0.5; x2 is noise, x3 constant.
    fn samples(count: usize) -> Vec<(Vec<f64>, bool)> {
        let mut draw = SeedStream::named(4, "samples");
        let sample = |_| {
            let x: Vec<f64> = (0..3).map(|_| draw.between(-2.0, 2.0)).collect();
            let p = 1.0 / (1.0 + (-(2.0 * x[0] - x[1] + 0.5)).exp());
            let is_stable = draw.uniform() < p;
            (vec![x[0], x[1], x[2], 7.0], is_stable)
        };
        (0..count).map(sample).collect()
    }

    #[test]
    fn regression_finds_the_weights() {
        let weights = logistic_regression(&samples(20_000)).unwrap();
        for (found, expected) in weights.iter().zip([2.0, -1.0, 0.0, 0.0]) {
            assert!((found - expected).abs() < 0.1, "{weights:?}");
        }
    }

    #[test]
    fn both_labels_weigh_the_same() {
        let noise: Vec<(Vec<f64>, bool)> = samples(3000)
            .into_iter()
            .enumerate()
            .map(|(i, (x, _))| (x, i % 10 != 0))
            .collect();
        let weights = logistic_regression(&noise).unwrap();
        assert!(
            weights[4].abs() < 0.1,
            "as likely stable as slip: {weights:?}"
        );
    }

    #[test]
    fn features_that_do_not_help_held_out_samples_are_left_out() {
        let held_out = samples(2000);
        // Few samples and many features of noise, which these samples fit.
        let mut draw = SeedStream::named(5, "noise");
        let mut with_noise = |rows: &[(Vec<f64>, bool)]| -> Vec<(Vec<f64>, bool)> {
            let rows = rows.iter().map(|(x, label)| {
                let noise = (0..20).map(|_| draw.between(-1.0, 1.0));
                (x[..2].iter().copied().chain(noise).collect(), *label)
            });
            rows.collect()
        };
        let (rows, held_out) = (with_noise(&samples(80)), with_noise(&held_out));
        let chosen = with_or_without(2..22, rows.clone(), &held_out).unwrap();
        assert!(chosen[2..22].iter().all(|w| *w == 0.0), "{chosen:?}");
        assert!(loss(&chosen, &held_out) < loss(&logistic_regression(&rows).unwrap(), &held_out));
        // Without those that the labels follow it is worse.
        let chosen = with_or_without(0..2, rows.clone(), &held_out).unwrap();
        assert_eq!(Some(chosen), logistic_regression(&rows));
        // Nothing is known without held-out samples.
        let chosen = with_or_without(2..22, rows.clone(), &[]);
        assert_eq!(chosen, logistic_regression(&rows));
    }

    #[test]
    fn one_label_gives_no_weights() {
        let one: Vec<(Vec<f64>, bool)> = vec![(vec![1.0], true), (vec![2.0], true)];
        assert_eq!(logistic_regression(&one), None);
        assert_eq!(logistic_regression(&[]), None);
    }

    #[test]
    fn separable_labels_give_finite_weights() {
        let rows = (0..20).map(|i| (vec![f64::from(i)], i >= 10));
        let weights = logistic_regression(&rows.collect::<Vec<_>>()).unwrap();
        assert!(
            weights.iter().all(|w| w.is_finite()) && weights[0] > 0.1,
            "{weights:?}"
        );
    }
}
