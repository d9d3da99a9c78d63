//! All metrics of a model on a set of samples, and by object or category.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::{
    ConfusionMatrix, Ranking, Scored, auroc, brier_score, expected_calibration_error, log_loss,
    present,
};

/// Metrics of a model; none where undefined.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Number of samples.
    pub n: usize,
    /// Number of stable samples.
    pub stable: usize,
    /// Number of ignored samples (NaN or infinite prediction).
    pub absent: usize,
    /// Decision threshold.
    pub threshold: f64,
    /// Confusion matrix at the threshold.
    pub confusion: ConfusionMatrix,
    /// Accuracy at the threshold.
    pub accuracy: Option<f64>,
    /// Balanced accuracy at the threshold.
    pub balanced_accuracy: Option<f64>,
    /// Area under the ROC curve.
    pub auroc: Option<f64>,
    /// Average precision of the stable class.
    pub average_precision: Option<f64>,
    /// Brier score.
    pub brier: Option<f64>,
    /// Log loss, nats.
    pub log_loss: Option<f64>,
    /// Expected calibration error, 15 bins of equal width.
    pub ece: Option<f64>,
}

impl Summary {
    /// Computes all metrics. With a threshold chosen on the same samples, decisions are biased.
    pub fn new(samples: &[Scored], threshold: f64) -> Self {
        let confusion = ConfusionMatrix::at(samples, threshold);
        let ranking = Ranking::new(samples);
        Self {
            n: confusion.n(),
            stable: confusion.n_stable(),
            absent: samples.len() - confusion.n(),
            threshold,
            confusion,
            accuracy: confusion.accuracy(),
            balanced_accuracy: confusion.balanced_accuracy(),
            auroc: ranking.auroc(),
            average_precision: ranking.average_precision(),
            brier: brier_score(samples),
            log_loss: log_loss(samples),
            ece: expected_calibration_error(samples),
        }
    }
}

/// Metrics of an object or category.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GroupSummary {
    /// Name of the object or category.
    pub name: String,
    /// Number of samples.
    pub n: usize,
    /// Number of stable samples.
    pub stable: usize,
    /// Accuracy.
    pub accuracy: Option<f64>,
    /// Area under the ROC curve.
    pub auroc: Option<f64>,
}

/// Computes metrics by group, in the order of `names`. `groups` holds the name index of each
/// sample; an index without a name is named by its number. Empty groups and samples without a
/// group are omitted.
pub fn summarise_groups(
    samples: &[Scored],
    groups: &[usize],
    names: &[String],
    threshold: f64,
) -> Vec<GroupSummary> {
    let mut by_group: BTreeMap<usize, Vec<Scored>> = BTreeMap::new();
    for (sample, &group) in samples.iter().zip(groups) {
        by_group.entry(group).or_default().push(*sample);
    }
    by_group
        .iter()
        .map(|(&group, samples)| GroupSummary {
            name: names
                .get(group)
                .map_or_else(|| group.to_string(), String::clone),
            n: present(samples).count(),
            stable: present(samples).filter(|sample| sample.stable).count(),
            accuracy: ConfusionMatrix::at(samples, threshold).accuracy(),
            auroc: auroc(samples),
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::reference_test::{dyadic_samples, scored};
    use super::*;

    #[test]
    fn summary_collects_metrics() {
        let mut samples = dyadic_samples(100, 40);
        samples.push(Scored {
            p_stable: f64::NAN,
            stable: true,
        });
        let summary = Summary::new(&samples, 0.5);
        assert_eq!((summary.n, summary.absent), (100, 1));
        assert_eq!(
            summary.stable,
            samples[..100].iter().filter(|s| s.stable).count()
        );
        assert_eq!(summary.confusion.n_stable(), summary.stable);
        assert_eq!(summary.auroc, auroc(&samples));
        assert_eq!(summary.log_loss, log_loss(&samples));
        assert!(summary.accuracy > Some(0.5) && summary.ece < Some(0.5));
    }

    #[test]
    fn summary_roundtrips_json() {
        for samples in [dyadic_samples(100, 41), Vec::new()] {
            let summary = Summary::new(&samples, 0.3);
            let json = serde_json::to_string(&summary).unwrap();
            assert_eq!(serde_json::from_str::<Summary>(&json).unwrap(), summary);
        }
    }

    #[test]
    fn summary_without_samples_is_empty() {
        let summary = Summary::new(&[], 0.5);
        assert_eq!((summary.n, summary.stable, summary.absent), (0, 0, 0));
        assert_eq!(summary.accuracy, None);
        assert_eq!(summary.auroc, None);
        assert_eq!(summary.brier, None);
    }

    #[test]
    fn groups_have_own_metrics() {
        let samples = scored(&[
            (0.9, true),
            (0.8, false),
            (0.2, false),
            (0.7, true),
            (0.6, true),
        ]);
        let names = ["mug".to_owned(), "unused".to_owned(), "box".to_owned()];
        let groups = summarise_groups(&samples, &[2, 2, 2, 0, 9], &names, 0.5);
        let rows: Vec<_> = groups
            .iter()
            .map(|g| (g.name.as_str(), g.n, g.stable, g.accuracy, g.auroc))
            .collect();
        assert_eq!(
            rows,
            [
                ("mug", 1, 1, Some(1.0), None),
                ("box", 3, 1, Some(2.0 / 3.0), Some(1.0)),
                ("9", 1, 1, Some(1.0), None)
            ]
        );
        assert!(summarise_groups(&samples, &[], &names, 0.5).is_empty());
    }
}
