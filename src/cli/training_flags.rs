//! Training options of `train` and `experiment`.

use super::flags::{above_zero, fraction, number};
use gripcast_base::error::{Error, Result};
use gripcast_base::number::NumberRange;
use gripcast_nn::Architecture;
use gripcast_nn::predict::contract::Modality;
use gripcast_train::{Augmentation, StartModel, TrainSettings};

/// Training options.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Training")]
pub(super) struct TrainingFlags {
    /// Network architecture
    #[arg(long, value_name = "NAME", default_value = "gripcast",
        value_parser = Architecture::NAMES)]
    arch: String,
    /// Epochs in which the encoders of camera images first learn the extents of the object [default:
    /// 30, or 0 with --cameras-from]
    #[arg(long, value_name = "N")]
    pretrain_epochs: Option<u32>,
    /// Model whose encoders of camera images are used: a built-in name, an ONNX file of `train`, or a
    /// run
    #[arg(long, value_name = "MODEL")]
    cameras_from: Option<String>,
    /// Number of training epochs
    #[arg(long, value_name = "N", default_value_t = 30)]
    epochs: u32,
    /// Batch size; at most the number of training samples is used
    #[arg(long, value_name = "N", default_value_t = 16)]
    batch_size: usize,
    /// Peak learning rate (linear decay to 0)
    #[arg(long, value_name = "RATE", default_value_t = 3e-4, value_parser = above_zero)]
    learning_rate: f64,
    /// Weight decay (decoupled, AdamW)
    #[arg(long, value_name = "DECAY", default_value_t = 0.01,
        value_parser = number(NumberRange::NOT_NEGATIVE))]
    weight_decay: f64,
    /// Dropout probability of the hidden layer
    #[arg(long, value_name = "P", default_value_t = 0.2, value_parser = fraction)]
    dropout: f64,
    /// Early-stopping patience (epochs); 0 disables early stopping
    #[arg(long, value_name = "EPOCHS", default_value_t = 0)]
    patience: u32,
    /// Disable data augmentation
    #[arg(long)]
    no_augmentation: bool,
}

impl TrainingFlags {
    /// Loads the model of `--cameras-from`.
    ///
    /// # Errors
    /// Those of [`StartModel::by_name`].
    pub(super) fn cameras(&self) -> Result<Option<StartModel>> {
        let name = self.cameras_from.as_deref();
        name.map(StartModel::by_name).transpose()
    }

    /// Returns the training settings.
    ///
    /// # Errors
    /// `Usage`, naming the option.
    pub(super) fn settings(&self, modality: Modality, seed: u64) -> Result<TrainSettings> {
        let architecture = Architecture::by_name(&self.arch)
            .ok_or_else(|| Error::usage(format!("unknown network architecture `{}`", self.arch)))?;
        let usual = if self.cameras_from.is_some() { 0 } else { 30 };
        let settings = TrainSettings {
            pretrain_epochs: self.pretrain_epochs.unwrap_or(usual),
            epochs: self.epochs,
            batch_size: self.batch_size,
            learning_rate: self.learning_rate,
            weight_decay: self.weight_decay,
            dropout: self.dropout,
            patience: self.patience,
            augmentation: if self.no_augmentation {
                Augmentation::NONE
            } else {
                Augmentation::DEFAULT
            },
            ..TrainSettings::new(modality, architecture, seed)
        };
        settings.check()?;
        Ok(settings)
    }
}
