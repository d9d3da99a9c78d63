//! The classifier network: forward pass, backward pass, training step.

mod losses;
mod scope;

use rayon::prelude::*;

use super::architecture::{
    Architecture, EncoderKind, EncoderParams, GEOMETRY, HeadParams, IMAGE, Layout, Param,
};
use super::batch::{Batch, Outputs};
use super::batch_norm::{self, ChannelStats};
use super::conv::{self, ConvShape, Scratch};
use super::product::{Finish, Packed};
use crate::predict::contract::Modality;
use gripcast_base::error::{Error, Result};
use losses::head_weight;

pub use scope::{Scope, Step};

/// Minimum momentum of the running statistics.
const MOMENTUM: f32 = 0.1;
/// Number of groups of a batch with separate gradient sums, so that sums do not depend on the
/// number of threads.
const GROUPS: usize = 8;

/// The network with its parameters and running statistics.
#[derive(Clone, Debug)]
pub struct Network {
    shapes: Vec<ConvShape>,
    architecture: Architecture,
    layout: Layout,
    modality: Modality,
    /// All parameters, by [`Layout`].
    pub parameters: Vec<f32>,
    /// Running means and variances of the convolutions' channels (batch normalisation).
    pub running_stats: Vec<f32>,
    workspace: Workspace,
}

/// Buffers reused between steps, which saves a sixth of the time.
#[derive(Debug, Default)]
struct Workspace {
    passes: Vec<EncoderPass>,
    /// Gradients of a layer's output and input.
    gradients: [Vec<f32>; 2],
}

impl Clone for Workspace {
    /// Returns empty buffers.
    fn clone(&self) -> Self {
        Self::default()
    }
}

/// Forward values of an encoder, kept for the backward pass.
#[derive(Debug, Default)]
struct EncoderPass {
    /// After each convolution, before normalisation.
    z: Vec<Vec<f32>>,
    /// After ReLU.
    a: Vec<Vec<f32>>,
    stats: Vec<ChannelStats>,
    pooled: Vec<f32>,
    embedding: Vec<f32>,
}

impl Network {
    /// Initialises a network with `uniform` numbers from [0, 1): weights uniform within
    /// ±√(6/fan-in) before a ReLU (He et al., 2015) and ±√(3/fan-in) elsewhere, γ = 1, others 0.
    pub fn new(
        architecture: &Architecture,
        modality: Modality,
        mut uniform: impl FnMut() -> f64,
    ) -> Self {
        let layout = Layout::new(architecture, modality);
        let mut parameters = vec![0.0; layout.len()];
        for param in layout.params() {
            let values = &mut parameters[param.range()];
            if param.name.ends_with("gamma") {
                values.fill(1.0);
            } else if param.is_weight() {
                let is_linear = param.name.contains("projection") || param.name.contains("logit");
                let gain = if is_linear { 3.0 } else { 6.0 };
                let bound = (gain / param.shape[0] as f64).sqrt();
                values.fill_with(|| ((2.0 * uniform() - 1.0) * bound) as f32);
            }
        }
        let mut running_stats = vec![0.0; layout.running_stats_len()];
        for encoder in &layout.encoders {
            for [_, variance] in &encoder.stats {
                running_stats[variance.clone()].fill(1.0);
            }
        }
        Self {
            shapes: architecture.shapes(),
            architecture: architecture.clone(),
            layout,
            modality,
            parameters,
            running_stats,
            workspace: Workspace::default(),
        }
    }

    /// Copies the encoders of camera images of another network, with their statistics.
    ///
    /// # Errors
    /// `Input`: it lacks one of them, does not estimate the geometry with it, or has other shapes.
    pub fn copy_cameras(&mut self, from: &Self) -> Result<()> {
        for encoder in &self.layout.encoders {
            let kind = encoder.kind;
            let what = match kind {
                EncoderKind::Touch => continue,
                EncoderKind::Vision => "colour",
                EncoderKind::Depth => "depth",
            };
            let source = from.encoder(kind).filter(|_| from.architecture.geometry);
            let source = source.ok_or_else(|| {
                Error::input(format!(
                    "it has no encoder of {what} images that estimates the extents of the object"
                ))
            })?;
            let pairs = || encoder.params().zip(source.params());
            if pairs().any(|(to, from)| to.shape != from.shape) {
                let what = format!("its encoder of {what} images has other layers");
                return Err(Error::input(what));
            }
            for (to, source) in pairs() {
                self.parameters[to.range()].copy_from_slice(from.values(source));
            }
            let stats = encoder.stats.iter().zip(&source.stats);
            for (to, source) in stats.flat_map(|(to, source)| to.iter().zip(source)) {
                self.running_stats[to.clone()].copy_from_slice(&from.running_stats[source.clone()]);
            }
        }
        Ok(())
    }

