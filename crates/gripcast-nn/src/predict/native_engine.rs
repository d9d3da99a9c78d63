//! Native engine for networks trained by gripcast, vectorised for the CPU. Other graphs run on
//! tract.

use std::sync::{Mutex, PoisonError};

use tract_onnx::pb::ModelProto;

use super::contract::{InputName, Modality};
use super::input::ModelInput;
use crate::architecture::IMAGE;
use crate::export::RecognisedNetwork;
use crate::inference::{Convolution, Dense, Padded};
use crate::network::EncoderKind;

/// Bound of the values of an input; that of a normalised colour image is 1 / std.
const INPUT_BOUND: f64 = 1e4;
/// Bound below which sums of the values of an image cannot overflow.
const OUTPUT_BOUND: f64 = 1e-6 * f32::MAX as f64;

/// A network ready to run.
#[derive(Debug)]
pub(super) struct NativeEngine {
    encoders: Vec<Encoder>,
    pool: [usize; 2],
    hidden: Dense,
    logit: Dense,
    empty: Buffers,
    /// Buffers for reuse.
    free: Mutex<Vec<Buffers>>,
}

#[derive(Debug)]
struct Encoder {
    /// Inputs; both sensors share an encoder.
    inputs: &'static [InputName],
    convolutions: Vec<Convolution>,
    projection: Dense,
}

/// Buffers of a run.
#[derive(Clone, Debug, Default)]
struct Buffers {
    /// The input as pixels, if needed, and the output of each convolution.
    images: Vec<Padded>,
    /// Pooled features, one row for each input of an encoder.
    pooled: Vec<f32>,
    /// Output of a dense layer.
    numbers: Vec<f32>,
    joined: Vec<f32>,
}

impl NativeEngine {
    /// Builds the engine for a model; none if its graph is not a gripcast network, or if its weights
    /// are so large that a layer could overflow: a ReLU would turn NaN into 0.
    pub(super) fn new(model: &ModelProto, modality: Modality) -> Option<Self> {
        use InputName::{Rgb, TactileLeft, TactileRight};
        let graph = RecognisedNetwork::new(model.graph.as_ref()?, modality.inputs())?;
        let architecture = &graph.architecture;
        let shapes = architecture.shapes();
        let [height, width, channels] = architecture.pooled();
        let mut largest = INPUT_BOUND;
        let mut encoder = |kind: EncoderKind, inputs: &'static [InputName]| {
            let mut bound = INPUT_BOUND;
            let convolutions = shapes.iter().enumerate().map(|(at, shape)| {
                let [weight, bias] = graph.convolution(kind, at, shape.input[2])?;
                bound = bound_after(bound, &weight, &bias);
                Some(Convolution::new(*shape, &weight, bias, true))
            });
            // First, so that the sizes below are those of actual data.
            let convolutions = convolutions.collect::<Option<_>>()?;
            let layer = format!("{}.projection", kind.name());
            let means = height * width * channels;
            let [weight, bias] = graph.dense(&layer, means, architecture.embedding)?;
            largest = f64::max(largest, bound_after(bound, &weight, &bias));
            Some(Encoder {
                inputs,
                convolutions,
                projection: Dense::from_planes([height * width, channels], &weight, bias),
            })
        };
        let all: [(EncoderKind, &'static [InputName]); 2] = [
            (EncoderKind::Touch, &[TactileLeft, TactileRight]),
            (EncoderKind::Vision, &[Rgb]),
        ];
        let encoders = all
            .into_iter()
            .filter(|(_, inputs)| inputs.iter().all(|name| modality.inputs().contains(name)))
            .map(|(kind, inputs)| encoder(kind, inputs));
        let encoders = encoders.collect::<Option<_>>()?;
        let joined = modality.inputs().len() * architecture.embedding;
        let [hidden, hidden_bias] = graph.dense("head.hidden", joined, architecture.hidden)?;
        let [logit, logit_bias] = graph.dense("head.logit", architecture.hidden, 1)?;
        let bound = bound_after(largest, &hidden, &hidden_bias);
        if bound_after(bound, &logit, &logit_bias) > OUTPUT_BOUND {
            return None;
        }
        let pads = shapes.iter().map(|shape| shape.pad).chain([0]);
        let sizes = [IMAGE].into_iter().chain(shapes.iter().map(|s| s.output()));
        let images = sizes.zip(pads).map(|(size, pad)| Padded::new(size, pad));
        Some(Self {
            encoders,
            pool: architecture.pool,
            hidden: Dense::new(joined, &hidden, hidden_bias, true),
            logit: Dense::new(architecture.hidden, &logit, logit_bias, false),
            empty: Buffers {
                images: images.collect(),
                ..Buffers::default()
            },
            free: Mutex::default(),
        })
    }

    /// Predicts p_stable; none if an input is missing.
    pub(super) fn run(&self, input: &ModelInput) -> Option<f32> {
        let free = || self.free.lock().unwrap_or_else(PoisonError::into_inner);
        let mut buffers = free().pop().unwrap_or_else(|| self.empty.clone());
        let logit = self.logit(input, &mut buffers);
        free().push(buffers);
        logit.map(|x| 1.0 / (1.0 + (-x).exp()))
    }

    fn logit(&self, input: &ModelInput, buffers: &mut Buffers) -> Option<f32> {
        let Buffers {
            images,
            pooled,
            numbers,
            joined,
        } = buffers;
        joined.clear();
        for encoder in &self.encoders {
            pooled.clear();
            for name in encoder.inputs {
                encoder.convolve(input.values(*name)?, images);
                images.last()?.pool(self.pool, pooled);
            }
            encoder.projection.forward(pooled, numbers);
            joined.extend_from_slice(numbers);
        }
        self.hidden.forward(joined, numbers);
        self.logit.forward(numbers, joined);
        joined.first().copied()
    }
}

/// Bound of what a layer answers, and of its sums, for inputs within a bound.
fn bound_after(bound: f64, weight: &[f32], bias: &[f32]) -> f64 {
    let max = |values: &[f32]| {
        values
            .iter()
            .fold(0.0, |max: f64, x| max.max(f64::from(x.abs())))
    };
    let inputs = weight.len() / bias.len().max(1);
    // At least the bound, so that a layer of small weights hides no overflow before it.
    bound.max(bound * max(weight) * inputs as f64 + max(bias))
}

impl Encoder {
    /// Runs all convolutions on the planes of an input.
    fn convolve(&self, planes: &[f32], images: &mut [Padded]) {
        for (at, layer) in self.convolutions.iter().enumerate() {
            let (before, after) = images.split_at_mut(at + 1);
            let (x, y) = (&mut before[at], &mut after[0]);
            if at == 0 && layer.reads_planes() {
                layer.forward_planes(planes, y);
                continue;
            }
            if at == 0 {
                x.set_planes(planes);
            }
            layer.forward(x, y);
        }
    }
}
