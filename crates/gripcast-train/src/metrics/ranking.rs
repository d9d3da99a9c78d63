//! Metrics that depend only on the order of the predictions: AUROC and average precision.

use super::Scored;
use super::curve::{PrecisionRecallPoint, RocPoint, Tie, precision_recall_points, roc_points};

/// Area under the ROC curve: the probability that a stable sample gets a higher prediction than a
/// slip sample, ties counting half (Hanley & McNeil 1982). None with one class only.
pub fn auroc(samples: &[Scored]) -> Option<f64> {
    Ranking::new(samples).auroc()
}

/// Average precision of the stable class: the sum over thresholds of precision times the gain in
/// recall, equal predictions sharing one threshold, without interpolation (as in scikit-learn).
/// None without a stable sample.
pub fn average_precision(samples: &[Scored]) -> Option<f64> {
    Ranking::new(samples).average_precision()
}

/// Samples sorted by prediction, for metrics of the samples and of many resamples.
#[derive(Clone, Debug)]
pub struct Ranking {
    /// Highest prediction first.
    entries: Vec<Entry>,
}

#[derive(Clone, Copy, Debug)]
struct Entry {
    /// Index of the sample.
    sample: usize,
    scored: Scored,
    /// Whether the next prediction is lower.
    ends_tie: bool,
}

impl Ranking {
    /// Sorts the samples; those with a NaN or infinite prediction are ignored.
    pub fn new(samples: &[Scored]) -> Self {
        let mut entries: Vec<Entry> = samples
            .iter()
            .enumerate()
            .filter(|(_, scored)| scored.p_stable.is_finite())
            .map(|(sample, &scored)| Entry {
                sample,
                scored,
                ends_tie: true,
            })
            .collect();
        // A stable sort keeps the order of ties.
        entries.sort_by(|a, b| b.scored.p_stable.total_cmp(&a.scored.p_stable));
        let mut next_prediction = None;
        for entry in entries.iter_mut().rev() {
            entry.ends_tie = next_prediction != Some(entry.scored.p_stable);
            next_prediction = Some(entry.scored.p_stable);
        }
        Self { entries }
    }

    /// See [`auroc`].
    pub fn auroc(&self) -> Option<f64> {
        self.weighted_auroc(|_| 1)
    }

    /// See [`average_precision`].
    pub fn average_precision(&self) -> Option<f64> {
        let (mut stable, mut predicted) = (0_u64, 0_u64);
        let mut sum = 0.0;
        self.for_each_tie(
            |_| 1,
            |tie| {
                stable += tie.stable;
                predicted += tie.stable + tie.slip;
                if tie.stable > 0 {
                    sum += tie.stable as f64 * stable as f64 / predicted as f64;
                }
            },
        );
        (stable > 0).then(|| sum / stable as f64)
    }

    /// AUROC of a resample: sample `i` counts `multiplicities[i]` times (0 if missing).
    pub fn resampled_auroc(&self, multiplicities: &[u32]) -> Option<f64> {
        self.weighted_auroc(|sample| multiplicity(multiplicities, sample))
    }

    /// ROC curve from (0, 0) to (1, 1), at most 512 points; straight between them, as ties count
    /// half. Empty with one class only.
    pub fn roc_curve(&self) -> Vec<RocPoint> {
        roc_points(&self.ties())
    }

    /// Precision–recall curve by falling threshold, at most 512 points. It keeps the corners of
    /// the steps that [`average_precision`] sums, so it is drawn with straight lines. Empty
    /// without a stable sample.
    pub fn precision_recall_curve(&self) -> Vec<PrecisionRecallPoint> {
        precision_recall_points(&self.ties())
    }

    /// Groups of equal predictions, the highest first.
    pub(super) fn ties(&self) -> Vec<Tie> {
        let mut ties = Vec::new();
        self.for_each_tie(|_| 1, |tie| ties.push(tie));
        ties
    }

    fn for_each_tie(&self, weight: impl Fn(usize) -> u64, mut visit: impl FnMut(Tie)) {
        let mut tie = Tie::default();
        for entry in &self.entries {
            let weight = weight(entry.sample);
            if entry.scored.stable {
                tie.stable += weight;
            } else {
                tie.slip += weight;
            }
            if entry.ends_tie {
                tie.p_stable = entry.scored.p_stable;
                visit(tie);
                tie = Tie::default();
            }
        }
    }

    fn weighted_auroc(&self, weight: impl Fn(usize) -> u64) -> Option<f64> {
        let (mut stable, mut slip) = (0_u64, 0_u64);
        let mut doubled_wins = 0_u128;
        self.for_each_tie(weight, |tie| {
            let beaten_by = 2 * u128::from(stable) + u128::from(tie.stable);
            doubled_wins += u128::from(tie.slip) * beaten_by;
            stable += tie.stable;
            slip += tie.slip;
        });
        let pairs = u128::from(stable) * u128::from(slip);
        (pairs > 0).then(|| 0.5 * doubled_wins as f64 / pairs as f64)
    }
}

