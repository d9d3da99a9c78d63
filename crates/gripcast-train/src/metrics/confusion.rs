//! Confusion matrix at a threshold and metrics derived from it.

use serde::{Deserialize, Serialize};

use super::{Scored, present};

/// Confusion matrix; stable is the positive class.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ConfusionMatrix {
    /// Stable samples predicted stable (true positives).
    pub true_stable: usize,
    /// Slip samples predicted stable (false positives).
    pub false_stable: usize,
    /// Slip samples predicted slip (true negatives).
    pub true_slip: usize,
    /// Stable samples predicted slip (false negatives).
    pub false_slip: usize,
}

/// Metrics of one class; none where undefined.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClassMetrics {
    /// Fraction of the predictions of this class that are correct.
    pub precision: Option<f64>,
    /// Fraction of the samples of this class that are predicted as it.
    pub recall: Option<f64>,
    /// Fraction of the samples of the other class that are predicted as the other.
    pub specificity: Option<f64>,
}

impl ConfusionMatrix {
    /// Counts the samples; a probability of at least `threshold` is predicted stable.
    pub fn at(samples: &[Scored], threshold: f64) -> Self {
        let mut matrix = Self::default();
        for sample in present(samples) {
            *match (sample.p_stable >= threshold, sample.stable) {
                (true, true) => &mut matrix.true_stable,
                (true, false) => &mut matrix.false_stable,
                (false, false) => &mut matrix.true_slip,
                (false, true) => &mut matrix.false_slip,
            } += 1;
        }
        matrix
    }

    /// Number of samples.
    pub fn n(&self) -> usize {
        self.n_stable() + self.n_slip()
    }

    /// Number of stable samples.
    pub fn n_stable(&self) -> usize {
        self.true_stable + self.false_slip
    }

    /// Number of slip samples.
    pub fn n_slip(&self) -> usize {
        self.true_slip + self.false_stable
    }

    /// Accuracy. None without samples.
    pub fn accuracy(&self) -> Option<f64> {
        fraction(self.true_stable + self.true_slip, self.n())
    }

    /// Balanced accuracy: mean recall of the classes. None with one class only.
    pub fn balanced_accuracy(&self) -> Option<f64> {
        Some(0.5 * (self.stable().recall? + self.slip().recall?))
    }

    /// False positive rate: fraction of the slip samples predicted stable. None without a slip
    /// sample.
    pub fn false_stable_rate(&self) -> Option<f64> {
        fraction(self.false_stable, self.n_slip())
    }

    /// Metrics of the stable class.
    pub fn stable(&self) -> ClassMetrics {
        ClassMetrics {
            precision: fraction(self.true_stable, self.true_stable + self.false_stable),
            recall: fraction(self.true_stable, self.n_stable()),
            specificity: fraction(self.true_slip, self.n_slip()),
        }
    }

    /// Metrics of the slip class.
    pub fn slip(&self) -> ClassMetrics {
        ClassMetrics {
            precision: fraction(self.true_slip, self.true_slip + self.false_slip),
            recall: fraction(self.true_slip, self.n_slip()),
            specificity: fraction(self.true_stable, self.n_stable()),
        }
    }
}

fn fraction(part: usize, whole: usize) -> Option<f64> {
    (whole > 0).then(|| part as f64 / whole as f64)
}

#[cfg(test)]
mod tests {
    use super::super::reference_test::scored;
    use super::*;

    #[test]
    fn prediction_at_threshold_is_stable() {
        let samples = scored(&[(0.6, true), (0.6, false), (0.59, true), (0.1, false)]);
        let matrix = ConfusionMatrix::at(&samples, 0.6);
        let expected = ConfusionMatrix {
            true_stable: 1,
            false_stable: 1,
            true_slip: 1,
            false_slip: 1,
        };
        assert_eq!(matrix, expected);
        assert_eq!(matrix.false_stable_rate(), Some(0.5));
    }

    #[test]
    fn class_metrics_follow_from_matrix() {
        let matrix = ConfusionMatrix {
            true_stable: 6,
            false_stable: 2,
            true_slip: 8,
            false_slip: 4,
        };
        assert_eq!((matrix.n_stable(), matrix.n_slip()), (10, 10));
        let stable = matrix.stable();
        assert_eq!(stable.precision, Some(0.75));
        assert_eq!(stable.recall, Some(0.6));
        assert_eq!(stable.specificity, Some(0.8));
        let slip = matrix.slip();
        assert_eq!(slip.precision, Some(8.0 / 12.0));
        assert_eq!(slip.recall, Some(0.8));
        assert_eq!(slip.specificity, Some(0.6));
        assert_eq!(matrix.accuracy(), Some(0.7));
    }

    #[test]
    fn undefined_metrics_are_none() {
        let nothing = ConfusionMatrix::at(&[], 0.5);
        assert_eq!(nothing.accuracy(), None);
        let stable = ConfusionMatrix::at(&scored(&[(0.9, true), (0.2, true)]), 0.5);
        assert_eq!(stable.accuracy(), Some(0.5));
        assert_eq!(stable.balanced_accuracy(), None);
        assert_eq!(stable.false_stable_rate(), None);
        assert_eq!(stable.slip().recall, None);
        assert_eq!(stable.slip().precision, Some(0.0));
    }

    #[test]
    fn nan_prediction_is_not_counted() {
        let samples = scored(&[(f64::NAN, false), (0.7, true)]);
        assert_eq!(ConfusionMatrix::at(&samples, 0.5).n(), 1);
    }
}