    /// Layout of the parameters.
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Values of a parameter tensor.
    pub(crate) fn values(&self, param: &Param) -> &[f32] {
        &self.parameters[param.range()]
    }

    /// Shapes of an encoder's convolutions.
    pub(crate) fn shapes(&self) -> &[ConvShape] {
        &self.shapes
    }

    /// Architecture of the network.
    pub fn architecture(&self) -> &Architecture {
        &self.architecture
    }

    /// Modality of the network.
    pub fn modality(&self) -> Modality {
        self.modality
    }

    /// Sets of inputs that the network predicts from, all of its inputs first.
    pub fn heads(&self) -> impl ExactSizeIterator<Item = Modality> + '_ {
        self.layout.heads.iter().map(|head| head.modality)
    }

    fn encoder(&self, kind: EncoderKind) -> Option<&EncoderParams> {
        let mut encoders = self.layout.encoders.iter();
        encoders.find(|encoder| encoder.kind == kind)
    }

    /// Weight and bias of an encoder's projection; none without that encoder.
    pub(crate) fn projection(&self, kind: EncoderKind) -> Option<&[Param; 2]> {
        self.encoder(kind).map(|params| &params.projection)
    }

    /// Weight (KH·KW·C × output channels) and bias of an encoder's convolutions with batch
    /// normalisation folded in; none without that encoder.
    pub(crate) fn folded(&self, kind: EncoderKind) -> Option<Vec<[Vec<f32>; 2]>> {
        let params = self.encoder(kind)?;
        let folded = params.convolutions.iter().zip(&params.stats);
        let folded = folded.map(|([weight, gamma, beta], ranges)| {
            let stats = self.running_channel_stats(ranges);
            let (scale, bias) = stats.scale_and_shift(self.values(gamma), self.values(beta));
            let rows = self.values(weight).chunks_exact(scale.len());
            let weight = rows.flat_map(|row| row.iter().zip(&scale).map(|(w, scale)| w * scale));
            [weight.collect(), bias]
        });
        Some(folded.collect())
    }

    /// Computes the outputs for a batch with the running statistics.
    pub fn outputs(&self, batch: &Batch) -> Outputs {
        let mut passes = Vec::new();
        self.forward(batch, Scope::FixedStats, &mut passes);
        let heads = self.layout.heads.iter();
        let logits = heads.map(|head| self.head_forward(head, &passes, None).logits);
        let geometry = self.geometry_passes(&passes).map(|(kind, pass)| {
            let rows = pass.embedding.chunks_exact(self.embedding(kind));
            let values = rows.flat_map(|row| &row[..GEOMETRY]).copied();
            (kind.inputs()[0], values.collect())
        });
        Outputs {
            logits: logits.collect(),
            geometry: geometry.collect(),
            contact: self.contact_maps(&passes),
        }
    }

    /// Computes the logits from touch alone with the running statistics; empty without a head that
    /// reads it alone.
    pub fn touch_logits(&self, batch: &Batch) -> Vec<f32> {
        let mut heads = self.layout.heads.iter();
        let Some(head) = heads.find(|head| head.modality == Modality::T) else {
            return Vec::new();
        };
        let encoders = self.layout.encoders.iter();
        let passes: Vec<EncoderPass> = encoders
            .map(|params| {
                let mut pass = EncoderPass::default();
                if params.kind == EncoderKind::Touch {
                    self.forward_encoder(params, &batch.touch, false, &mut pass);
                }
                pass
            })
            .collect();
        self.head_forward(head, &passes, None).logits
    }

    /// Runs forward and backward pass: returns the loss of a batch, adds the gradient of the
    /// parameters in the step's [`Scope`] to `gradient` and updates the running statistics if it
    /// includes them. The loss is the weighted mean binary cross entropy of all heads, nats, and
    /// the error of the geometry.
    pub fn train_step(&mut self, batch: &Batch, step: &Step, gradient: &mut [f32]) -> f64 {
        let mut workspace = std::mem::take(&mut self.workspace);
        let Workspace { passes, gradients } = &mut workspace;
        self.forward(batch, step.scope, passes);
        let mut dembeddings: Vec<Vec<f32>> = passes
            .iter()
            .map(|pass| vec![0.0; pass.embedding.len()])
            .collect();
        let mut loss = 0.0;
        let heads = self.layout.heads.iter();
        let heads: Vec<&HeadParams> = heads.filter(|head| step.scope.trains_head(head)).collect();
        for (index, params) in heads.iter().enumerate() {
            let scale = head_weight(index, heads.len());
            let head = self.head_forward(params, passes, Some(step));
            let weights = batch.weights_of(params.modality);
            let samples = head.logits.iter().zip(&batch.targets).zip(&weights);
            let dlogits: Vec<f32> = samples
                .map(|((logit, target), weight)| {
                    let (x, y) = (f64::from(*logit), f64::from(*target));
                    let weight = scale * weight;
                    // ln(1 + eˣ) − y·x without overflow.
                    loss += weight * (x.max(0.0) - x * y + (-x.abs()).exp().ln_1p());
                    (weight * (1.0 / (1.0 + (-x).exp()) - y)) as f32
                })
                .collect();
            let djoined = self.backward_head(params, &head, step, &dlogits, gradient);
            self.split_embeddings(params.modality, &djoined, &mut dembeddings);
        }
        loss += self.geometry_loss(batch, passes, step.scope, &mut dembeddings);
        let (of_contact, dcontact) = self.contact_loss(batch, passes, step.scope, gradient);
        loss += of_contact;
        let above = Above {
            embeddings: &dembeddings,
            contact: &dcontact,
        };
        self.backward_encoders(batch, passes, above, step.scope, gradients, gradient);
        self.update_running_stats(passes, step);
        self.workspace = workspace;
        loss
    }

    /// Adds the gradients of the encoders, given those of what reads them.
    fn backward_encoders(
        &self,
        batch: &Batch,
        passes: &[EncoderPass],
        above: Above<'_>,
        scope: Scope,
        buffers: &mut [Vec<f32>; 2],
        gradient: &mut [f32],
    ) {
        let encoders = self.layout.encoders.iter().zip(passes);
        for ((encoder, pass), dembedding) in encoders.zip(above.embeddings) {
            if !scope.trains(encoder.kind) {
                continue;
            }
            let images = batch.images(encoder.kind);
            let [weight, bias] = &encoder.projection;
            let dpooled = backward_linear(&pass.pooled, dembedding, self, weight, bias, gradient);
            self.unpool(&dpooled, &mut buffers[0]);
            if encoder.kind == EncoderKind::Touch {
                add(&mut buffers[0], above.contact);
            }
            self.backward_convolutions(encoder, pass, images, scope, buffers, gradient);
        }
    }

    /// Updates the running statistics of the encoders that normalise with those of the batch.
    fn update_running_stats(&mut self, passes: &[EncoderPass], step: &Step) {
        // The first steps average all batches: the initial statistics are arbitrary.
        let fraction = MOMENTUM.max(1.0 / (step.number + 1) as f32);
        let encoders = self.layout.encoders.clone();
        let passes = encoders.iter().zip(passes);
        for (encoder, pass) in passes.filter(|(encoder, _)| step.scope.is_of_batch(encoder.kind)) {
            for ([mean, variance], (stats, z)) in
                encoder.stats.iter().zip(pass.stats.iter().zip(&pass.z))
            {
                let count = (z.len() / stats.mean.len()) as f32;
                // Bessel's correction.
                let unbiased = count / (count - 1.0).max(1.0);
                let update = |running: &mut [f32], found: &[f32], factor: f32| {
                    for (running, found) in running.iter_mut().zip(found) {
                        *running += fraction * (found * factor - *running);
                    }
                };
                update(&mut self.running_stats[mean.clone()], &stats.mean, 1.0);
                update(
                    &mut self.running_stats[variance.clone()],
                    &stats.variance,
                    unbiased,
                );
            }
        }
    }

    fn running_channel_stats(&self, ranges: &[std::ops::Range<usize>; 2]) -> ChannelStats {
        let [mean, variance] = ranges
            .clone()
            .map(|range| self.running_stats[range].to_vec());
        ChannelStats { mean, variance }
    }

    fn forward(&self, batch: &Batch, scope: Scope, passes: &mut Vec<EncoderPass>) {
        let encoders = &self.layout.encoders;
        passes.resize_with(encoders.len(), EncoderPass::default);
        for (params, pass) in encoders.iter().zip(passes) {
            if scope.uses(params.kind) {
                let images = batch.images(params.kind);
                let is_of_batch = scope.is_of_batch(params.kind);
                self.forward_encoder(params, images, is_of_batch, pass);
            } else {
                *pass = EncoderPass::default();
            }
        }
    }

    fn forward_encoder(
        &self,
        params: &EncoderParams,
        images: &[f32],
        is_training: bool,
        pass: &mut EncoderPass,
    ) {
        let count = images.len() / IMAGE.iter().product::<usize>();
        pass.z.resize_with(self.shapes.len(), Vec::new);
        pass.a.resize_with(self.shapes.len(), Vec::new);
        pass.stats.clear();
        for (i, shape) in self.shapes.iter().enumerate() {
            let [weight, gamma, beta] = &params.convolutions[i];
            let mut packed = Packed::default();
            shape.pack(self.values(weight), &mut packed);
            let input: usize = shape.input.iter().product();
            let output: usize = shape.output().iter().product();
            let (before, after) = pass.a.split_at_mut(i);
            let x = before.last().map_or(images, |a| &a[..]);
            let (z, a) = (&mut pass.z[i], &mut after[0]);
            z.resize(count * output, 0.0);
            a.resize(count * output, 0.0);
            z.par_chunks_mut(output)
                .zip(x.par_chunks(input))
                .for_each_init(Scratch::default, |scratch, (z, x)| {
                    conv::forward(shape, x, &packed, z, Finish::default(), scratch);
                });
            let stats = if is_training {
                ChannelStats::from_images(z, output, shape.channels)
            } else {
                self.running_channel_stats(&params.stats[i])
            };
            let (scale, shift) = stats.scale_and_shift(self.values(gamma), self.values(beta));
            batch_norm::normalise(z, output, &scale, &shift, a);
            pass.stats.push(stats);
        }
        let last = pass.a.last().map_or(images, |a| &a[..]);
        pass.pooled = self.pool(last, count);
        let [weight, bias] = &params.projection;
        pass.embedding = linear(&pass.pooled, self.values(weight), self.values(bias), false);
    }

    /// Height, width and channels of the last convolution's output.
    fn last(&self) -> [usize; 3] {
        self.shapes.last().map_or(IMAGE, ConvShape::output)
    }

    /// Average pooling.
    fn pool(&self, a: &[f32], count: usize) -> Vec<f32> {
        let [_, width, channels] = self.last();
        let image: usize = self.last().iter().product();
        let [rows, columns, _] = self.architecture.pooled();
        let [tall, wide] = self.architecture.pool;
        let fraction = 1.0 / (tall * wide) as f32;
        let mut pooled = vec![0.0; count * rows * columns * channels];
        for (a, pooled) in a
            .chunks_exact(image)
            .zip(pooled.chunks_exact_mut(rows * columns * channels))
        {
            for (window, pooled) in pooled.chunks_exact_mut(channels).enumerate() {
                let (row, column) = (window / columns * tall, window % columns * wide);
                for y in row..row + tall {
                    let from = (y * width + column) * channels;
                    for pixel in a[from..from + wide * channels].chunks_exact(channels) {
                        for (pooled, a) in pooled.iter_mut().zip(pixel) {
                            *pooled += fraction * a;
                        }
                    }
                }
            }
        }
        pooled
    }

    /// Gradient of the last convolution's output.
    fn unpool(&self, dpooled: &[f32], d: &mut Vec<f32>) {
        let [_, width, channels] = self.last();
        let image: usize = self.last().iter().product();
        let [rows, columns, _] = self.architecture.pooled();
        let [tall, wide] = self.architecture.pool;
        let fraction = 1.0 / (tall * wide) as f32;
        let count = dpooled.len() / (rows * columns * channels);
        d.clear();
        d.resize(count * image, 0.0);
        for (d, dpooled) in d
            .chunks_exact_mut(image)
            .zip(dpooled.chunks_exact(rows * columns * channels))
        {
            for (window, dpooled) in dpooled.chunks_exact(channels).enumerate() {
                let (row, column) = (window / columns * tall, window % columns * wide);
                for y in row..row + tall {
                    let from = (y * width + column) * channels;
                    for pixel in d[from..from + wide * channels].chunks_exact_mut(channels) {
                        for (d, dpooled) in pixel.iter_mut().zip(dpooled) {
                            *d = fraction * dpooled;
                        }
                    }
                }
            }
        }
    }

    fn head_forward(
        &self,
        head: &HeadParams,
        passes: &[EncoderPass],
        step: Option<&Step>,
    ) -> HeadPass {
        let [weight, bias] = &head.hidden;
        let [last, last_bias] = &head.logit;
        let joined = self.join(head.modality, passes);
        let mut hidden = linear(&joined, self.values(weight), self.values(bias), true);
        let factors = step.map_or(&[][..], |step| step.dropout_of(&hidden));
        for (hidden, factor) in hidden.iter_mut().zip(factors) {
            *hidden *= factor;
        }
        let logits = linear(&hidden, self.values(last), self.values(last_bias), false);
        HeadPass {
            joined,
            hidden,
            logits,
        }
    }

    /// Size of an encoder's embedding.
    fn embedding(&self, kind: EncoderKind) -> usize {
        self.architecture.embedding_of(kind)
    }

    /// Index of the encoder and of the first row of each input in its embeddings, in units of
    /// samples, with the size of a row.
    fn rows(&self, inputs: Modality) -> impl Iterator<Item = (usize, usize, usize)> + '_ {
        let encoders = self.layout.encoders.iter().enumerate();
        encoders.flat_map(move |(index, encoder)| {
            let width = self.embedding(encoder.kind);
            let names = encoder.kind.inputs().iter().enumerate();
            let names = names.filter(move |(_, name)| inputs.has(**name));
            names.map(move |(block, _)| (index, block, width))
        })
    }

    /// Number of samples.
    fn count(&self, passes: &[EncoderPass]) -> usize {
        let first = self.layout.encoders.iter().zip(passes).next();
        first.map_or(0, |(encoder, pass)| {
            let rows = pass.embedding.len() / self.embedding(encoder.kind);
            rows / encoder.kind.inputs().len()
        })
    }

    /// Concatenates the embeddings of each sample: left, right, colour, depth.
    fn join(&self, inputs: Modality, passes: &[EncoderPass]) -> Vec<f32> {
        let count = self.count(passes);
        let mut joined = Vec::with_capacity(count * self.architecture.joined(inputs));
        for sample in 0..count {
            for (encoder, block, width) in self.rows(inputs) {
                let row = block * count + sample;
                joined.extend_from_slice(&passes[encoder].embedding[row * width..][..width]);
            }
        }
        joined
    }

    /// Adds the gradient of the concatenated embeddings to those of the encoders.
    fn split_embeddings(&self, inputs: Modality, djoined: &[f32], gradients: &mut [Vec<f32>]) {
        let size = self.architecture.joined(inputs);
        let count = djoined.len() / size;
        for (sample, of_sample) in djoined.chunks_exact(size).enumerate() {
            let mut first = 0;
            for (encoder, block, width) in self.rows(inputs) {
                let row = block * count + sample;
                let from = &of_sample[first..][..width];
                add(&mut gradients[encoder][row * width..][..width], from);
                first += width;
            }
        }
    }

    /// Gradient of the concatenated embeddings.
    fn backward_head(
        &self,
        params: &HeadParams,
        head: &HeadPass,
        step: &Step,
        dlogits: &[f32],
        gradient: &mut [f32],
    ) -> Vec<f32> {
        let [weight, bias] = &params.hidden;
        let [last, last_bias] = &params.logit;
        let mut dhidden = backward_linear(&head.hidden, dlogits, self, last, last_bias, gradient);
        for (d, hidden) in dhidden.iter_mut().zip(&head.hidden) {
            if *hidden <= 0.0 {
                *d = 0.0;
            }
        }
        for (d, factor) in dhidden.iter_mut().zip(step.dropout_of(&head.hidden)) {
            *d *= factor;
        }
        backward_linear(&head.joined, &dhidden, self, weight, bias, gradient)
    }

    /// Adds the gradients of an encoder's convolutions, given that of the last output.
    fn backward_convolutions(
        &self,
        params: &EncoderParams,
        pass: &EncoderPass,
        images: &[f32],
        scope: Scope,
        [d, dx]: &mut [Vec<f32>; 2],
        gradient: &mut [f32],
    ) {
        for (i, shape) in self.shapes.iter().enumerate().rev() {
            let [weight, gamma, beta] = &params.convolutions[i];
            let input: usize = shape.input.iter().product();
            let output: usize = shape.output().iter().product();
            let of_layer = batch_norm::Pass {
                z: &pass.z[i],
                a: &pass.a[i],
                image: output,
                stats: &pass.stats[i],
                is_of_batch: scope.is_of_batch(params.kind),
            };
            let [dgamma, dbeta] = batch_norm::backward(of_layer, self.values(gamma), d);
            add(&mut gradient[gamma.range()], &dgamma);
            add(&mut gradient[beta.range()], &dbeta);
            let x = if i == 0 { images } else { &pass.a[i - 1][..] };
            let count = x.len() / input;
            let group = count.div_ceil(GROUPS);
            let groups: Vec<Vec<f32>> = x
                .par_chunks(group * input)
                .zip(d.par_chunks(group * output))
                .map(|(x, d)| {
                    let mut dweight = vec![0.0; weight.len()];
                    let mut scratch = Scratch::default();
                    for (x, d) in x.chunks_exact(input).zip(d.chunks_exact(output)) {
                        conv::backward_weights(shape, x, d, &mut dweight, &mut scratch);
                    }
                    dweight
                })
                .collect();
            for group in &groups {
                add(&mut gradient[weight.range()], group);
            }
            if i == 0 {
                return;
            }
            let mut packed = Packed::default();
            shape.pack_transposed(self.values(weight), &mut packed);
            dx.resize(x.len(), 0.0);
            dx.par_chunks_mut(input)
                .zip(d.par_chunks(output))
                .for_each_init(Scratch::default, |scratch, (dx, d)| {
                    conv::backward_input(shape, d, &packed, dx, scratch);
                });
            std::mem::swap(d, dx);
        }
    }
}

