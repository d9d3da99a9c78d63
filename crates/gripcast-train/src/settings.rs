//! Settings of a training run.

use serde::{Deserialize, Serialize};

use super::augment::Augmentation;
use super::start::StartModel;
use gripcast_base::error::{Error, Result};
use gripcast_nn::predict::contract::Modality;
use gripcast_nn::{Architecture, Scope};

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
    /// Epochs before those of training in which the encoders of camera images learn the geometry of
    /// the grasp; 0 for a network without geometry.
    pub pretrain_epochs: u32,
    /// Epochs before those of training in which the encoder of tactile images learns the
    /// displacement of the gels' faces; 0 for data without it.
    pub contact_epochs: u32,
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
    /// Model with the encoders of camera images; none for random parameters.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cameras: Option<SourceModel>,
    /// Fine-tuning of a trained model; none for training from random parameters.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fine_tuning: Option<FineTuning>,
}

/// A trained model that parameters are taken from.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SourceModel {
    /// Its name.
    pub name: String,
    /// SHA-256 of its file.
    pub sha256: String,
}

/// Settings of fine-tuning. `epochs` of the settings train the head alone.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FineTuning {
    /// SHA-256 of the start model's file.
    pub start_sha256: String,
    /// Epochs after those of the head, in which all parameters are trained.
    pub unfreeze_epochs: u32,
}

/// Learning rate of geometry and contact maps relative to that of training.
const PRETRAIN_RATE: f64 = 4.0;
/// Learning rate of all parameters relative to that of the head.
const UNFROZEN_RATE: f64 = 0.1;
/// Steps of linear warm-up in fine-tuning: a few dozen grasps make a few steps per epoch.
const WARM_UP_STEPS: u64 = 10;

/// Epochs with one learning rate schedule and one set of trained parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Phase {
    /// What its steps change.
    pub(super) scope: Scope,
    /// First epoch, from 0.
    pub(super) first: u32,
    /// Number of epochs.
    pub(super) epochs: u32,
    /// Peak learning rate.
    pub(super) learning_rate: f64,
}

impl TrainSettings {
    /// Returns the default settings of an architecture.
    pub fn new(modality: Modality, architecture: Architecture, seed: u64) -> Self {
        Self {
            modality,
            architecture,
            seed,
            pretrain_epochs: 30,
            contact_epochs: 0,
            epochs: 30,
            batch_size: 16,
            learning_rate: 3e-4,
            warm_up_steps: 100,
            weight_decay: 0.01,
            dropout: 0.2,
            patience: 0,
            augmentation: Augmentation::DEFAULT,
            shuffle_buffer: 1 << 30,
            cameras: None,
            fine_tuning: None,
        }
    }

    /// Returns these settings with the encoders of camera images of a model.
    #[must_use]
    pub fn with_cameras(self, source: &StartModel) -> Self {
        Self {
            cameras: Some(SourceModel {
                name: source.contract().name.clone(),
                sha256: source.sha256().to_owned(),
            }),
            ..self
        }
    }

    /// Returns these settings for fine-tuning a model, which gives modality and architecture.
    #[must_use]
    pub fn fine_tuning(self, start: &StartModel, unfreeze_epochs: u32) -> Self {
        Self {
            modality: start.contract().modality,
            architecture: start.architecture().clone(),
            warm_up_steps: WARM_UP_STEPS,
            fine_tuning: Some(FineTuning {
                start_sha256: start.sha256().to_owned(),
                unfreeze_epochs,
            }),
            ..self
        }
    }

    /// Augmentation that suits the inputs: a gripper rotated by 180° has no camera images, which only
    /// a network that also predicts from touch alone can use.
    pub(super) fn augmentation(&self) -> Augmentation {
        let heads = self.architecture.heads(self.modality);
        Augmentation {
            rotate_180: self.augmentation.rotate_180 && heads.contains(&Modality::T),
            ..self.augmentation
        }
    }

    /// Inputs of the encoders that learn the geometry; none without one.
    pub(super) fn geometry_inputs(&self) -> Option<Modality> {
        let cameras = self.modality.cameras();
        cameras.filter(|_| self.architecture.geometry)
    }

    /// Number of epochs that learn the geometry.
    fn geometry_epochs(&self) -> u32 {
        match self.geometry_inputs() {
            Some(_) if self.fine_tuning.is_none() => self.pretrain_epochs,
            _ => 0,
        }
    }

    /// Number of epochs that learn the contact maps.
    pub(super) fn contact_epochs(&self) -> u32 {
        let is_learned = self.modality.has_touch() && self.architecture.has_contact();
        match self.fine_tuning {
            None if is_learned => self.contact_epochs,
            _ => 0,
        }
    }

    /// Number of epochs that learn from the labels: without touch one, as the heads that read the
    /// extents are fitted in each.
    fn label_epochs(&self) -> u32 {
        let is_trained = self.modality.has_touch() || self.fine_tuning.is_some();
        match self.geometry_inputs() {
            Some(_) if !is_trained => 1,
            _ => self.epochs,
        }
    }

    /// The settings for a training split with or without known extents: without them, or epochs
    /// that learn them, the network has no geometry unless its cameras are those of a model.
    pub(super) fn for_geometry(self, is_known: bool) -> Self {
        let pretrain_epochs = if is_known { self.pretrain_epochs } else { 0 };
        let is_learned = pretrain_epochs > 0 || self.cameras.is_some();
        let architecture = match self.architecture.geometry && !is_learned {
            true => self.architecture.without_geometry(),
            false => self.architecture,
        };
        Self {
            pretrain_epochs,
            architecture,
            ..self
        }
    }

    /// The settings for a training split with or without known displacement of the gels' faces.
    pub(super) fn for_contact(self, is_known: bool) -> Self {
        let contact_epochs = if is_known { self.contact_epochs } else { 0 };
        Self {
            contact_epochs,
            ..self
        }
    }

    /// Number of epochs of all phases.
    pub fn total_epochs(&self) -> u32 {
        let unfrozen = self.fine_tuning.as_ref().map_or(0, |f| f.unfreeze_epochs);
        let pretrained = self.geometry_epochs().saturating_add(self.contact_epochs());
        let trained = pretrained.saturating_add(self.label_epochs());
        trained.saturating_add(unfrozen)
    }

    /// Returns the phase of an epoch, from 0.
    pub(super) fn phase(&self, epoch: u32) -> Phase {
        let pretrain = self.geometry_epochs();
        let pretrained = pretrain.saturating_add(self.contact_epochs());
        let first = Phase {
            scope: match self.geometry_inputs() {
                Some(_) => Scope::Touch,
                None => Scope::All,
            },
            first: pretrained,
            epochs: self.label_epochs(),
            learning_rate: self.learning_rate,
        };
        match &self.fine_tuning {
            None if epoch < pretrain => Phase {
                scope: Scope::Geometry,
                first: 0,
                epochs: pretrain,
                learning_rate: PRETRAIN_RATE * self.learning_rate,
            },
            None if epoch < pretrained => Phase {
                scope: Scope::Contact,
                first: pretrain,
                epochs: self.contact_epochs(),
                learning_rate: PRETRAIN_RATE * self.learning_rate,
            },
            None => first,
            Some(_) if epoch < self.epochs => Phase {
                scope: Scope::Head,
                ..first
            },
            Some(fine_tuning) => Phase {
                scope: Scope::FixedStats,
                first: self.epochs,
                epochs: fine_tuning.unfreeze_epochs,
                learning_rate: UNFROZEN_RATE * self.learning_rate,
            },
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
