//! The classifier: forwards, backwards, in training.

use rayon::prelude::*;

use super::architecture::{Architecture, EncoderParts, IMAGE, Layout, Part};
use super::batch_norm::{self, Moments};
use super::conv::{self, ConvShape, Scratch};
use super::product::{Finish, Packed};
use crate::predict::contract::Variant;

/// Fraction of a batch's moments in the running ones, at least.
const MOMENTUM: f32 = 0.1;
/// Parts of a batch whose gradients are summed on their own, so that sums do not depend on the
/// number of threads.
const GROUPS: usize = 8;

/// Images of a batch, HWC floats one after the other; empty where the classifier lacks the sense.
#[derive(Clone, Debug, Default)]
pub struct Batch {
    /// All left tactile differences, then all right ones.
    pub touch: Vec<f32>,
    /// Colour images.
    pub vision: Vec<f32>,
    /// 1 for a stable grasp, 0 for a lost one.
    pub targets: Vec<f32>,
    /// What each sample's loss counts.
    pub weights: Vec<f32>,
}

/// What a step of training needs beside the data.
#[derive(Clone, Debug, Default)]
pub struct Step {
    /// Steps that were taken before.
    pub number: u64,
    /// What the hidden floats of each sample are multiplied with; empty for nothing.
    pub dropout: Vec<f32>,
}

/// One of the encoders.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Sense {
    /// Of tactile differences.
    Touch,
    /// Of the colour image.
    Vision,
}

impl Sense {
    /// Its name in the names of parts.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Touch => "touch",
            Self::Vision => "vision",
        }
    }
}

/// Parameters and what belongs to them.
#[derive(Clone, Debug)]
pub struct Network {
    shapes: Vec<ConvShape>,
    architecture: Architecture,
    layout: Layout,
    variant: Variant,
    /// All parameters, by [`Layout`].
    pub parameters: Vec<f32>,
    /// Running means and variances of the convolutions' channels.
    pub moments: Vec<f32>,
    workspace: Workspace,
}

/// Memory that steps use again: asking for it anew takes a sixth of the time.
#[derive(Debug, Default)]
struct Workspace {
    passes: Vec<EncoderPass>,
    /// Gradients of what a layer gives and of what it gets.
    gradients: [Vec<f32>; 2],
}

impl Clone for Workspace {
    /// Empty: it holds nothing that lasts.
    fn clone(&self) -> Self {
        Self::default()
    }
}

/// What an encoder keeps on its way forwards.
#[derive(Debug, Default)]
struct EncoderPass {
    /// After each convolution, before normalisation.
    z: Vec<Vec<f32>>,
    /// After ReLU.
    a: Vec<Vec<f32>>,
    moments: Vec<Moments>,
    pooled: Vec<f32>,
    embedding: Vec<f32>,
}

impl Network {
    /// A network whose parameters are drawn by `uniform` from [0, 1): weights uniform within
    /// ±√(6/fan-in) before a ReLU (He et al., 2015) and ±√(3/fan-in) elsewhere, γ = 1, the rest 0.
    pub fn new(
        architecture: &Architecture,
        variant: Variant,
        mut uniform: impl FnMut() -> f64,
    ) -> Self {
        let layout = Layout::of(architecture, variant);
        let mut parameters = vec![0.0; layout.len()];
        for part in layout.parts() {
            let values = &mut parameters[part.range()];
            if part.name.ends_with("gamma") {
                values.fill(1.0);
            } else if part.is_weight() {
                let is_linear = part.name.contains("projection") || part.name.contains("logit");
                let gain = if is_linear { 3.0 } else { 6.0 };
                let most = (gain / part.shape[0] as f64).sqrt();
                values.fill_with(|| ((2.0 * uniform() - 1.0) * most) as f32);
            }
        }
        let mut moments = vec![0.0; layout.moments()];
        for encoder in layout.touch.iter().chain(&layout.vision) {
            for [_, variance] in &encoder.moments {
                moments[variance.clone()].fill(1.0);
            }
        }
        Self {
            shapes: architecture.shapes(),
            architecture: architecture.clone(),
            layout,
            variant,
            parameters,
            moments,
            workspace: Workspace::default(),
        }
    }

    /// Where the parameters lie.
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// The values of a part.
    pub(crate) fn part(&self, part: &Part) -> &[f32] {
        &self.parameters[part.range()]
    }

