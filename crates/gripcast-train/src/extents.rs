//! Fits the heads that read the extents of the object.

use std::ops::Range;

use super::logistic::logistic_regression;
use super::samples::Samples;
use super::validate::{Logit, Scores, SplitLogits};
use gripcast_nn::predict::contract::Modality;
use gripcast_nn::{EXTENT_UNITS, ExtentHead, Network};

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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logistic::tests::samples;
    use gripcast_base::random::SeedStream;

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
}
