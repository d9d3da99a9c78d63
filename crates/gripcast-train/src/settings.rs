//! Settings of a training run.

use serde::{Deserialize, Serialize};

use super::augment::Augmentation;
use gripcast_base::error::{Error, Result};
use gripcast_nn::Architecture;
use gripcast_nn::predict::contract::Modality;

/// All settings that affect the result. A run is only resumed with the same settings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainSettings {
    /// Input modality of the classifier.
    pub modality: Modality,
    /// Network architecture.
    pub architecture: Architecture,
    /// Random seed of initialisation, sample order and augmentation.
    pub seed: u64,
    /// Number of training epochs.
    pub epochs: u32,
    /// Batch size; a run with fewer training samples uses one batch of all of them.
    pub batch_size: usize,
    /// Peak learning rate (linear decay to 0).
    pub learning_rate: f64,
    /// Steps of linear warm-up.
    pub warm_up_steps: u64,
    /// Weight decay (decoupled, AdamW).
    pub weight_decay: f64,
    /// Dropout probability of the hidden layer.
    pub dropout: f64,
    /// Early-stopping patience, epochs; 0 disables early stopping.
    pub patience: u32,
    /// Data augmentation.
    pub augmentation: Augmentation,
    /// Size of the shuffle buffer, bytes of encoded images.
    pub shuffle_buffer: usize,
}

impl TrainSettings {
    /// Returns the default settings of an architecture.
    pub fn new(modality: Modality, architecture: Architecture, seed: u64) -> Self {
        Self {
            modality,
            architecture,
            seed,
            epochs: 30,
            batch_size: 16,
            learning_rate: 3e-4,
            warm_up_steps: 100,
            weight_decay: 0.01,
            dropout: 0.2,
            patience: 0,
            augmentation: Augmentation::DEFAULT,
            shuffle_buffer: 1 << 30,
        }
    }

    /// Checks the ranges of the settings.
    ///
    /// # Errors
    /// `Usage`, naming the setting.
    pub fn check(&self) -> Result<()> {
        let within = |name: &str, value: f64, low: f64, high: f64| {
            if value >= low && value <= high {
                return Ok(());
            }
            let what = format!("`{name}`: expected {low} to {high}, found {value}");
            Err(Error::usage(what))
        };
        if self.epochs == 0 || self.batch_size < 2 {
            return Err(Error::usage(format!(
                "expected at least one epoch and a batch size of 2, found {} and {}",
                self.epochs, self.batch_size
            )));
        }
        within("learning-rate", self.learning_rate, 1e-9, 1.0)?;
        within("weight-decay", self.weight_decay, 0.0, 1.0)?;
        within("dropout", self.dropout, 0.0, 0.95)
    }
}
