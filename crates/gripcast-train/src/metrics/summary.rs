//! All figures of one model on one set of samples, and by object or category.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::{
    ConfusionMatrix, Ranking, Scored, auroc, brier_score, expected_calibration_error, log_loss,
    present,
};

/// Figures of a model; none where they are undefined for its samples.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Samples that were scored.
    pub n: usize,
    /// Stable ones among them.
    pub stable: usize,
    /// Samples left out, as their prediction is no finite number.
    pub absent: usize,
    /// Prediction from which a grasp counts as stable.
    pub threshold: f64,
    /// Decisions at the threshold.
    pub confusion: ConfusionMatrix,
    /// Fraction of right decisions at the threshold.
    pub accuracy: Option<f64>,
    /// Mean recall of the two classes at the threshold.
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
    /// Computes all figures. Decisions at a threshold that was chosen on the same samples look
    /// better than they are.
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

/// Figures of the samples of one object or category.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GroupSummary {
    /// Name of the object or category.
    pub name: String,
    /// Samples that were scored.
    pub n: usize,
    /// Stable ones among them.
    pub stable: usize,
    /// Fraction of right decisions.
    pub accuracy: Option<f64>,
    /// Area under the ROC curve.
    pub auroc: Option<f64>,
}

/// Figures by group, in the order of `names`. `groups` has the index of each sample's name; an
/// index without a name is called by its number. Groups without samples are left out, as are
/// samples without a group.
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
    fn a_summary_collects_the_figures() {
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
    fn a_summary_survives_json() {
        for samples in [dyadic_samples(100, 41), Vec::new()] {
            let summary = Summary::new(&samples, 0.3);
            let json = serde_json::to_string(&summary).unwrap();
            assert_eq!(serde_json::from_str::<Summary>(&json).unwrap(), summary);
        }
    }

    #[test]
    fn a_summary_of_nothing_is_empty() {
        let summary = Summary::new(&[], 0.5);
        assert_eq!((summary.n, summary.stable, summary.absent), (0, 0, 0));
        assert_eq!(summary.accuracy, None);
        assert_eq!(summary.auroc, None);
        assert_eq!(summary.brier, None);
    }

    #[test]
    fn groups_have_their_own_figures() {
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