fn multiplicity(multiplicities: &[u32], sample: usize) -> u64 {
    multiplicities.get(sample).copied().map_or(0, u64::from)
}

#[cfg(test)]
mod tests {
    use super::super::reference_test::{dyadic_samples, flipped, mapped, scored};
    use super::*;

    #[test]
    fn ties_count_half() {
        let samples = scored(&[(0.5, true), (0.5, false)]);
        assert_eq!(auroc(&samples), Some(0.5));
        // Of the pairs 0.9 > 0.4, 0.9 > 0.2, 0.4 = 0.4, 0.4 > 0.2 one is a tie.
        let samples = scored(&[(0.9, true), (0.4, true), (0.4, false), (0.2, false)]);
        assert_eq!(auroc(&samples), Some(3.5 / 4.0));
    }

    #[test]
    fn average_precision_has_one_threshold_per_tie() {
        // Whatever the order within the tie: recall 1 is reached with precision 1/2.
        for samples in [[(0.5, true), (0.5, false)], [(0.5, false), (0.5, true)]] {
            assert_eq!(average_precision(&scored(&samples)), Some(0.5));
        }
        // Recall 1/2 at precision 1, then recall 1 at precision 2/3.
        let samples = scored(&[(0.9, true), (0.6, false), (0.4, true)]);
        assert_eq!(average_precision(&samples), Some(0.5 + 0.5 * 2.0 / 3.0));
    }

    #[test]
    fn one_class_has_no_auroc() {
        assert_eq!(auroc(&[]), None);
        assert_eq!(average_precision(&[]), None);
        let stable = scored(&[(0.1, true), (0.7, true)]);
        assert_eq!(auroc(&stable), None);
        assert_eq!(average_precision(&stable), Some(1.0));
        assert_eq!(auroc(&flipped(&stable)), None);
        assert_eq!(average_precision(&flipped(&stable)), None);
    }

    #[test]
    fn monotone_map_keeps_metrics() {
        let samples = dyadic_samples(300, 5);
        let curved = mapped(&samples, |p| (9.0 * p - 4.0).exp());
        assert_eq!(auroc(&samples), auroc(&curved));
        assert_eq!(average_precision(&samples), average_precision(&curved));
        // A map that is not monotone does change it.
        let folded = mapped(&samples, |p| (p - 0.5).abs());
        assert_ne!(auroc(&samples), auroc(&folded));
    }

    #[test]
    fn flipped_labels_mirror_auroc() {
        let samples = dyadic_samples(300, 6);
        let area = auroc(&samples).unwrap();
        assert!((area - 0.5).abs() > 0.1);
        assert!((auroc(&flipped(&samples)).unwrap() - (1.0 - area)).abs() < 1e-15);
        let reversed = mapped(&samples, |p| 1.0 - p);
        assert!((auroc(&reversed).unwrap() - (1.0 - area)).abs() < 1e-15);
    }

    #[test]
    fn multiplicities_act_like_copies() {
        let samples = dyadic_samples(60, 8);
        let multiplicities: Vec<u32> = (0..60).map(|i| i * 7 % 4).collect();
        let mut copies = Vec::new();
        for (sample, &times) in samples.iter().zip(&multiplicities) {
            copies.extend((0..times).map(|_| *sample));
        }
        let ranking = Ranking::new(&samples);
        assert_eq!(ranking.resampled_auroc(&multiplicities), auroc(&copies));
        assert_eq!(ranking.resampled_auroc(&[]), None);
        assert_eq!(ranking.resampled_auroc(&[u32::MAX; 60]), ranking.auroc());
    }

    #[test]
    fn nan_predictions_are_ignored() {
        let samples = scored(&[(0.9, true), (0.4, false)]);
        let more = scored(&[
            (f64::NAN, false),
            (0.9, true),
            (f64::INFINITY, false),
            (0.4, false),
        ]);
        assert_eq!(auroc(&more), auroc(&samples));
        // Multiplicities still belong to the samples as they were given.
        let resampled = Ranking::new(&more).resampled_auroc(&[5, 1, 5, 0]);
        assert_eq!(resampled, None);
        assert_eq!(
            Ranking::new(&more).resampled_auroc(&[0, 1, 0, 1]),
            Some(1.0)
        );
    }

    #[test]
    fn positive_and_negative_zero_tie() {
        let samples = scored(&[(0.0, true), (-0.0, false)]);
        assert_eq!(auroc(&samples), Some(0.5));
    }
}
