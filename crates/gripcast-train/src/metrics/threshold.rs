//! Choice of the decision threshold. Choose it on validation data: metrics on the data it was
//! chosen on are biased.

use super::{Scored, present};
use crate::logistic::logistic_regression;

/// Probabilities nearer to 0 or 1 count as this near.
const LEAST: f64 = 1e-9;

/// Threshold at which both labels are equally likely where both are equally frequent: where a
/// logistic regression of the label on the predicted log-odds, both labels with the same weight,
/// crosses even odds (Platt, 1999). None with one class only.
///
/// It estimates the threshold of the best balanced accuracy from all samples. The best gap between
/// predictions (Youden, 1950) depends on the few samples around it: it varies two to three times as
/// much from one validation split to another, and its balanced accuracy is lower on other samples.
///
/// Predictions that do not rise with the label give a threshold above all of them.
pub fn even_odds_threshold(samples: &[Scored]) -> Option<f64> {
    let logit = |p: f64| {
        let p = p.clamp(LEAST, 1.0 - LEAST);
        (p / (1.0 - p)).ln()
    };
    let rows: Vec<(Vec<f64>, bool)> = present(samples)
        .map(|sample| (vec![logit(sample.p_stable)], sample.stable))
        .collect();
    let weights = logistic_regression(&rows)?;
    let crossing = -weights[1] / weights[0];
    if weights[0] > 0.0 && crossing.is_finite() {
        return Some(1.0 / (1.0 + (-crossing).exp()));
    }
    let highest = present(samples).map(|sample| sample.p_stable);
    highest.max_by(f64::total_cmp).map(f64::next_up)
}

#[cfg(test)]
mod tests {
    use gripcast_base::random::SeedStream;

    use super::super::reference_test::scored;
    use super::super::{ConfusionMatrix, Summary};
    use super::*;

    /// Predictions of a model whose log-odds are off by `offset`; `stable` of the labels are stable.
    fn samples(count: usize, seed: u64, offset: f64, stable: f64) -> Vec<Scored> {
        let mut draw = SeedStream::named(seed, "threshold");
        let sample = |_| {
            let is_stable = draw.uniform() < stable;
            let mean = if is_stable { 1.0 } else { -1.0 };
            let normal: f64 = (0..12).map(|_| draw.uniform()).sum::<f64>() - 6.0;
            let logit = 2.0 * (mean + normal) + offset;
            Scored {
                p_stable: 1.0 / (1.0 + (-logit).exp()),
                stable: is_stable,
            }
        };
        (0..count).map(sample).collect()
    }

    #[test]
    fn threshold_is_where_both_labels_are_equally_likely() {
        // Two normal distributions of the log-odds with equal spread cross in the middle.
        for (offset, stable) in [(0.0, 0.5), (1.5, 0.5), (-1.0, 0.8)] {
            let found = even_odds_threshold(&samples(20_000, 1, offset, stable)).unwrap();
            let logit = (found / (1.0 - found)).ln();
            assert!((logit - offset).abs() < 0.08, "{offset} {stable}: {logit}");
        }
    }

    #[test]
    fn few_validation_samples_suffice() {
        let test = samples(20_000, 2, 0.7, 0.7);
        let accuracy = |threshold: f64| Summary::new(&test, threshold).balanced_accuracy.unwrap();
        let best = accuracy(1.0 / (1.0 + (-0.7_f64).exp()));
        for seed in 3..13 {
            let threshold = even_odds_threshold(&samples(150, seed, 0.7, 0.7)).unwrap();
            assert!(accuracy(threshold) > best - 0.015, "{seed}");
        }
    }

    #[test]
    fn separable_labels_are_separated() {
        let samples = scored(&[(0.9, true), (0.8, true), (0.3, false), (0.1, false)]);
        let threshold = even_odds_threshold(&samples).unwrap();
        assert!((0.3..=0.8).contains(&threshold), "{threshold}");
    }

    #[test]
    fn misleading_predictions_are_all_slip() {
        for samples in [
            scored(&[(0.9, false), (0.1, true)]),
            scored(&[(0.5, false), (0.5, true)]),
            scored(&[(1.0, false), (0.0, true)]),
        ] {
            let threshold = even_odds_threshold(&samples).unwrap();
            let matrix = ConfusionMatrix::at(&samples, threshold);
            assert_eq!(matrix.true_stable + matrix.false_stable, 0, "{threshold}");
        }
    }

    #[test]
    fn single_class_has_no_threshold() {
        let stable = scored(&[(0.9, true), (f64::NAN, false)]);
        assert_eq!(even_odds_threshold(&stable), None);
        assert_eq!(even_odds_threshold(&[]), None);
    }
}
