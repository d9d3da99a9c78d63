//! Validation of a network on a split.

use super::augment::{Augmentation, InputWriter};
use super::batches::Batches;
use super::metrics::{Scored, auroc, log_loss, probability_of_logit};
use super::samples::Samples;
use super::settings::TrainSettings;
use gripcast_base::error::Result;
use gripcast_nn::predict::contract::{
    CONTACT_SHAPE, GEOMETRY, GEOMETRY_UNIT_M, InputName, Modality, RgbNormalisation,
};
use gripcast_nn::predict::grasp_head::{GEL_FEATURES, gel_features};
use gripcast_nn::{ExtentHead, Network, extent_units};

/// Cached bytes of images; samples are read in order.
const MEMORY: usize = 1 << 25;
const BATCH_SIZE: usize = 32;
/// Numbers of a contact map.
const CONTACT: usize = CONTACT_SHAPE[1] as usize;

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

/// Predictions of all samples of a split, in order.
#[derive(Clone, Debug, PartialEq)]
pub struct SplitLogits {
    /// The sets of inputs that the network predicts from, all of its inputs first.
    heads: Vec<Modality>,
    /// Logits by head and sample, also where a sample lacks inputs.
    logits: Vec<Vec<Logit>>,
    /// Inputs that each sample has.
    available: Vec<Modality>,
    /// Extents as the encoders estimate them, [`GEOMETRY`] numbers in units of 0.03 m per sample, by
    /// input.
    extents: Vec<(InputName, Vec<f32>)>,
    /// Features of both gels' contact maps by sample; empty if the network does not read them.
    gels: Vec<[f64; GEL_FEATURES]>,
    /// Mean absolute error of the geometry, m; none where it is unknown.
    pub geometry_error_m: Option<f64>,
}

impl SplitLogits {
    /// The largest set of inputs that all samples have; none if no prediction can be made for all.
    pub fn complete(&self) -> Option<Modality> {
        let has_all = |head: &Modality| self.available.iter().all(|a| a.includes(*head));
        self.heads.iter().copied().find(has_all)
    }

    /// Logits of all samples from some inputs; empty if a sample lacks one or the network does not
    /// predict from them.
    pub fn of(&self, inputs: Modality) -> &[Logit] {
        let is_complete = self.available.iter().all(|a| a.includes(inputs));
        let index = self.heads.iter().position(|head| *head == inputs);
        let logits = index.filter(|_| is_complete).map(|at| &self.logits[at][..]);
        logits.unwrap_or_default()
    }

    /// Logits of all samples from some inputs, also where a sample lacks one; empty if the network
    /// does not predict from them.
    pub(super) fn all_of(&self, inputs: Modality) -> &[Logit] {
        let index = self.heads.iter().position(|head| *head == inputs);
        index.map_or(&[], |at| &self.logits[at])
    }

    /// Index and [extent units](extent_units) of the camera images, in the order of the inputs, of
    /// each sample that has these inputs; none if the network does not estimate extents from them.
    pub(super) fn units_of(&self, inputs: Modality) -> Option<Vec<(usize, Vec<f64>)>> {
        inputs.cameras()?;
        let extents = self.extents_of(inputs)?;
        let units = |sample: usize| {
            let of = extents.iter().map(|all| &all[sample * GEOMETRY..]);
            of.flat_map(extent_units).collect()
        };
        let samples = self.samples_with(inputs);
        Some(samples.map(|sample| (sample, units(sample))).collect())
    }

    /// Index and features of the grasp head of each sample that has these inputs, which include touch;
    /// none if the network does not read them.
    pub(super) fn readings_of(&self, inputs: Modality) -> Option<Vec<(usize, Vec<f64>)>> {
        if self.gels.is_empty() || !inputs.has_touch() {
            return None;
        }
        let extents = self.extents_of(inputs)?;
        let features = |sample: usize| {
            let of = extents.iter();
            let of = of.flat_map(|all| &all[sample * GEOMETRY..][..GEOMETRY]);
            let gels = self.gels[sample].into_iter();
            gels.chain(of.copied().map(f64::from)).collect()
        };
        let samples = self.samples_with(inputs);
        Some(samples.map(|sample| (sample, features(sample))).collect())
    }

    /// Extents of all samples by camera image, in the order of the inputs; none if the network does not
    /// estimate extents from one of them.
    fn extents_of(&self, inputs: Modality) -> Option<Vec<&[f32]>> {
        let cameras = inputs.cameras().map_or_else(Vec::new, Modality::inputs);
        let extents = cameras.into_iter().map(|camera| {
            let mut all = self.extents.iter();
            let found = all.find(|(of, _)| *of == camera);
            found.map(|(_, values)| &values[..])
        });
        extents.collect()
    }