/// Forward values of the head, kept for the backward pass.
struct HeadPass {
    joined: Vec<f32>,
    hidden: Vec<f32>,
    logits: Vec<f32>,
}

/// Gradients of what reads the encoders.
#[derive(Clone, Copy)]
struct Above<'a> {
    embeddings: &'a [Vec<f32>],
    /// Of the last output of the touch encoder; empty without contact maps.
    contact: &'a [f32],
}

fn add(to: &mut [f32], from: &[f32]) {
    for (to, from) in to.iter_mut().zip(from) {
        *to += from;
    }
}

/// Computes `x·weight + bias` for the rows of `x`.
fn linear(x: &[f32], weight: &[f32], bias: &[f32], relu: bool) -> Vec<f32> {
    let (outputs, inputs) = (bias.len(), weight.len() / bias.len());
    let mut y = vec![0.0; x.len() / inputs * outputs];
    let mut packed = Packed::default();
    packed.pack_rows([inputs, outputs], weight);
    let finish = Finish {
        bias: Some(bias),
        relu,
    };
    conv::linear_forward(x, &packed, inputs, &mut y, finish);
    y
}

/// Returns the gradient of `x`; adds those of weight and bias.
fn backward_linear(
    x: &[f32],
    dy: &[f32],
    network: &Network,
    weight: &Param,
    bias: &Param,
    gradient: &mut [f32],
) -> Vec<f32> {
    let [inputs, outputs] = weight.shape;
    conv::linear_backward_weights(x, dy, weight.shape, &mut gradient[weight.range()]);
    for dy in dy.chunks_exact(outputs) {
        add(&mut gradient[bias.range()], dy);
    }
    let mut packed = Packed::default();
    packed.pack_columns([outputs, inputs], network.values(weight));
    let mut dx = vec![0.0; x.len()];
    conv::linear_forward(dy, &packed, outputs, &mut dx, Finish::default());
    dx
}

#[cfg(test)]
#[path = "network_test.rs"]
pub(crate) mod tests;
