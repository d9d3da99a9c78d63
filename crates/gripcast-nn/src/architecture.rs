//! Sizes of the classifier, and where its parameters lie.

use serde::{Deserialize, Serialize};

use super::conv::ConvShape;
use crate::predict::contract::Variant;

/// Height, width and channels of the images that go in.
pub const IMAGE: [usize; 3] = [240, 320, 3];

/// One convolution with batch normalisation and ReLU.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ConvSpec {
    /// Channels of the output; a multiple of 16.
    pub channels: usize,
    /// Side of the window, pixels.
    pub kernel: usize,
    /// Distance of windows, pixels.
    pub stride: usize,
    /// Zeros around the input, pixels.
    pub pad: usize,
}

/// Sizes of a classifier: an encoder for tactile differences, one of the same sizes for the colour
/// image, and two layers over their embeddings.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Architecture {
    /// Its name on the command line and in files.
    pub name: String,
    /// Convolutions of an encoder.
    pub convolutions: Vec<ConvSpec>,
    /// Height and width of the windows whose means are projected, pixels of the last convolution.
    pub pool: [usize; 2],
    /// Floats of an embedding.
    pub embedding: usize,
    /// Floats of the hidden layer over the embeddings.
    pub hidden: usize,
}

impl Architecture {
    /// Names that [`Architecture::named`] knows.
    pub const NAMES: [&str; 2] = ["gripcast", "paper"];

    /// The architecture of a name.
    pub fn named(name: &str) -> Option<Self> {
        match name {
            "gripcast" => Some(Self::gripcast()),
            "paper" => Some(Self::paper()),
            _ => None,
        }
    }

    /// Ours: a stem that looks at patches of 4×4 pixels, a twelfth of the work.
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

    /// The paper's: four convolutions, embeddings of 512, two layers over them (§5.2). Windows,
    /// channels, strides and the pool are not printed there; they are the usual ones for 240×320.
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

    /// Height, width and channels of the means that are projected; windows that do not fit are
    /// left out.
    pub fn pooled(&self) -> [usize; 3] {
        let [height, width, channels] = self.shapes().last().map_or(IMAGE, ConvShape::output);
        [height / self.pool[0], width / self.pool[1], channels]
    }
}

/// A named part of the parameters.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Part {
    /// Its name, for instance `touch.conv1.weight`.
    pub name: String,
    /// Where it begins.
    pub first: usize,
    /// Rows and columns; one row for what is no matrix.
    pub shape: [usize; 2],
}

impl Part {
    /// Number of floats.
    pub fn len(&self) -> usize {
        self.shape[0] * self.shape[1]
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Where it lies.
    pub fn range(&self) -> std::ops::Range<usize> {
        self.first..self.first + self.len()
    }

    /// Whether it is a matrix of weights, not a bias or scale.
    pub fn is_weight(&self) -> bool {
        self.name.ends_with("weight")
    }
}

/// Parameters of one encoder.
#[derive(Clone, Debug)]
pub(super) struct EncoderParts {
    /// Weight, γ, β of each convolution.
    pub(super) convolutions: Vec<[Part; 3]>,
    /// Weight and bias.
    pub(super) projection: [Part; 2],
    /// Where mean and variance of each convolution's channels lie among the running moments.
    pub(super) moments: Vec<[std::ops::Range<usize>; 2]>,
}

/// Where all parameters lie in one slice of floats.
#[derive(Clone, Debug)]
pub struct Layout {
    pub(super) touch: Option<EncoderParts>,
    pub(super) vision: Option<EncoderParts>,
    /// Weight and bias of the hidden and of the last layer.
    pub(super) head: [[Part; 2]; 2],
    parts: Vec<Part>,
    moments: usize,
}

impl Layout {
    /// The layout of an architecture for a classifier with these senses.
    pub fn of(architecture: &Architecture, variant: Variant) -> Self {
        let mut parts: Vec<Part> = Vec::new();
        let mut moments = 0;
        let mut part = |name: String, shape: [usize; 2]| {
            let first = parts.last().map_or(0, |part| part.range().end);
            let part = Part { name, first, shape };
            parts.push(part.clone());
            part
        };
        let mut encoder = |name: &str| {
            let shapes = architecture.shapes();
            let convolutions = shapes.iter().enumerate().map(|(i, shape)| {
                let channels = shape.channels;
                let name = |what: &str| format!("{name}.conv{}.{what}", i + 1);
                [
                    part(name("weight"), [shape.fan_in(), channels]),
                    part(name("gamma"), [1, channels]),
                    part(name("beta"), [1, channels]),
                ]
            });
            let convolutions = convolutions.collect();
            let pooled = architecture.pooled().iter().product();
            let projection = [
                part(
                    format!("{name}.projection.weight"),
                    [pooled, architecture.embedding],
                ),
                part(
                    format!("{name}.projection.bias"),
                    [1, architecture.embedding],
                ),
            ];
            let ranges = shapes.iter().map(|shape| {
                let mean = moments..moments + shape.channels;
                moments = mean.end + shape.channels;
                [mean.clone(), mean.end..moments]
            });
            EncoderParts {
                convolutions,
                projection,
                moments: ranges.collect(),
            }
        };
        let touch = variant.has_touch().then(|| encoder("touch"));
        let vision = variant.has_vision().then(|| encoder("vision"));
        let joined = variant.inputs().len() * architecture.embedding;
        let hidden = architecture.hidden;
        let head = [
            [
                part("head.hidden.weight".to_owned(), [joined, hidden]),
                part("head.hidden.bias".to_owned(), [1, hidden]),
            ],
            [
                part("head.logit.weight".to_owned(), [hidden, 1]),
                part("head.logit.bias".to_owned(), [1, 1]),
            ],
        ];
        Self {
            touch,
            vision,
            head,
            parts,
            moments,
        }
    }

    /// All parts, one after the other.
    pub fn parts(&self) -> &[Part] {
        &self.parts
    }

    /// Number of parameters.
    pub fn len(&self) -> usize {
        self.parts.last().map_or(0, |part| part.range().end)
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number of running moments.
    pub fn moments(&self) -> usize {
        self.moments
    }
}