    /// Shapes of an encoder's convolutions.
    pub(crate) fn shapes(&self) -> &[ConvShape] {
        &self.shapes
    }

    /// Its sizes.
    pub(crate) fn architecture(&self) -> &Architecture {
        &self.architecture
    }

    /// Weight and bias of the hidden and of the last layer.
    pub(crate) fn head(&self) -> &[[Part; 2]; 2] {
        &self.layout.head
    }

    fn encoder(&self, sense: Sense) -> Option<&EncoderParts> {
        match sense {
            Sense::Touch => self.layout.touch.as_ref(),
            Sense::Vision => self.layout.vision.as_ref(),
        }
    }

    /// Weight and bias of an encoder's projection; none where the classifier lacks the sense.
    pub(crate) fn projection(&self, sense: Sense) -> Option<&[Part; 2]> {
        self.encoder(sense).map(|parts| &parts.projection)
    }

    /// Weight, KH·KW·C rows with a column for each output channel, and bias of an encoder's
    /// convolutions with their normalisation by the running moments in them; none where the
    /// classifier lacks the sense.
    pub(crate) fn folded(&self, sense: Sense) -> Option<Vec<[Vec<f32>; 2]>> {
        let parts = self.encoder(sense)?;
        let folded = parts.convolutions.iter().zip(&parts.moments);
        let folded = folded.map(|([weight, gamma, beta], moments)| {
            let [mean, variance] = moments.clone().map(|at| self.moments[at].to_vec());
            let moments = Moments { mean, variance };
            let (scale, bias) = moments.scale_and_shift(self.part(gamma), self.part(beta));
            let rows = self.part(weight).chunks_exact(scale.len());
            let weight = rows.flat_map(|row| row.iter().zip(&scale).map(|(w, scale)| w * scale));
            [weight.collect(), bias]
        });
        Some(folded.collect())
    }

    /// Logits of a batch with the running moments.
    pub fn logits(&self, batch: &Batch) -> Vec<f32> {
        let mut passes = Vec::new();
        self.encode(batch, false, &mut passes);
        self.decide(&passes, None).logits
    }

    /// Mean binary cross entropy of a batch, nats; adds the gradient of all parameters to `gradient`
    /// and updates the running moments.
    pub fn learn(&mut self, batch: &Batch, step: &Step, gradient: &mut [f32]) -> f64 {
        let mut workspace = std::mem::take(&mut self.workspace);
        let Workspace { passes, gradients } = &mut workspace;
        self.encode(batch, true, passes);
        let head = self.decide(passes, Some(step));
        let count = head.logits.len();
        let mut loss = 0.0;
        let total: f64 = batch.weights.iter().map(|w| f64::from(*w)).sum();
        let dlogits: Vec<f32> = (0..count)
            .map(|i| {
                let (x, y) = (f64::from(head.logits[i]), f64::from(batch.targets[i]));
                let weight = f64::from(batch.weights[i]) / total;
                // ln(1 + eˣ) − y·x without overflow.
                loss += weight * (x.max(0.0) - x * y + (-x.abs()).exp().ln_1p());
                (weight * (1.0 / (1.0 + (-x).exp()) - y)) as f32
            })
            .collect();
        let djoined = self.backward_head(&head, step, &dlogits, gradient);
        let dembeddings = self.split(passes, &djoined);
        let mut first = 0;
        let encoders = self.encoder_parts().into_iter().zip(&*passes);
        for ((encoder, pass), images) in encoders.zip(self.inputs(batch)) {
            let dembedding = &dembeddings[first..][..pass.embedding.len()];
            let [weight, bias] = &encoder.projection;
            let dpooled = backward_linear(&pass.pooled, dembedding, self, weight, bias, gradient);
            self.unpool(&dpooled, &mut gradients[0]);
            self.backward_convolutions(encoder, pass, images, gradients, gradient);
            first += dembedding.len();
        }
        self.update_moments(passes, step.number);
        self.workspace = workspace;
        loss
    }

