//! Losses of geometry and contact maps, and the weights of all losses.

use super::{EncoderPass, Network, Scope, backward_linear, linear};
use crate::architecture::{EncoderKind, GEOMETRY, Param};
use crate::batch::Batch;
use crate::predict::contract::{CONTACT_CELLS, CONTACT_CHANNELS, Modality};

/// Weight of the predictions from all inputs in the loss; those from fewer share the rest.
const FULL_WEIGHT: f64 = 0.5;
/// Weight of the geometry's smooth L1 loss relative to the cross entropy, with errors in 0.03 m.
const GEOMETRY_WEIGHT: f64 = 3.0;
/// Error of a geometry value at which its loss becomes linear, 0.03 m: the ends of long objects are
/// out of view.
const GEOMETRY_KNEE: f64 = 0.5;

/// Weight of the contact maps' smooth L1 loss relative to the cross entropy.
const CONTACT_WEIGHT: f64 = 1.0;
/// Error of a contact map's value at which its loss becomes linear.
const CONTACT_KNEE: f64 = 0.5;

impl Network {
    /// Passes of the encoders that estimate the geometry.
    pub(super) fn geometry_passes<'a>(
        &'a self,
        passes: &'a [EncoderPass],
    ) -> impl Iterator<Item = (EncoderKind, &'a EncoderPass)> {
        let encoders = self.layout.encoders.iter().map(|encoder| encoder.kind);
        let reads = |kind: &EncoderKind| self.architecture.geometry && *kind != EncoderKind::Touch;
        encoders.zip(passes).filter(move |(kind, _)| reads(kind))
    }

    /// Adds the gradient of the geometry's loss to those of the embeddings; returns the loss.
    pub(super) fn geometry_loss(
        &self,
        batch: &Batch,
        passes: &[EncoderPass],
        scope: Scope,
        dembeddings: &mut [Vec<f32>],
    ) -> f64 {
        let mut loss = 0.0;
        for (encoder, (pass, gradient)) in self
            .layout
            .encoders
            .iter()
            .zip(passes.iter().zip(dembeddings))
        {
            let kind = encoder.kind;
            if kind == EncoderKind::Touch || !self.architecture.geometry || !scope.trains(kind) {
                continue;
            }
            let input = Modality::of(|name| kind.inputs().contains(&name));
            let width = self.embedding(kind);
            let known: Vec<bool> = batch
                .geometry
                .chunks_exact(GEOMETRY)
                .enumerate()
                .map(|(i, values)| {
                    input.is_none_or(|input| batch.has(i, input))
                        && values.iter().all(|x| x.is_finite())
                })
                .collect();
            let count = known.iter().filter(|known| **known).count() * GEOMETRY;
            let scale = GEOMETRY_WEIGHT / count.max(1) as f64;
            let rows = pass.embedding.chunks_exact(width);
            let rows = rows.zip(gradient.chunks_exact_mut(width));
            let targets = batch.geometry.chunks_exact(GEOMETRY).zip(known);
            for ((row, gradient), (target, _)) in rows.zip(targets).filter(|(_, (_, known))| *known)
            {
                for ((gradient, found), target) in gradient.iter_mut().zip(row).zip(target) {
                    let [value, slope] = smooth_l1(f64::from(found - target), GEOMETRY_KNEE);
                    loss += scale * value;
                    *gradient += (scale * slope) as f32;
                }
            }
        }
        loss
    }

    /// Loss of the contact maps, and its gradient with respect to the last output of the touch
    /// encoder; empty without maps. Adds the gradient of what reads them.
    pub(super) fn contact_loss(
        &self,
        batch: &Batch,
        passes: &[EncoderPass],
        scope: Scope,
        gradient: &mut [f32],
    ) -> (f64, Vec<f32>) {
        let layer = self.contact_layer(passes);
        let layer = layer.filter(|_| scope.trains_contact());
        let known = batch.contact.iter().filter(|x| x.is_finite()).count();
        let (Some(([weight, bias], last)), 1..) = (layer, known) else {
            return (0.0, Vec::new());
        };
        let found = linear(last, self.values(weight), self.values(bias), false);
        let scale = CONTACT_WEIGHT / known as f64;
        let mut loss = 0.0;
        let slopes = found.iter().zip(&batch.contact).map(|(found, target)| {
            if !target.is_finite() {
                return 0.0;
            }
            let [value, slope] = smooth_l1(f64::from(found - target), CONTACT_KNEE);
            loss += scale * value;
            (scale * slope) as f32
        });
        let slopes: Vec<f32> = slopes.collect();
        let dlast = backward_linear(last, &slopes, self, weight, bias, gradient);
        (loss, dlast)
    }

    /// What reads the contact maps, and what it reads: the last output of the touch encoder.
    fn contact_layer<'a>(
        &'a self,
        passes: &'a [EncoderPass],
    ) -> Option<(&'a [Param; 2], &'a [f32])> {
        let encoders = self.layout.encoders.iter().zip(passes);
        let mut touch = encoders.filter(|(encoder, _)| encoder.kind == EncoderKind::Touch);
        let (_, pass) = touch.next()?;
        Some((self.layout.contact.as_ref()?, pass.a.last()?))
    }

    /// Contact maps of all tactile differences, planes of cells by channel; empty without what reads
    /// them.
    pub(super) fn contact_maps(&self, passes: &[EncoderPass]) -> Vec<f32> {
        let Some(([weight, bias], last)) = self.contact_layer(passes) else {
            return Vec::new();
        };
        let found = linear(last, self.values(weight), self.values(bias), false);
        let cells: usize = CONTACT_CELLS.iter().product();
        let maps = found.chunks_exact(cells * CONTACT_CHANNELS);
        maps.flat_map(|map| {
            let planes = (0..CONTACT_CHANNELS).map(move |channel| &map[channel..]);
            planes.flat_map(|plane| plane.iter().step_by(CONTACT_CHANNELS).copied())
        })
        .collect()
    }
}

/// Smooth L1 loss of an error and its slope: linear from `knee` on.
fn smooth_l1(error: f64, knee: f64) -> [f64; 2] {
    if error.abs() < knee {
        [0.5 * error * error / knee, error / knee]
    } else {
        [error.abs() - 0.5 * knee, error.signum()]
    }
}

/// Weight of a head's loss; the weights of all have the sum 1.
pub(super) fn head_weight(index: usize, count: usize) -> f64 {
    match (index, count) {
        (_, 1) => 1.0,
        (0, _) => FULL_WEIGHT,
        (_, count) => (1.0 - FULL_WEIGHT) / (count - 1) as f64,
    }
}
