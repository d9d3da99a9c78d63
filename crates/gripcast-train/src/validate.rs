//! Validation of a network on a split.

use super::augment::{Augmentation, InputWriter};
use super::batches::Batches;
use super::metrics::{Scored, auroc, log_loss, probability_of_logit};
use super::samples::Samples;
use super::settings::TrainSettings;
use gripcast_base::error::Result;
use gripcast_nn::Network;
use gripcast_nn::predict::contract::RgbNormalisation;

/// Cached bytes of images; samples are read in order.
const MEMORY: usize = 1 << 25;
const BATCH_SIZE: usize = 32;

/// Logit and label of a sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Logit {
    /// Log-odds that the grasp is stable.
    pub logit: f64,
    /// Label.
    pub is_stable: bool,
}

impl Logit {
    /// Returns the prediction at a temperature.
    pub fn scored(self, temperature: f64) -> Scored {
        Scored {
            p_stable: probability_of_logit(self.logit, temperature),
            stable: self.is_stable,
        }
    }
}

/// Computes the logits of all samples of a split, in order.
///
/// # Errors
/// Errors of reading and decoding.
pub fn logits(
    network: &Network,
    samples: &Samples,
    settings: &TrainSettings,
    normalisation: RgbNormalisation,
    on_progress: &dyn Fn(usize),
) -> Result<Vec<Logit>> {
    let writer = InputWriter::new(Augmentation::NONE, normalisation);
    let mut batches = Batches::new(samples, settings.modality, writer, MEMORY);
    let all: Vec<usize> = (0..samples.facts().len()).collect();
    let mut logits = Vec::with_capacity(all.len());
    for indices in all.chunks(BATCH_SIZE) {
        let batch = batches.batch(indices, None)?;
        let outputs = network.logits(&batch);
        logits.extend(indices.iter().zip(outputs).map(|(i, logit)| Logit {
            logit: f64::from(logit),
            is_stable: samples.facts()[*i].is_stable,
        }));
        on_progress(logits.len());
    }
    Ok(logits)
}

/// Validation scores of a checkpoint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Scores {
    /// Class-balanced mean loss, nats.
    pub(super) loss: f64,
    /// Balanced accuracy at a probability of 0.5.
    pub(super) accuracy: f64,
    pub(super) auroc: Option<f64>,
}

impl Scores {
    pub(super) fn new(logits: &[Logit]) -> Self {
        let with_label = |label: bool| -> Vec<Logit> {
            let logits = logits.iter().copied();
            logits.filter(|logit| logit.is_stable == label).collect()
        };
        let [slip, stable] = [with_label(false), with_label(true)];
        let recall = |logits: &[Logit]| {
            let correct = logits.iter().filter(|x| (x.logit >= 0.0) == x.is_stable);
            correct.count() as f64 / logits.len().max(1) as f64
        };
        let scored = |x: &[Logit]| -> Vec<Scored> { x.iter().map(|x| x.scored(1.0)).collect() };
        let loss = |x: &[Logit]| log_loss(&scored(x)).unwrap_or(f64::NAN);
        Self {
            loss: 0.5 * (loss(&slip) + loss(&stable)),
            accuracy: 0.5 * (recall(&slip) + recall(&stable)),
            auroc: auroc(&scored(logits)),
        }
    }
}
