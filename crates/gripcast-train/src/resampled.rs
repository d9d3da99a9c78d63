//! Metrics of models on resamples of the same samples: intervals over objects, means over seeds.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::evaluate::{ModelEvaluation, SEED};
use super::metrics::{Bootstrap, Interval, Ranking, Scored, SeedSummary, Summary, resampled_mean};
use gripcast_nn::predict::contract::Modality;

/// Metrics of models that differ in their seed, from the same inputs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SeedResult {
    /// The inputs.
    pub modality: Modality,
    /// Mean and standard deviation over the seeds.
    pub summary: SeedSummary,
    /// Mean AUROC with its 95 % interval over objects.
    pub auroc: Option<Interval>,
    /// Mean balanced accuracy with its 95 % interval over objects.
    pub balanced_accuracy: Option<Interval>,
    /// Mean AUROC from all inputs minus that from these.
    pub auroc_less_than_all: Option<Interval>,
}

impl SeedResult {
    /// Results by inputs, in the order of the first model's outputs.
    pub(super) fn all(evaluated: &[ModelEvaluation]) -> Vec<Self> {
        let mut order: Vec<Modality> = evaluated.iter().map(|e| e.modality).collect();
        order.sort_unstable();
        order.dedup();
        let of = |modality: Modality| -> Vec<ModelEvaluation> {
            let own = evaluated.iter().filter(|e| e.modality == modality);
            own.cloned().collect()
        };
        let all = order.first().map(|modality| Resampled::new(&of(*modality)));
        let result = |modality: &Modality| {
            let seeds = of(*modality);
            let summaries: Vec<Summary> = seeds.iter().map(|e| e.summary.clone()).collect();
            let resampled = Resampled::new(&seeds);
            let [auroc, balanced_accuracy] = resampled.intervals();
            Self {
                modality: *modality,
                summary: SeedSummary::new(&summaries),
                auroc,
                balanced_accuracy,
                auroc_less_than_all: all.as_ref().and_then(|all| {
                    let [auroc, _] = all.minus(&resampled);
                    auroc.filter(|_| order.first() != Some(modality))
                }),
            }
        };
        order.iter().map(result).collect()
    }
}

/// Metrics of models on resamples of the same samples, for intervals over objects.
pub(super) struct Resampled {
    objects: Vec<usize>,
    models: Vec<ResampledMetrics>,
}

impl Resampled {
    pub(super) fn new(models: &[ModelEvaluation]) -> Self {
        let mut numbers: BTreeMap<&str, usize> = BTreeMap::new();
        let first = models.first().map_or(&[][..], |e| &e.predictions);
        let objects = first.iter().map(|sample| {
            let next = numbers.len();
            *numbers.entry(&sample.object).or_insert(next)
        });
        Self {
            objects: objects.collect(),
            models: models
                .iter()
                .map(|e| ResampledMetrics::new(&e.scored(), e.summary.threshold))
                .collect(),
        }
    }

    fn mean(&self, metric: impl Fn(&ResampledMetrics) -> Option<f64>) -> Option<f64> {
        let values: Option<Vec<f64>> = self.models.iter().map(metric).collect();
        let values = values.filter(|values| !values.is_empty())?;
        Some(values.iter().sum::<f64>() / values.len() as f64)
    }

    fn auroc(&self, times: &[u32]) -> Option<f64> {
        self.mean(|metrics| metrics.auroc(times))
    }

    fn balanced_accuracy(&self, times: &[u32]) -> Option<f64> {
        self.mean(|metrics| metrics.balanced_accuracy(times))
    }

    /// Returns the intervals of mean AUROC and mean balanced accuracy.
    pub(super) fn intervals(&self) -> [Option<Interval>; 2] {
        let bootstrap = Bootstrap::new(SEED);
        [
            bootstrap.interval(&self.objects, |times| self.auroc(times)),
            bootstrap.interval(&self.objects, |times| self.balanced_accuracy(times)),
        ]
    }

    /// Returns the intervals of the differences in mean AUROC and mean balanced accuracy.
    pub(super) fn minus(&self, other: &Self) -> [Option<Interval>; 2] {
        let bootstrap = Bootstrap::new(SEED);
        [
            bootstrap.paired_interval(
                &self.objects,
                |times| self.auroc(times),
                |times| other.auroc(times),
            ),
            bootstrap.paired_interval(
                &self.objects,
                |times| self.balanced_accuracy(times),
                |times| other.balanced_accuracy(times),
            ),
        ]
    }
}

/// Metrics of resamples.
pub(super) struct ResampledMetrics {
    ranking: Ranking,
    /// For slip and for stable: 1 if a sample is correct, 0 if not, NaN for the other label.
    correct: [Vec<f64>; 2],
}

impl ResampledMetrics {
    pub(super) fn new(scored: &[Scored], threshold: f64) -> Self {
        let correct = [false, true].map(|label| {
            let correct = scored.iter().map(|sample| {
                let is_correct = (sample.p_stable >= threshold) == sample.stable;
                if sample.stable == label {
                    f64::from(u8::from(is_correct))
                } else {
                    f64::NAN
                }
            });
            correct.collect()
        });
        Self {
            ranking: Ranking::new(scored),
            correct,
        }
    }

    pub(super) fn auroc(&self, times: &[u32]) -> Option<f64> {
        self.ranking.resampled_auroc(times)
    }

    pub(super) fn balanced_accuracy(&self, times: &[u32]) -> Option<f64> {
        let [slip, stable] = &self.correct;
        Some(0.5 * (resampled_mean(slip, times)? + resampled_mean(stable, times)?))
    }
}
