//! How a network does on a part of a dataset.

use super::augment::{Augmentation, InputWriter};
use super::batches::Batches;
use super::metrics::{Scored, auroc, log_loss, probability_of_logit};
use super::samples::Samples;
use super::settings::TrainSettings;
use gripcast_base::error::Result;
use gripcast_nn::Network;
use gripcast_nn::predict::contract::RgbNormalisation;

/// Bytes of images that are kept; samples are looked at in their order.
const MEMORY: usize = 1 << 25;
/// Samples of a batch.
const BATCH: usize = 32;

/// A sample's logit and label.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Logit {
    /// Log-odds that the grasp is stable.
    pub logit: f64,
    /// Whether it was.
    pub is_stable: bool,
}

impl Logit {
    /// Its probability at a temperature.
    pub fn scored(self, temperature: f64) -> Scored {
        Scored {
            p_stable: probability_of_logit(self.logit, temperature),
            stable: self.is_stable,
        }
    }
}

/// Logits of all samples of a part, in their order.
///
/// # Errors
/// Those of reading and decoding.
pub fn logits(
    network: &Network,
    samples: &Samples,
    settings: &TrainSettings,
    normalisation: RgbNormalisation,
    on_progress: &dyn Fn(usize),
) -> Result<Vec<Logit>> {
    let writer = InputWriter::new(Augmentation::NONE, normalisation);
    let mut batches = Batches::new(samples, settings.variant, writer, MEMORY);
    let all: Vec<usize> = (0..samples.facts().len()).collect();
    let mut found = Vec::with_capacity(all.len());
    for some in all.chunks(BATCH) {
        let batch = batches.batch(some, None)?;
        let logits = network.logits(&batch);
        found.extend(some.iter().zip(logits).map(|(at, logit)| Logit {
            logit: f64::from(logit),
            is_stable: samples.facts()[*at].is_stable,
        }));
        on_progress(found.len());
    }
    Ok(found)
}

/// What checkpoints are compared by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Scores {
    /// Mean loss of balanced labels, nats.
    pub(super) loss: f64,
    /// Balanced accuracy at a probability of one half.
    pub(super) accuracy: f64,
    pub(super) auroc: Option<f64>,
}

impl Scores {
    pub(super) fn of(logits: &[Logit]) -> Self {
        let of_label = |label: bool| -> Vec<Logit> {
            let of = logits.iter().copied();
            of.filter(|found| found.is_stable == label).collect()
        };
        let [lost, stable] = [of_label(false), of_label(true)];
        let right = |of: &[Logit]| {
            let right = of
                .iter()
                .filter(|found| (found.logit >= 0.0) == found.is_stable);
            right.count() as f64 / of.len().max(1) as f64
        };
        let scored = |of: &[Logit]| -> Vec<Scored> { of.iter().map(|x| x.scored(1.0)).collect() };
        let loss = |of: &[Logit]| log_loss(&scored(of)).unwrap_or(f64::NAN);
        Self {
            loss: 0.5 * (loss(&lost) + loss(&stable)),
            accuracy: 0.5 * (right(&lost) + right(&stable)),
            auroc: auroc(&scored(logits)),
        }
    }
}
