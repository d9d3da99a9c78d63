//! How classifiers are trained: flags that `train` and `experiment` fraction.

use gripcast_base::error::{Error, Result};
use gripcast_nn::Architecture;
use gripcast_nn::predict::contract::Modality;
use gripcast_train::{Augmentation, TrainSettings};

/// Flags.
#[derive(Clone, Debug, clap::Args)]
pub(super) struct TrainingFlags {
    /// Network
    #[arg(long, default_value = "gripcast", value_parser = Architecture::NAMES)]
    arch: String,
    /// Times that every sample is seen
    #[arg(long, default_value_t = 30)]
    epochs: u32,
    /// Samples of a step
    #[arg(long, default_value_t = 16)]
    batch: usize,
    /// Learning rate at its highest; it falls linearly to zero
    #[arg(long, default_value_t = 3e-4)]
    learning_rate: f64,
    /// Fraction of themselves that weights lose in a step at a rate of 1
    #[arg(long, default_value_t = 0.01)]
    weight_decay: f64,
    /// Fraction of the hidden floats that are left out at random
    #[arg(long, default_value_t = 0.2)]
    dropout: f64,
    /// Epochs without a better validation accuracy after which training ends; 0 for never
    #[arg(long, default_value_t = 0)]
    patience: u32,
    /// Leave images as they are
    #[arg(long)]
    no_augmentation: bool,
}

impl TrainingFlags {
    /// The settings of a training.
    ///
    /// # Errors
    /// `Usage`, with the flag.
    pub(super) fn settings(&self, variant: Modality, seed: u64) -> Result<TrainSettings> {
        let architecture = Architecture::by_name(&self.arch).ok_or_else(|| {
            let what = format!("there is no network `{}`", self.arch);
            Error::usage(what)
        })?;
        let settings = TrainSettings {
            epochs: self.epochs,
            batch: self.batch,
            learning_rate: self.learning_rate,
            weight_decay: self.weight_decay,
            dropout: self.dropout,
            patience: self.patience,
            augmentation: if self.no_augmentation {
                Augmentation::NONE
            } else {
                Augmentation::USUAL
            },
            ..TrainSettings::usual(variant, architecture, seed)
        };
        settings.check()?;
        Ok(settings)
    }
}
