//! Data of a training step, and what a network says of it.

use super::architecture::EncoderKind;
use crate::predict::contract::{InputName, Modality};

/// Images of a batch, f32 HWC, concatenated; empty for a modality that the classifier lacks.
#[derive(Clone, Debug, Default)]
pub struct Batch {
    /// All left tactile differences, then all right ones.
    pub touch: Vec<f32>,
    /// Colour images.
    pub vision: Vec<f32>,
    /// Depth images as points.
    pub depth: Vec<f32>,
    /// Inputs of each sample that are valid; empty if all are.
    pub available: Vec<Modality>,
    /// Geometry of each sample, [`GEOMETRY`](super::GEOMETRY) values in units of 0.03 m, NaN where unknown; empty if
    /// no sample has one.
    pub geometry: Vec<f32>,
    /// Contact maps of the tactile differences in their order, cells by row and column with
    /// [`CONTACT_CHANNELS`](super::CONTACT_CHANNELS) values each, NaN where unknown; empty if no sample has one.
    pub contact: Vec<f32>,
    /// Target: 1 stable, 0 slip.
    pub targets: Vec<f32>,
    /// Weight of each sample's loss.
    pub weights: Vec<f32>,
}

impl Batch {
    /// Images of an encoder.
    pub(super) fn images(&self, kind: EncoderKind) -> &[f32] {
        match kind {
            EncoderKind::Touch => &self.touch,
            EncoderKind::Vision => &self.vision,
            EncoderKind::Depth => &self.depth,
        }
    }

    pub(super) fn has(&self, sample: usize, inputs: Modality) -> bool {
        let available = self.available.get(sample);
        available.is_none_or(|available| available.includes(inputs))
    }

    /// Weights of the samples in the loss of the predictions from `inputs`; sum 1, or 0 without
    /// samples that have these inputs.
    pub(super) fn weights_of(&self, inputs: Modality) -> Vec<f64> {
        let weights = self.weights.iter().enumerate();
        let weights = weights.map(|(i, weight)| match self.has(i, inputs) {
            true => f64::from(*weight),
            false => 0.0,
        });
        let weights: Vec<f64> = weights.collect();
        let total: f64 = weights.iter().sum();
        let scale = if total > 0.0 { 1.0 / total } else { 0.0 };
        weights.into_iter().map(|weight| weight * scale).collect()
    }
}

/// Outputs of the network for a batch.
#[derive(Clone, Debug, PartialEq)]
pub struct Outputs {
    /// Logits of the samples for each of [`Network::heads`](super::Network::heads).
    pub logits: Vec<Vec<f32>>,
    /// Geometry of the samples, [`GEOMETRY`](super::GEOMETRY) values of each in units of 0.03 m, by the input it is
    /// read from.
    pub geometry: Vec<(InputName, Vec<f32>)>,
    /// Contact maps of the tactile differences in their order, planes of cells by channel; empty if
    /// the network does not read them.
    pub contact: Vec<f32>,
}
