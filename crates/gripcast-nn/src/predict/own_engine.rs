//! Our own engine for the networks that gripcast trains, on the processor's widest vectors. Other
//! graphs are left to the general engine.

use std::sync::{Mutex, PoisonError};

use tract_onnx::pb::ModelProto;

use super::contract::{InputName, Variant};
use super::input::ModelInput;
use crate::architecture::IMAGE;
use crate::export::Recognised;
use crate::inference::{Convolution, Dense, Padded};
use crate::network::Sense;

/// A network that is ready to run.
#[derive(Debug)]
pub(super) struct OwnEngine {
    encoders: Vec<Encoder>,
    pool: [usize; 2],
    hidden: Dense,
    logit: Dense,
    empty: Memory,
    /// Memory of runs that have ended.
    free: Mutex<Vec<Memory>>,
}

#[derive(Debug)]
struct Encoder {
    /// Its images; sensors share one.
    inputs: &'static [InputName],
    convolutions: Vec<Convolution>,
    projection: Dense,
}

/// What a run writes.
#[derive(Clone, Debug, Default)]
struct Memory {
    /// The input, where it is read as pixels, and what each convolution gives.
    images: Vec<Padded>,
    /// Means over windows, one row for each input of an encoder.
    pooled: Vec<f32>,
    /// What a layer gives.
    numbers: Vec<f32>,
    joined: Vec<f32>,
}

impl OwnEngine {
    /// The engine for a model; none where its graph is not one of our networks.
    pub(super) fn of(model: &ModelProto, variant: Variant) -> Option<Self> {
        use InputName::{Rgb, TactileLeft, TactileRight};
        let graph = Recognised::new(model.graph.as_ref()?, variant.inputs())?;
        let architecture = &graph.architecture;
        let shapes = architecture.shapes();
        let [height, width, channels] = architecture.pooled();
        let encoder = |sense: Sense, inputs: &'static [InputName]| {
            let convolutions = shapes.iter().enumerate().map(|(at, shape)| {
                let [weight, bias] = graph.convolution(sense, at, shape.input[2])?;
                Some(Convolution::new(*shape, &weight, bias, true))
            });
            // Before their channels are multiplied: the file's sides are then those of its data.
            let convolutions = convolutions.collect::<Option<_>>()?;
            let layer = format!("{}.projection", sense.name());
            let means = height * width * channels;
            let [weight, bias] = graph.dense(&layer, means, architecture.embedding)?;
            Some(Encoder {
                inputs,
                convolutions,
                projection: Dense::of_planes([height * width, channels], &weight, bias),
            })
        };
        let all: [(Sense, &'static [InputName]); 2] = [
            (Sense::Touch, &[TactileLeft, TactileRight]),
            (Sense::Vision, &[Rgb]),
        ];
        let encoders = all
            .into_iter()
            .filter(|(_, inputs)| inputs.iter().all(|name| variant.inputs().contains(name)))
            .map(|(sense, inputs)| encoder(sense, inputs));
        let encoders = encoders.collect::<Option<_>>()?;
        let joined = variant.inputs().len() * architecture.embedding;
        let [hidden, hidden_bias] = graph.dense("head.hidden", joined, architecture.hidden)?;
        let [logit, logit_bias] = graph.dense("head.logit", architecture.hidden, 1)?;
        let pads = shapes.iter().map(|shape| shape.pad).chain([0]);
        let sizes = [IMAGE].into_iter().chain(shapes.iter().map(|s| s.output()));
        let images = sizes.zip(pads).map(|(size, pad)| Padded::new(size, pad));
        Some(Self {
            encoders,
            pool: architecture.pool,
            hidden: Dense::new(joined, &hidden, hidden_bias, true),
            logit: Dense::new(architecture.hidden, &logit, logit_bias, false),
            empty: Memory {
                images: images.collect(),
                ..Memory::default()
            },
            free: Mutex::default(),
        })
    }

    /// The probability that the model gives; none where an input is missing.
    pub(super) fn run(&self, input: &ModelInput) -> Option<f32> {
        let free = || self.free.lock().unwrap_or_else(PoisonError::into_inner);
        let mut memory = free().pop().unwrap_or_else(|| self.empty.clone());
        let logit = self.logit(input, &mut memory);
        free().push(memory);
        logit.map(|x| 1.0 / (1.0 + (-x).exp()))
    }

    fn logit(&self, input: &ModelInput, memory: &mut Memory) -> Option<f32> {
        let Memory {
            images,
            pooled,
            numbers,
            joined,
        } = memory;
        joined.clear();
        for encoder in &self.encoders {
            pooled.clear();
            for name in encoder.inputs {
                encoder.convolve(input.values(*name)?, images);
                images.last()?.pool(self.pool, pooled);
            }
            encoder.projection.of(pooled, numbers);
            joined.extend_from_slice(numbers);
        }
        self.hidden.of(joined, numbers);
        self.logit.of(numbers, joined);
        joined.first().copied()
    }
}

impl Encoder {
    /// Planes of an input through all convolutions.
    fn convolve(&self, planes: &[f32], images: &mut [Padded]) {
        for (at, layer) in self.convolutions.iter().enumerate() {
            let (before, after) = images.split_at_mut(at + 1);
            let (x, y) = (&mut before[at], &mut after[0]);
            if at == 0 && layer.reads_planes() {
                layer.of_planes(planes, y);
                continue;
            }
            if at == 0 {
                x.set_planes(planes);
            }
            layer.of(x, y);
        }
    }
}
