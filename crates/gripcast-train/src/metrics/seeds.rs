//! Metrics of a model over several training seeds.

use serde::{Deserialize, Serialize};

use super::Summary;

/// Mean and standard deviation of a metric over seeds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Mean.
    pub mean: f64,
    /// Sample standard deviation (n − 1); none for a single value.
    pub standard_deviation: Option<f64>,
    /// Number of seeds for which the metric is defined.
    pub n: usize,
}

impl Spread {
    /// Computes the spread of the finite values; none without any.
    pub fn new(values: impl IntoIterator<Item = f64>) -> Option<Self> {
        let values: Vec<f64> = values.into_iter().filter(|v| v.is_finite()).collect();
        let n = values.len();
        let mean = super::mean_of(values.iter().sum(), n)?;
        let squares: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
        Some(Self {
            mean,
            standard_deviation: super::mean_of(squares, n - 1).map(f64::sqrt),
            n,
        })
    }
}

/// Spread of each metric of [`Summary`]; none if undefined for every seed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SeedSummary {
    /// Number of seeds.
    pub seeds: usize,
    /// Decision threshold.
    pub threshold: Option<Spread>,
    /// Accuracy at the threshold.
    pub accuracy: Option<Spread>,
    /// Balanced accuracy at the threshold.
    pub balanced_accuracy: Option<Spread>,
    /// Area under the ROC curve.
    pub auroc: Option<Spread>,
    /// Average precision of the stable class.
    pub average_precision: Option<Spread>,
    /// Brier score.
    pub brier: Option<Spread>,
    /// Log loss, nats.
    pub log_loss: Option<Spread>,
    /// Expected calibration error.
    pub ece: Option<Spread>,
}

impl SeedSummary {
    /// Summarises the metrics of all seeds on the same samples.
    pub fn new(summaries: &[Summary]) -> Self {
        let spread =
            |metric: fn(&Summary) -> Option<f64>| Spread::new(summaries.iter().filter_map(metric));
        Self {
            seeds: summaries.len(),
            threshold: spread(|s| Some(s.threshold)),
            accuracy: spread(|s| s.accuracy),
            balanced_accuracy: spread(|s| s.balanced_accuracy),
            auroc: spread(|s| s.auroc),
            average_precision: spread(|s| s.average_precision),
            brier: spread(|s| s.brier),
            log_loss: spread(|s| s.log_loss),
            ece: spread(|s| s.ece),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::reference_test::{dyadic_samples, scored};
    use super::*;

    #[test]
    fn spread_uses_sample_standard_deviation() {
        let spread = Spread::new([1.0, 2.0, f64::NAN, 6.0]).unwrap();
        assert_eq!((spread.mean, spread.n), (3.0, 3));
        assert_eq!(spread.standard_deviation, Some(7.0_f64.sqrt()));
        let single = Spread::new([4.0]).unwrap();
        assert_eq!((single.mean, single.standard_deviation), (4.0, None));
        assert_eq!(Spread::new([]), None);
    }

    #[test]
    fn each_metric_has_a_spread() {
        let summaries: Vec<Summary> = (0..3)
            .map(|seed| Summary::new(&dyadic_samples(80, seed), 0.4 + 0.1 * seed as f64))
            .collect();
        let seeds = SeedSummary::new(&summaries);
        assert_eq!(seeds.seeds, 3);
        assert!((seeds.threshold.unwrap().mean - 0.5).abs() < 1e-12);
        let mean = summaries.iter().filter_map(|s| s.ece).sum::<f64>() / 3.0;
        assert!((seeds.ece.unwrap().mean - mean).abs() < 1e-12);
        let all = [
            seeds.accuracy,
            seeds.balanced_accuracy,
            seeds.auroc,
            seeds.average_precision,
            seeds.brier,
            seeds.log_loss,
            seeds.ece,
        ];
        // Seven metrics, all different.
        for (i, a) in all.iter().enumerate() {
            assert!(a.unwrap().standard_deviation > Some(0.0));
            assert!(all.iter().skip(i + 1).all(|b| a != b));
        }
        let json = serde_json::to_string(&seeds).unwrap();
        assert_eq!(serde_json::from_str::<SeedSummary>(&json).unwrap(), seeds);
    }

    #[test]
    fn undefined_metrics_are_ignored() {
        let one_class = Summary::new(&scored(&[(0.7, true)]), 0.5);
        let both = Summary::new(&scored(&[(0.7, true), (0.2, false)]), 0.5);
        let seeds = SeedSummary::new(&[one_class.clone(), both]);
        assert_eq!(seeds.auroc.map(|spread| spread.n), Some(1));
        assert_eq!(seeds.accuracy.map(|spread| spread.n), Some(2));
        assert_eq!(SeedSummary::new(&[one_class]).auroc, None);
        assert_eq!(SeedSummary::new(&[]).accuracy, None);
    }
}
