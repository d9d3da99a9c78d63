//! How well a classifier predicts, before the lift, whether a grasp is stable.
//!
//! The label `true`, stable, is the positive class; a sample counts as predicted stable where its
//! probability is at least the threshold. Every function is total: a figure that is undefined for
//! its samples (none at all, one class only) is `None`, and a probability that is no finite number
//! makes its sample absent.
//!
//! | part | what it gives |
//! | --- | --- |
//! | [`Ranking`] | AUROC, average precision and their curves, also of resampled samples |
//! | [`ConfusionMatrix`], [`youden_threshold`] | decisions at a threshold and its choice |
//! | [`brier_score`], [`log_loss`], [`ReliabilityTable`], [`ChanceCalibration`], [`BaseRateCalibration`], [`fit_temperature`] | calibration |
//! | [`Summary`], [`summarise_groups`], [`SeedSummary`] | all figures of a model, by object or category, over seeds |
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
pub use confusion::{ClassFigures, ConfusionMatrix};
pub use curve::{PrecisionRecallPoint, RocPoint};
pub use ranking::{Ranking, auroc, average_precision};
pub use seeds::{SeedSummary, Spread};
pub use summary::{GroupSummary, Summary, summarise_groups};
pub use temperature::{TemperatureFit, fit_temperature, probability_of_logit};
pub use threshold::youden_threshold;

/// A grasp's prediction and outcome.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scored {
    /// Predicted probability that the grasp is stable, 0..1.
    pub p_stable: f64,
    /// Whether the grasp was stable.
    pub stable: bool,
}

impl Scored {
    /// 1 for stable, 0 for unstable.
    fn outcome(&self) -> f64 {
        f64::from(u8::from(self.stable))
    }
}

/// The samples whose probability is a finite number.
fn present(samples: &[Scored]) -> impl Iterator<Item = &Scored> {
    samples.iter().filter(|sample| sample.p_stable.is_finite())
}

/// `sum / n`; none of nothing.
fn mean_of(sum: f64, n: usize) -> Option<f64> {
    (n > 0).then(|| sum / n as f64)
}