    /// Indices of the samples that have these inputs.
    fn samples_with(&self, inputs: Modality) -> impl Iterator<Item = usize> {
        let samples = self.available.iter().enumerate();
        samples
            .filter(move |(_, available)| available.includes(inputs))
            .map(|(sample, _)| sample)
    }

    /// Changes the log-odds of a sample from some inputs.
    pub(super) fn update(&mut self, inputs: Modality, sample: usize, f: impl Fn(f64) -> f64) {
        if let Some(at) = self.heads.iter().position(|head| *head == inputs) {
            let logit = &mut self.logits[at][sample].logit;
            *logit = f(*logit);
        }
    }

    /// Computes the predictions from touch alone again, after its encoder was trained.
    ///
    /// # Errors
    /// Errors of reading and decoding.
    pub(super) fn update_touch(
        &mut self,
        network: &Network,
        samples: &Samples,
        on_progress: &dyn Fn(usize),
    ) -> Result<()> {
        let Some(touch) = self.heads.iter().position(|head| *head == Modality::T) else {
            return Ok(());
        };
        let writer = InputWriter::new(Augmentation::NONE, RgbNormalisation::NONE);
        let mut batches = Batches::new(samples, Modality::T, writer, MEMORY);
        let all: Vec<usize> = (0..self.available.len()).collect();
        for indices in all.chunks(BATCH_SIZE) {
            let found = network.touch_logits(&batches.batch(indices, None)?);
            for (index, logit) in indices.iter().zip(found) {
                self.logits[touch][*index].logit = f64::from(logit);
            }
            on_progress(indices.last().map_or(0, |last| last + 1));
        }
        Ok(())
    }

    /// Computes the predictions of a head that reads the extents of the object.
    pub(super) fn set_extent_head(&mut self, inputs: Modality, head: &ExtentHead) {
        let touch = self.all_of(Modality::T).to_vec();
        let at = self.heads.iter().position(|known| *known == inputs);
        let (Some(at), Some(units)) = (at, self.units_of(inputs)) else {
            return;
        };
        for (sample, units) in units {
            let terms = units.iter().zip(&head.units);
            let mut logit = head.bias + terms.map(|(unit, weight)| unit * weight).sum::<f64>();
            if inputs.has_touch() {
                logit += touch.get(sample).map_or(0.0, |x| head.touch * x.logit);
            }
            self.logits[at][sample].logit = logit;
        }
    }

    /// Logits of all samples from the [complete](Self::complete) inputs.
    pub fn best(&self) -> &[Logit] {
        self.complete().map_or(&[], |inputs| self.of(inputs))
    }
}

/// Computes the predictions of all samples of a split.
///
/// # Errors
/// Errors of reading and decoding.
pub fn logits(
    network: &Network,
    samples: &Samples,
    settings: &TrainSettings,
    normalisation: RgbNormalisation,
    on_progress: &dyn Fn(usize),
) -> Result<SplitLogits> {
    let writer = InputWriter::new(Augmentation::NONE, normalisation);
    let mut batches = Batches::new(samples, settings.modality, writer, MEMORY);
    let all: Vec<usize> = (0..samples.facts().len()).collect();
    let heads: Vec<Modality> = network.heads().collect();
    let mut logits = vec![Vec::with_capacity(all.len()); heads.len()];
    let mut available = Vec::with_capacity(all.len());
    let mut extents: Vec<(InputName, Vec<f32>)> = Vec::new();
    let mut gels = Vec::new();
    let (mut error, mut known) = (0.0, 0_usize);
    for indices in all.chunks(BATCH_SIZE) {
        let batch = batches.batch(indices, None)?;
        let outputs = network.outputs(&batch);
        for (all, head) in logits.iter_mut().zip(outputs.logits) {
            all.extend(indices.iter().zip(head).map(|(i, logit)| Logit {
                logit: f64::from(logit),
                is_stable: samples.facts()[*i].is_stable,
            }));
        }
        if let Some((_, found)) = outputs.geometry.last() {
            let pairs = found.iter().zip(&batch.geometry);
            for (found, truth) in pairs.filter(|(_, truth)| truth.is_finite()) {
                error += f64::from((found - truth).abs()) * GEOMETRY_UNIT_M;
                known += 1;
            }
        }
        for (input, found) in outputs.geometry {
            match extents.iter_mut().find(|(of, _)| *of == input) {
                Some((_, all)) => all.extend(found),
                None => extents.push((input, found)),
            }
        }
        let (left, right) = outputs.contact.split_at(outputs.contact.len() / 2);
        let maps = left.chunks_exact(CONTACT).zip(right.chunks_exact(CONTACT));
        gels.extend(maps.map(|(left, right)| gel_features([left, right])));
        available.extend(batch.available);
        on_progress(available.len());
    }
    Ok(SplitLogits {
        heads,
        logits,
        available,
        extents,
        gels,
        geometry_error_m: (known > 0).then(|| error / known as f64),
    })
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