    /// Gives the batch's moments their fraction in the running ones.
    fn update_moments(&mut self, passes: &[EncoderPass], number: u64) {
        // At the beginning the mean of all batches: the first moments stand for nothing.
        let fraction = MOMENTUM.max(1.0 / (number + 1) as f32);
        let encoders: Vec<EncoderParts> = self.encoder_parts().into_iter().cloned().collect();
        for (encoder, pass) in encoders.iter().zip(passes) {
            for ([mean, variance], (moments, z)) in
                encoder.moments.iter().zip(pass.moments.iter().zip(&pass.z))
            {
                let count = (z.len() / moments.mean.len()) as f32;
                // That of the population.
                let unbiased = count / (count - 1.0).max(1.0);
                let keep = |running: &mut [f32], found: &[f32], factor: f32| {
                    for (running, found) in running.iter_mut().zip(found) {
                        *running += fraction * (found * factor - *running);
                    }
                };
                keep(&mut self.moments[mean.clone()], &moments.mean, 1.0);
                keep(
                    &mut self.moments[variance.clone()],
                    &moments.variance,
                    unbiased,
                );
            }
        }
    }

    fn encoder_parts(&self) -> Vec<&EncoderParts> {
        self.layout
            .touch
            .iter()
            .chain(&self.layout.vision)
            .collect()
    }

