//! Trains the prediction before the lift from what the network reads.

use super::boosting::{BoostingSettings, boosted_trees};
use super::logistic::logistic_regression;
use super::validate::SplitLogits;
use gripcast_nn::predict::contract::{Modality, OutputSpec};
use gripcast_nn::predict::{GraspEstimator, GraspHead};

/// Minimum samples of each label to train trees on.
const MIN_TRAINED: usize = 100;
/// Minimum samples of each label to combine trees and network on.
const MIN_COMBINED: usize = 20;

/// Trains the estimators of all inputs with touch on the training split and combines each with the
/// network on the validation split. Those that do not help there are left out.
pub(super) fn fit(
    outputs: &[OutputSpec],
    train: &SplitLogits,
    validation: &SplitLogits,
    seed: u64,
) -> GraspHead {
    let estimator = |output: &OutputSpec| {
        let rows = rows(output.modality, train)?;
        if !has_both_labels(&rows, MIN_TRAINED) {
            return None;
        }
        let features: Vec<&[f64]> = rows.iter().map(|(x, _)| &x[..]).collect();
        let labels: Vec<bool> = rows.iter().map(|(_, label)| *label).collect();
        let weights = vec![1.0; rows.len()];
        let estimator = GraspEstimator {
            modality: output.modality,
            trees: boosted_trees(
                &features,
                &labels,
                &weights,
                &BoostingSettings::DEFAULT,
                seed,
            )?,
            network_weight: 0.0,
            trees_weight: 1.0,
            offset: 0.0,
        };
        combine(&estimator, output, validation)
    };
    GraspHead {
        estimators: outputs.iter().filter_map(estimator).collect(),
    }
}

/// The estimators of a start model, combined with the network where there are enough samples.
pub(super) fn refit(
    head: &GraspHead,
    outputs: &[OutputSpec],
    validation: &SplitLogits,
) -> GraspHead {
    let estimators = head.estimators.iter().map(|estimator| {
        let mut outputs = outputs.iter();
        let output = outputs.find(|output| output.modality == estimator.modality);
        let combined = output.and_then(|output| combine(estimator, output, validation));
        combined.unwrap_or_else(|| estimator.clone())
    });
    GraspHead {
        estimators: estimators.collect(),
    }
}

/// Features and labels of the samples that have these inputs; none if the network does not read
/// contact maps from them.
fn rows(inputs: Modality, found: &SplitLogits) -> Option<Vec<(Vec<f64>, bool)>> {
    let logits = found.all_of(inputs);
    let readings = found.readings_of(inputs)?.into_iter();
    let rows = readings.map(|(sample, features)| (features, logits[sample].is_stable));
    Some(rows.collect())
}

fn has_both_labels(rows: &[(Vec<f64>, bool)], minimum: usize) -> bool {
    let stable = rows.iter().filter(|(_, is_stable)| *is_stable).count();
    stable.min(rows.len() - stable) >= minimum
}

/// Fits the weights of the log-odds of network and trees; none with too few samples, or where the
/// trees do not help.
fn combine(
    estimator: &GraspEstimator,
    output: &OutputSpec,
    validation: &SplitLogits,
) -> Option<GraspEstimator> {
    let logits = validation.all_of(output.modality);
    let readings = validation.readings_of(output.modality)?.into_iter();
    let rows = readings.map(|(sample, features)| {
        let network = logits[sample].logit / output.temperature;
        let row = vec![network, estimator.trees.score(&features)];
        (row, logits[sample].is_stable)
    });
    let rows: Vec<(Vec<f64>, bool)> = rows.collect();
    if !has_both_labels(&rows, MIN_COMBINED) {
        return None;
    }
    let weights = logistic_regression(&rows)?;
    let [network, trees, offset] = weights[..] else {
        return None;
    };
    let combined = GraspEstimator {
        // A network that is more certain never makes a worse grasp.
        network_weight: network.max(0.0),
        trees_weight: trees,
        offset,
        ..estimator.clone()
    };
    (trees > 0.0).then_some(combined)
}

impl SplitLogits {
    /// Replaces the log-odds of the network by those of the head, in units of the temperature of
    /// each output.
    pub(super) fn set_grasp_head(&mut self, head: &GraspHead, outputs: &[OutputSpec]) {
        for output in outputs {
            let estimator = head.of(output.modality);
            let readings = estimator.and_then(|_| self.readings_of(output.modality));
            let (Some(estimator), Some(readings)) = (estimator, readings) else {
                continue;
            };
            for (sample, features) in readings {
                let trees = estimator.trees.score(&features);
                self.update(output.modality, sample, |logit| {
                    output.temperature * estimator.combined(logit / output.temperature, trees)
                });
            }
        }
    }
}
