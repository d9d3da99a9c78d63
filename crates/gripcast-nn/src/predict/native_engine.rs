//! Native engine for networks trained by gripcast, vectorised for the CPU. Other graphs run on
//! tract.

use std::sync::{Mutex, PoisonError};

use tract_onnx::pb::ModelProto;

use super::contract::{GEOMETRY, Modality};
use super::engine::Values;
use super::input::ModelInput;
use crate::architecture::{EncoderKind, IMAGE, head_name};
use crate::export::RecognisedNetwork;
use crate::inference::{Convolution, Dense, Padded};

/// Bound of the values of an input; that of a normalised colour image is 1 / std.
const INPUT_BOUND: f64 = 1e4;
/// Bound below which sums of the values of an image cannot overflow.
const OUTPUT_BOUND: f64 = 1e-6 * f32::MAX as f64;

/// A network ready to run.
#[derive(Debug)]
pub(super) struct NativeEngine {
    encoders: Vec<Encoder>,
    pool: [usize; 2],
    heads: Vec<Head>,
    /// Whether the first numbers of a camera's embedding are the geometry.
    geometry: bool,
    /// Weight, outputs × inputs, and bias of what reads the contact maps.
    contact: Option<[Vec<f32>; 2]>,
    empty: Buffers,
    /// Buffers for reuse.
    free: Mutex<Vec<Buffers>>,
}

#[derive(Debug)]
struct Encoder {
    kind: EncoderKind,
    convolutions: Vec<Convolution>,
    projection: Dense,
}

/// Dense layers on the embeddings of some inputs.
#[derive(Debug)]
struct Head {
    modality: Modality,
    hidden: Dense,
    logit: Dense,
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
        let graph = RecognisedNetwork::new(model.graph.as_ref()?, modality)?;
        let architecture = &graph.architecture;
        let shapes = architecture.shapes();
        let [height, width, channels] = architecture.pooled();
        let mut largest = INPUT_BOUND;
        let mut encoder = |kind: EncoderKind| {
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
            let [weight, bias] = graph.dense(&layer, means, architecture.embedding_of(kind))?;
            largest = f64::max(largest, bound_after(bound, &weight, &bias));
            Some(Encoder {
                kind,
                convolutions,
                projection: Dense::from_planes([height * width, channels], &weight, bias),
            })
        };
        let kinds = EncoderKind::ALL.into_iter();
        let kinds = kinds.filter(|kind| kind.is_in(modality));
        let encoders = kinds.map(&mut encoder).collect::<Option<_>>()?;
        let heads = architecture.heads(modality).into_iter().map(|head| {
            let (name, joined) = (head_name(head, modality), architecture.joined(head));
            let sizes = [joined, architecture.hidden_of(head)];
            let [hidden, hidden_bias] =
                graph.dense(&format!("{name}.hidden"), sizes[0], sizes[1])?;
            let [logit, logit_bias] = graph.dense(&format!("{name}.logit"), sizes[1], 1)?;
            let bound = bound_after(largest, &hidden, &hidden_bias);
            let is_bounded = bound_after(bound, &logit, &logit_bias) <= OUTPUT_BOUND;
            is_bounded.then(|| Head {
                modality: head,
                hidden: Dense::new(joined, &hidden, hidden_bias, true),
                logit: Dense::new(sizes[1], &logit, logit_bias, false),
            })
        });
        let heads = heads.collect::<Option<_>>()?;
        let contact = match graph.reads_contact {
            true => {
                let [weight, bias] = graph.contact()?;
                // The maps are read before the projection, whose input is not larger.
                let is_bounded = bound_after(largest, &weight, &bias) <= OUTPUT_BOUND;
                Some(is_bounded.then_some([weight, bias])?)
            }
            false => None,
        };
        let geometry = architecture.geometry;
        if geometry && architecture.camera_embedding < GEOMETRY && modality != Modality::T {
            return None;
        }
        let pads = shapes.iter().map(|shape| shape.pad).chain([0]);
        let sizes = [IMAGE].into_iter().chain(shapes.iter().map(|s| s.output()));
        let images = sizes.zip(pads).map(|(size, pad)| Padded::new(size, pad));
        Some(Self {
            encoders,
            pool: architecture.pool,
            heads,
            geometry,
            contact,
            empty: Buffers {
                images: images.collect(),
                ..Buffers::default()
            },
            free: Mutex::default(),
        })
    }

    /// Predicts from the inputs of a modality; none if one is missing.
    pub(super) fn run(&self, input: &ModelInput, modality: Modality) -> Option<Values> {
        let free = || self.free.lock().unwrap_or_else(PoisonError::into_inner);
        let mut buffers = free().pop().unwrap_or_else(|| self.empty.clone());
        let values = self.values(input, modality, &mut buffers);
        free().push(buffers);
        values
    }

    fn values(
        &self,
        input: &ModelInput,
        modality: Modality,
        buffers: &mut Buffers,
    ) -> Option<Values> {
        let head = self.heads.iter().find(|head| head.modality == modality)?;
        let Buffers {
            images,
            pooled,
            numbers,
            joined,
        } = buffers;
        joined.clear();
        let (mut geometry, mut contact) = (Vec::new(), Vec::new());
        for encoder in &self.encoders {
            if !encoder.kind.is_in(modality) {
                continue;
            }
            pooled.clear();
            for name in encoder.kind.inputs() {
                encoder.convolve(input.values(*name)?, images);
                let last = images.last()?;
                last.pool(self.pool, pooled);
                if let (EncoderKind::Touch, Some([weight, bias])) = (encoder.kind, &self.contact) {
                    contact.push(last.planes_of(weight, bias));
                }
            }
            encoder.projection.forward(pooled, numbers);
            joined.extend_from_slice(numbers);
            if self.geometry && encoder.kind != EncoderKind::Touch {
                let [name] = encoder.kind.inputs() else {
                    return None;
                };
                geometry.push((*name, *numbers.first_chunk()?));
            }
        }
        head.hidden.forward(joined, numbers);
        head.logit.forward(numbers, joined);
        let logit = joined.first()?;
        Some(Values {
            p_stable: 1.0 / (1.0 + (-logit).exp()),
            geometry,
            contact,
        })
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
