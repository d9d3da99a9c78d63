//! Decisions at a threshold: the confusion matrix and what follows from it.

use serde::{Deserialize, Serialize};

use super::{Scored, present};

/// Counts of decisions by outcome.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ConfusionMatrix {
    /// Predicted stable and stable: true positives.
    pub true_stable: usize,
    /// Predicted stable but unstable: false positives.
    pub false_stable: usize,
    /// Predicted unstable and unstable: true negatives.
    pub true_unstable: usize,
    /// Predicted unstable but stable: false negatives.
    pub false_unstable: usize,
}

/// How well one class is found; none where nothing can be counted.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClassFigures {
    /// Fraction of the predictions of this class that are right.
    pub precision: Option<f64>,
    /// Fraction of the grasps of this class that are found.
    pub recall: Option<f64>,
    /// Fraction of the grasps of the other class that are told apart from this one.
    pub specificity: Option<f64>,
}

impl ConfusionMatrix {
    /// Counts the samples; a prediction of at least `threshold` is stable.
    pub fn at(samples: &[Scored], threshold: f64) -> Self {
        let mut matrix = Self::default();
        for sample in present(samples) {
            *match (sample.p_stable >= threshold, sample.stable) {
                (true, true) => &mut matrix.true_stable,
                (true, false) => &mut matrix.false_stable,
                (false, false) => &mut matrix.true_unstable,
                (false, true) => &mut matrix.false_unstable,
            } += 1;
        }
        matrix
    }

    /// All samples.
    pub fn n(&self) -> usize {
        self.n_stable() + self.n_unstable()
    }

    /// Samples that are stable.
    pub fn n_stable(&self) -> usize {
        self.true_stable + self.false_unstable
    }

    /// Samples that are unstable.
    pub fn n_unstable(&self) -> usize {
        self.true_unstable + self.false_stable
    }

    /// Fraction of right decisions. None without samples.
    pub fn accuracy(&self) -> Option<f64> {
        fraction(self.true_stable + self.true_unstable, self.n())
    }

    /// Mean recall of the two classes. None with one class only.
    pub fn balanced_accuracy(&self) -> Option<f64> {
        Some(0.5 * (self.stable().recall? + self.unstable().recall?))
    }

    /// Fraction of the unstable grasps that are predicted stable: the false positive rate. None
    /// without an unstable sample.
    pub fn false_stable_rate(&self) -> Option<f64> {
        fraction(self.false_stable, self.n_unstable())
    }

    /// How well stable grasps are found.
    pub fn stable(&self) -> ClassFigures {
        ClassFigures {
            precision: fraction(self.true_stable, self.true_stable + self.false_stable),
            recall: fraction(self.true_stable, self.n_stable()),
            specificity: fraction(self.true_unstable, self.n_unstable()),
        }
    }

    /// How well unstable grasps are found.
    pub fn unstable(&self) -> ClassFigures {
        ClassFigures {
            precision: fraction(self.true_unstable, self.true_unstable + self.false_unstable),
            recall: fraction(self.true_unstable, self.n_unstable()),
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
    fn a_prediction_at_the_threshold_is_stable() {
        let samples = scored(&[(0.6, true), (0.6, false), (0.59, true), (0.1, false)]);
        let matrix = ConfusionMatrix::at(&samples, 0.6);
        let expected = ConfusionMatrix {
            true_stable: 1,
            false_stable: 1,
            true_unstable: 1,
            false_unstable: 1,
        };
        assert_eq!(matrix, expected);
        assert_eq!(matrix.false_stable_rate(), Some(0.5));
    }

    #[test]
    fn each_class_has_its_own_figures() {
        let matrix = ConfusionMatrix {
            true_stable: 6,
            false_stable: 2,
            true_unstable: 8,
            false_unstable: 4,
        };
        assert_eq!((matrix.n_stable(), matrix.n_unstable()), (10, 10));
        let stable = matrix.stable();
        assert_eq!(stable.precision, Some(0.75));
        assert_eq!(stable.recall, Some(0.6));
        assert_eq!(stable.specificity, Some(0.8));
        let unstable = matrix.unstable();
        assert_eq!(unstable.precision, Some(8.0 / 12.0));
        assert_eq!(unstable.recall, Some(0.8));
        assert_eq!(unstable.specificity, Some(0.6));
        assert_eq!(matrix.accuracy(), Some(0.7));
    }

    #[test]
    fn what_is_undefined_is_none() {
        let nothing = ConfusionMatrix::at(&[], 0.5);
        assert_eq!(nothing.accuracy(), None);
        let stable = ConfusionMatrix::at(&scored(&[(0.9, true), (0.2, true)]), 0.5);
        assert_eq!(stable.accuracy(), Some(0.5));
        assert_eq!(stable.balanced_accuracy(), None);
        assert_eq!(stable.false_stable_rate(), None);
        assert_eq!(stable.unstable().recall, None);
        assert_eq!(stable.unstable().precision, Some(0.0));
    }

    #[test]
    fn a_prediction_that_is_no_number_is_not_counted() {
        let samples = scored(&[(f64::NAN, false), (0.7, true)]);
        assert_eq!(ConfusionMatrix::at(&samples, 0.5).n(), 1);
    }
}
