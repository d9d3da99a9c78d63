//! Adaptation of a model's probabilities to the labels of a rig.
//!
//! A model assumes the base rate of its training. Where the labels of a rig show another one, the
//! odds of a prediction are multiplied by the ratio of the odds (Saerens, Latinne & Decaestecker
//! 2002, *Adjusting the outputs of a classifier to new a priori probabilities*). The base rate is
//! the mean of a Beta distribution: a prior with the model's base rate, updated by the labels.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::contract::ModelContract;

/// Metadata key of the base rate that a model was trained at; 0.5 where it is absent, because
/// training weighs both labels equally.
pub const BASE_RATE: &str = "gripcast.train.base_rate";
/// Base rate of labels with equal weights.
const EVEN: f64 = 0.5;
/// Default weight of the prior, in labels.
pub const ADAPTATION_STRENGTH: f64 = 10.0;
/// Minimum distance of base rates and probabilities from 0 and 1, so that odds are finite.
const MARGIN: f64 = 1e-6;

/// Base rate that the labels of a rig show, relative to that of a model.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Adaptation {
    /// Number of labels.
    pub labels: u64,
    /// Number of stable grasps among them.
    pub stable: u64,
    /// Base rate of the model's training, in (0, 1).
    pub model_base_rate: f64,
    /// Weight of the prior, in labels.
    pub strength: f64,
    /// Base rate: mean of the Beta distribution after the labels.
    pub base_rate: f64,
    /// What is added to the log-odds of a prediction.
    pub offset: f64,
}

impl Adaptation {
    /// Computes the base rate after `labels`, of which `stable` are stable: (strength · model's base
    /// rate + stable) / (strength + labels). It depends on the counts alone, so a label that is
    /// undone leaves no trace.
    #[must_use]
    pub fn new(model_base_rate: f64, strength: f64, [slip, stable]: [u64; 2]) -> Self {
        let model_base_rate = model_base_rate.clamp(MARGIN, 1.0 - MARGIN);
        let labels = slip + stable;
        let base_rate = match strength + labels as f64 > 0.0 {
            true => (strength * model_base_rate + stable as f64) / (strength + labels as f64),
            false => model_base_rate,
        };
        Self {
            labels,
            stable,
            model_base_rate,
            strength,
            base_rate,
            offset: log_odds(base_rate) - log_odds(model_base_rate),
        }
    }

    /// The probability of stable at the base rate of the labels.
    #[must_use]
    pub fn adapted(&self, p_stable: f64) -> f64 {
        if self.labels == 0 {
            return p_stable;
        }
        1.0 / (1.0 + (-log_odds(p_stable) - self.offset).exp())
    }

    /// For people: `adapted to 7 labels: base rate 0.62`.
    #[must_use]
    pub fn words(&self) -> String {
        match self.labels {
            1 => format!("adapted to 1 label: base rate {:.2}", self.base_rate),
            n => format!("adapted to {n} labels: base rate {:.2}", self.base_rate),
        }
    }
}

/// Base rate that a model was trained at.
#[must_use]
pub fn training_base_rate(contract: &ModelContract) -> f64 {
    let stated = contract.other.get(BASE_RATE);
    let stated = stated.and_then(|text| text.trim().parse::<f64>().ok());
    let stated = stated.filter(|rate| *rate > 0.0 && *rate < 1.0);
    stated.unwrap_or(EVEN)
}

fn log_odds(p: f64) -> f64 {
    let p = p.clamp(MARGIN, 1.0 - MARGIN);
    (p / (1.0 - p)).ln()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base_rate_starts_at_the_model_and_follows_the_labels() {
        let rate = |counts| Adaptation::new(0.5, 10.0, counts).base_rate;
        assert_eq!(rate([0, 0]), 0.5);
        assert!((rate([1, 6]) - 11.0 / 17.0).abs() < 1e-15);
        assert!(rate([0, 1]) > 0.5 && rate([1, 0]) < 0.5);
        assert!((rate([2000, 6000]) - 0.75).abs() < 1e-3);
        // A stronger prior moves less.
        assert!(Adaptation::new(0.5, 100.0, [0, 5]).base_rate < rate([0, 5]));
    }

    #[test]
    fn odds_are_multiplied_by_the_ratio_of_the_base_rates_odds() {
        let adaptation = Adaptation::new(0.5, 10.0, [0, 10]);
        assert_eq!(adaptation.base_rate, 0.75);
        // Odds of 1/4 times 3.
        assert!((adaptation.adapted(0.2) - 3.0 / 7.0).abs() < 1e-12);
        let uneven = Adaptation::new(0.8, 10.0, [10, 0]);
        assert!((uneven.base_rate - 0.4).abs() < 1e-15);
        assert!((uneven.adapted(0.8) - 0.4).abs() < 1e-12);
        for p in [0.0, 1.0] {
            assert!((adaptation.adapted(p) - p).abs() < 1e-5);
        }
    }

    #[test]
    fn undone_labels_leave_no_trace() {
        let before = Adaptation::new(0.5, 10.0, [3, 4]);
        assert_ne!(before, Adaptation::new(0.5, 10.0, [3, 5]));
        assert_eq!(before, Adaptation::new(0.5, 10.0, [3, 4]));
        let none = Adaptation::new(0.37, 10.0, [0, 0]);
        assert_eq!((none.adapted(0.123), none.offset), (0.123, 0.0));
        // The label of a grasp is changed: from slip to stable.
        let relabelled = Adaptation::new(0.5, 10.0, [2, 5]);
        assert!(relabelled.base_rate > before.base_rate);
    }

    #[test]
    fn words_name_labels_and_base_rate() {
        let words = |counts| Adaptation::new(0.5, 10.0, counts).words();
        assert_eq!(words([1, 0]), "adapted to 1 label: base rate 0.45");
        assert_eq!(words([1, 6]), "adapted to 7 labels: base rate 0.65");
    }
}
