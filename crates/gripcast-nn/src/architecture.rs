//! Architecture of the classifier, and layout of its parameters.

use serde::{Deserialize, Serialize};

use super::conv::ConvShape;
use crate::predict::contract::Modality;

/// Height, width and channels of the input images.
pub const IMAGE: [usize; 3] = [240, 320, 3];

/// Settings of a convolution with batch normalisation and ReLU.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ConvSpec {
    /// Output channels; a multiple of 16.
    pub channels: usize,
    /// Kernel size, pixels.
    pub kernel: usize,
    /// Stride, pixels.
    pub stride: usize,
    /// Zero padding, pixels.
    pub pad: usize,
}

/// Architecture of a classifier: an encoder for tactile differences, one of equal size for the
/// colour image, and two dense layers on their embeddings.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Architecture {
    /// Name on the command line and in files.
    pub name: String,
    /// Convolutions of an encoder.
    pub convolutions: Vec<ConvSpec>,
    /// Height and width of the average pooling after the last convolution, pixels.
    pub pool: [usize; 2],
    /// Size of an embedding.
    pub embedding: usize,
    /// Size of the hidden layer.
    pub hidden: usize,
}

impl Architecture {
    /// Names accepted by [`Architecture::by_name`].
    pub const NAMES: [&str; 2] = ["gripcast", "paper"];

    /// Returns the architecture of a name.
    pub fn by_name(name: &str) -> Option<Self> {
        match name {
            "gripcast" => Some(Self::gripcast()),
            "paper" => Some(Self::paper()),
            _ => None,
        }
    }

    /// The default: a patch stem of 4×4 pixels, a twelfth of the paper's operations.
    pub fn gripcast() -> Self {
        let conv = |channels, kernel, stride, pad| ConvSpec {
            channels,
            kernel,
            stride,
            pad,
        };
        Self {
            name: "gripcast".to_owned(),
            convolutions: vec![
                conv(32, 4, 4, 0),
                conv(64, 3, 2, 1),
                conv(96, 3, 2, 1),
                conv(128, 3, 2, 1),
            ],
            pool: [2, 2],
            embedding: 128,
            hidden: 128,
        }
    }

    /// The paper's: four convolutions, embeddings of 512, two dense layers (§5.2). Kernels,
    /// channels, strides and pooling are not stated there; common values for 240×320 are used.
    pub fn paper() -> Self {
        let conv = |channels, kernel, pad| ConvSpec {
            channels,
            kernel,
            stride: 2,
            pad,
        };
        Self {
            name: "paper".to_owned(),
            convolutions: vec![
                conv(32, 5, 2),
                conv(64, 3, 1),
                conv(128, 3, 1),
                conv(256, 3, 1),
            ],
            pool: [3, 4],
            embedding: 512,
            hidden: 256,
        }
    }

    /// Shapes of an encoder's convolutions.
    pub fn shapes(&self) -> Vec<ConvShape> {
        let mut input = IMAGE;
        let shape = |spec: &ConvSpec| {
            let shape = ConvShape {
                input,
                channels: spec.channels,
                kernel: spec.kernel,
                stride: spec.stride,
                pad: spec.pad,
            };
            input = shape.output();
            shape
        };
        self.convolutions.iter().map(shape).collect()
    }

    /// Height, width and channels after pooling; incomplete windows are dropped.
    pub fn pooled(&self) -> [usize; 3] {
        let [height, width, channels] = self.shapes().last().map_or(IMAGE, ConvShape::output);
        [height / self.pool[0], width / self.pool[1], channels]
    }
}

/// A named parameter tensor.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Param {
    /// Name, for instance `touch.conv1.weight`.
    pub name: String,
    /// Index of its first value.
    pub first: usize,
    /// Rows and columns; one row for vectors.
    pub shape: [usize; 2],
}

impl Param {
    /// Number of values.
    pub fn len(&self) -> usize {
        self.shape[0] * self.shape[1]
    }

