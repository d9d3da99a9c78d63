//! What a training run is made by.

use serde::{Deserialize, Serialize};

use super::augment::Augmentation;
use gripcast_base::error::{Error, Result};
use gripcast_nn::Architecture;
use gripcast_nn::predict::contract::Modality;

/// Everything that decides what a run learns. A run goes on only under the same settings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainSettings {
    /// Senses of the classifier.
    pub variant: Modality,
    /// Its sizes.
    pub architecture: Architecture,
    /// Parameters at the start, order of the samples and their changes follow from it.
    pub seed: u64,
    /// Times that every sample is seen.
    pub epochs: u32,
    /// Samples of a step.
    pub batch: usize,
    /// Learning rate at its highest; it falls linearly to zero.
    pub learning_rate: f64,
    /// Steps over which the rate rises.
    pub warm_up: u64,
    /// Fraction of themselves that weights lose in a step at a rate of 1.
    pub weight_decay: f64,
    /// Fraction of the hidden floats that are left out at random.
    pub dropout: f64,
    /// Epochs without a better validation accuracy after which training ends; 0 for never.
    pub patience: u32,
    /// How images are changed.
    pub augmentation: Augmentation,
    /// Bytes of images that are mixed at a time.
    pub memory: usize,
}

impl TrainSettings {
    /// The usual settings of an architecture.
    pub fn usual(variant: Modality, architecture: Architecture, seed: u64) -> Self {
        Self {
            variant,
            architecture,
            seed,
            epochs: 30,
            batch: 16,
            learning_rate: 3e-4,
            warm_up: 100,
            weight_decay: 0.01,
            dropout: 0.2,
            patience: 0,
            augmentation: Augmentation::USUAL,
            memory: 1 << 30,
        }
    }

    /// Refuses settings that cannot train anything.
    ///
    /// # Errors
    /// `Usage`, with the setting.
    pub fn check(&self) -> Result<()> {
        let wrong = |what: String| Err(Error::usage(what));
        let within = |name: &str, value: f64, low: f64, high: f64| {
            if value >= low && value <= high {
                return Ok(());
            }
            wrong(format!("`{name}`: expected {low} to {high}, found {value}"))
        };
        if self.epochs == 0 || self.batch < 2 {
            return wrong(format!(
                "expected at least one epoch and two samples in a batch, found {} and {}",
                self.epochs, self.batch
            ));
        }
        within("learning-rate", self.learning_rate, 1e-9, 1.0)?;
        within("weight-decay", self.weight_decay, 0.0, 1.0)?;
        within("dropout", self.dropout, 0.0, 0.95)
    }
}
