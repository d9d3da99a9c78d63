//! Metrics of the stability prediction.
//!
//! Stable (`true`) is the positive class; a sample is predicted stable if its probability is at
//! least the threshold. A metric that is undefined for its samples (none, one class only) is
//! `None`; samples whose probability is NaN or infinite are ignored.
//!
//! | item | purpose |
//! | --- | --- |
//! | [`Ranking`] | AUROC, average precision and curves, also of resamples |
//! | [`ConfusionMatrix`], [`even_odds_threshold`] | decisions at a threshold, choice of the threshold |
//! | [`brier_score`], [`log_loss`], [`ReliabilityTable`], [`ChanceCalibration`], [`BaseRateCalibration`], [`fit_temperature`] | calibration |
//! | [`Summary`], [`summarise_groups`], [`SeedSummary`] | all metrics of a model, by object or category, over seeds |
//! | [`Bootstrap`] | 95 % intervals over objects |
//! | [`plot`] | figures as SVG |

mod bootstrap;
mod calibration;
mod confusion;
mod curve;
pub mod plot;
mod ranking;
#[cfg(test)]
mod reference_test;
mod seeds;
mod summary;
mod temperature;
mod threshold;

pub use bootstrap::{Bootstrap, Interval, resampled_mean};
pub use calibration::{
    BaseRateCalibration, ChanceCalibration, ReliabilityBin, ReliabilityTable, brier_score,
    expected_calibration_error, log_loss,
};
pub use confusion::{ClassMetrics, ConfusionMatrix};
pub use curve::{PrecisionRecallPoint, RocPoint};
pub use ranking::{Ranking, auroc, average_precision};
pub use seeds::{SeedSummary, Spread};
pub use summary::{GroupSummary, Summary, summarise_groups};
pub use temperature::{TemperatureFit, fit_temperature, probability_of_logit};
pub use threshold::even_odds_threshold;

/// Prediction and label of a sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scored {
    /// Predicted probability that the grasp is stable, 0..1.
    pub p_stable: f64,
    /// Whether the outcome is stable.
    pub stable: bool,
}

impl Scored {
    /// 1 for stable, 0 for slip.
    fn outcome(&self) -> f64 {
        f64::from(u8::from(self.stable))
    }
}

/// Returns the samples with a finite probability.
fn present(samples: &[Scored]) -> impl Iterator<Item = &Scored> {
    samples.iter().filter(|sample| sample.p_stable.is_finite())
}

/// Returns `sum / n`, none for n = 0.
fn mean_of(sum: f64, n: usize) -> Option<f64> {
    (n > 0).then(|| sum / n as f64)
}