    /// Whether it is empty.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Range of its values.
    pub fn range(&self) -> std::ops::Range<usize> {
        self.first..self.first + self.len()
    }

    /// Whether it is a weight matrix, not a bias or scale.
    pub fn is_weight(&self) -> bool {
        self.name.ends_with("weight")
    }
}

/// Parameters of one encoder.
#[derive(Clone, Debug)]
pub(super) struct EncoderParams {
    /// Weight, γ, β of each convolution.
    pub(super) convolutions: Vec<[Param; 3]>,
    /// Weight and bias.
    pub(super) projection: [Param; 2],
    /// Ranges of mean and variance of each convolution in the running statistics.
    pub(super) stats: Vec<[std::ops::Range<usize>; 2]>,
}

/// Layout of all parameters in one slice.
#[derive(Clone, Debug)]
pub struct Layout {
    pub(super) touch: Option<EncoderParams>,
    pub(super) vision: Option<EncoderParams>,
    /// Weight and bias of the hidden and the output layer.
    pub(super) head: [[Param; 2]; 2],
    params: Vec<Param>,
    running_stats_len: usize,
}

impl Layout {
    /// Layout of an architecture with encoders for `modality`.
    pub fn new(architecture: &Architecture, modality: Modality) -> Self {
        let mut params: Vec<Param> = Vec::new();
        let mut running_stats_len = 0;
        let mut add = |name: String, shape: [usize; 2]| {
            let first = params.last().map_or(0, |param| param.range().end);
            let param = Param { name, first, shape };
            params.push(param.clone());
            param
        };
        let mut encoder = |name: &str| {
            let shapes = architecture.shapes();
            let convolutions = shapes.iter().enumerate().map(|(i, shape)| {
                let channels = shape.channels;
                let name = |what: &str| format!("{name}.conv{}.{what}", i + 1);
                [
                    add(name("weight"), [shape.fan_in(), channels]),
                    add(name("gamma"), [1, channels]),
                    add(name("beta"), [1, channels]),
                ]
            });
            let convolutions = convolutions.collect();
            let pooled = architecture.pooled().iter().product();
            let projection = [
                add(
                    format!("{name}.projection.weight"),
                    [pooled, architecture.embedding],
                ),
                add(
                    format!("{name}.projection.bias"),
                    [1, architecture.embedding],
                ),
            ];
            let ranges = shapes.iter().map(|shape| {
                let mean = running_stats_len..running_stats_len + shape.channels;
                running_stats_len = mean.end + shape.channels;
                [mean.clone(), mean.end..running_stats_len]
            });
            EncoderParams {
                convolutions,
                projection,
                stats: ranges.collect(),
            }
        };
        let touch = modality.has_touch().then(|| encoder("touch"));
        let vision = modality.has_vision().then(|| encoder("vision"));
        let joined = modality.inputs().len() * architecture.embedding;
        let hidden = architecture.hidden;
        let head = [
            [
                add("head.hidden.weight".to_owned(), [joined, hidden]),
                add("head.hidden.bias".to_owned(), [1, hidden]),
            ],
            [
                add("head.logit.weight".to_owned(), [hidden, 1]),
                add("head.logit.bias".to_owned(), [1, 1]),
            ],
        ];
        Self {
            touch,
            vision,
            head,
            params,
            running_stats_len,
        }
    }

    /// All parameter tensors in order.
    pub fn params(&self) -> &[Param] {
        &self.params
    }

    /// Parameter tensors of the head, the last ones.
    pub fn head_params(&self) -> &[Param] {
        let count = self.head.as_flattened().len();
        &self.params[self.params.len() - count..]
    }

    /// Number of parameters.
    pub fn len(&self) -> usize {
        self.params.last().map_or(0, |param| param.range().end)
    }

    /// Whether it is empty.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number of running statistics.
    pub fn running_stats_len(&self) -> usize {
        self.running_stats_len
    }
}