    fn inputs<'a>(&self, batch: &'a Batch) -> Vec<&'a [f32]> {
        let touch = self.variant.has_touch().then_some(&batch.touch[..]);
        let vision = self.variant.has_vision().then_some(&batch.vision[..]);
        touch.into_iter().chain(vision).collect()
    }

    fn encode(&self, batch: &Batch, is_training: bool, passes: &mut Vec<EncoderPass>) {
        let parts = self.encoder_parts();
        passes.resize_with(parts.len(), EncoderPass::default);
        for ((parts, images), pass) in parts.into_iter().zip(self.inputs(batch)).zip(passes) {
            self.encode_images(parts, images, is_training, pass);
        }
    }

    fn encode_images(
        &self,
        parts: &EncoderParts,
        images: &[f32],
        is_training: bool,
        pass: &mut EncoderPass,
    ) {
        let count = images.len() / IMAGE.iter().product::<usize>();
        pass.z.resize_with(self.shapes.len(), Vec::new);
        pass.a.resize_with(self.shapes.len(), Vec::new);
        pass.moments.clear();
        for (i, shape) in self.shapes.iter().enumerate() {
            let [weight, gamma, beta] = &parts.convolutions[i];
            let mut packed = Packed::default();
            shape.pack(self.part(weight), &mut packed);
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
            let moments = if is_training {
                Moments::of(z, output, shape.channels)
            } else {
                let [mean, variance] = parts.moments[i].clone().map(|at| self.moments[at].to_vec());
                Moments { mean, variance }
            };
            let (scale, shift) = moments.scale_and_shift(self.part(gamma), self.part(beta));
            batch_norm::normalise(z, output, &scale, &shift, a);
            pass.moments.push(moments);
        }
        let last = pass.a.last().map_or(images, |a| &a[..]);
        pass.pooled = self.pool(last, count);
        let [weight, bias] = &parts.projection;
        pass.embedding = linear(&pass.pooled, self.part(weight), self.part(bias), false);
    }

    /// Height, width and channels of what the last convolution gives.
    fn last(&self) -> [usize; 3] {
        self.shapes.last().map_or(IMAGE, ConvShape::output)
    }

    /// Means over windows.
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

    /// Gradient of what the last convolution gives.
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

    fn decide(&self, passes: &[EncoderPass], step: Option<&Step>) -> HeadPass {
        let [[weight, bias], [last, last_bias]] = &self.layout.head;
        let joined = self.join(passes);
        let mut hidden = linear(&joined, self.part(weight), self.part(bias), true);
        if let Some(step) = step {
            for (hidden, factor) in hidden.iter_mut().zip(&step.dropout) {
                *hidden *= factor;
            }
        }
        let logits = linear(&hidden, self.part(last), self.part(last_bias), false);
        HeadPass {
            joined,
            hidden,
            logits,
        }
    }

    /// Embeddings side by side: left, right, colour.
    fn join(&self, passes: &[EncoderPass]) -> Vec<f32> {
        let width = self.embedding();
        let count = self.count(passes);
        let mut joined = Vec::with_capacity(count * self.variant.inputs().len() * width);
        for sample in 0..count {
            for pass in passes {
                for row in (sample..pass.embedding.len() / width).step_by(count) {
                    joined.extend_from_slice(&pass.embedding[row * width..][..width]);
                }
            }
        }
        joined
    }

    fn embedding(&self) -> usize {
        self.layout.head[0][0].shape[0] / self.variant.inputs().len()
    }

    fn count(&self, passes: &[EncoderPass]) -> usize {
        let floats: usize = passes.iter().map(|pass| pass.embedding.len()).sum();
        floats / (self.embedding() * self.variant.inputs().len())
    }

    /// Gradient of the joined embeddings.
    fn backward_head(
        &self,
        head: &HeadPass,
        step: &Step,
        dlogits: &[f32],
        gradient: &mut [f32],
    ) -> Vec<f32> {
        let [[weight, bias], [last, last_bias]] = &self.layout.head;
        let mut dhidden = backward_linear(&head.hidden, dlogits, self, last, last_bias, gradient);
        for (d, hidden) in dhidden.iter_mut().zip(&head.hidden) {
            if *hidden <= 0.0 {
                *d = 0.0;
            }
        }
        for (d, factor) in dhidden.iter_mut().zip(&step.dropout) {
            *d *= factor;
        }
        backward_linear(&head.joined, &dhidden, self, weight, bias, gradient)
    }

    /// Gradients of the encoders' embeddings, in the order of the passes.
    fn split(&self, passes: &[EncoderPass], djoined: &[f32]) -> Vec<f32> {
        let width = self.embedding();
        let count = self.count(passes);
        let row = self.variant.inputs().len() * width;
        let mut split = Vec::with_capacity(djoined.len());
        for which in 0..self.variant.inputs().len() {
            for sample in 0..count {
                split.extend_from_slice(&djoined[sample * row + which * width..][..width]);
            }
        }
        split
    }

    /// Adds the gradients of an encoder's convolutions, from that of what the last one gives.
    fn backward_convolutions(
        &self,
        parts: &EncoderParts,
        pass: &EncoderPass,
        images: &[f32],
        [d, dx]: &mut [Vec<f32>; 2],
        gradient: &mut [f32],
    ) {
        for (i, shape) in self.shapes.iter().enumerate().rev() {
            let [weight, gamma, beta] = &parts.convolutions[i];
            let input: usize = shape.input.iter().product();
            let output: usize = shape.output().iter().product();
            let of_layer = batch_norm::Pass {
                z: &pass.z[i],
                a: &pass.a[i],
                image: output,
                moments: &pass.moments[i],
            };
            let [dgamma, dbeta] = batch_norm::backward(of_layer, self.part(gamma), d);
            add(&mut gradient[gamma.range()], &dgamma);
            add(&mut gradient[beta.range()], &dbeta);
            let x = if i == 0 { images } else { &pass.a[i - 1][..] };
            let count = x.len() / input;
            let some = count.div_ceil(GROUPS);
            let groups: Vec<Vec<f32>> = x
                .par_chunks(some * input)
                .zip(d.par_chunks(some * output))
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
            shape.pack_transposed(self.part(weight), &mut packed);
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

/// What the head keeps on its way forwards.
struct HeadPass {
    joined: Vec<f32>,
    hidden: Vec<f32>,
    logits: Vec<f32>,
}

fn add(to: &mut [f32], from: &[f32]) {
    for (to, from) in to.iter_mut().zip(from) {
        *to += from;
    }
}

/// `x·weight + bias` for the rows of `x`.
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

/// Gradient of `x`; adds those of weight and bias.
fn backward_linear(
    x: &[f32],
    dy: &[f32],
    network: &Network,
    weight: &Part,
    bias: &Part,
    gradient: &mut [f32],
) -> Vec<f32> {
    let [inputs, outputs] = weight.shape;
    conv::linear_backward_weights(x, dy, weight.shape, &mut gradient[weight.range()]);
    for dy in dy.chunks_exact(outputs) {
        add(&mut gradient[bias.range()], dy);
    }
    let mut packed = Packed::default();
    packed.pack_columns([outputs, inputs], network.part(weight));
    let mut dx = vec![0.0; x.len()];
    conv::linear_forward(dy, &packed, outputs, &mut dx, Finish::default());
    dx
}

#[cfg(test)]
#[path = "network_test.rs"]
mod tests;
