//! Architecture of the classifier, and layout of its parameters.

use serde::{Deserialize, Serialize};

use super::conv::ConvShape;
use super::extents::EXTENT_UNITS;
pub use crate::predict::contract::GEOMETRY;
use crate::predict::contract::{InputName, Modality};
use gripcast_shear::ContactMaps;

/// Height, width and channels of the input images.
pub const IMAGE: [usize; 3] = [240, 320, 3];

pub use crate::predict::contract::CONTACT_CHANNELS;

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

/// Architecture of a classifier: an encoder for tactile differences, one each for the colour image
/// and the depth image, and two dense layers on their embeddings for each set of inputs that it
/// predicts from. With [`Architecture::geometry`] only those of touch alone are trained; the others
/// are [sums](crate::ExtentHead) of its log-odds and of parts of the extents.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Architecture {
    /// Name on the command line and in files.
    pub name: String,
    /// Convolutions of an encoder.
    pub convolutions: Vec<ConvSpec>,
    /// Height and width of the average pooling after the last convolution, pixels.
    pub pool: [usize; 2],
    /// Size of the embedding of a tactile difference.
    pub embedding: usize,
    /// Size of the embedding of a colour or depth image; with [`Architecture::geometry`] at least
    /// [`GEOMETRY`], its first numbers.
    pub camera_embedding: usize,
    /// Whether the encoders of colour and depth image estimate the geometry of the grasp
    /// ([`GEOMETRY`] numbers).
    pub geometry: bool,
    /// Whether it also predicts from fewer inputs, each with layers of its own.
    pub fallbacks: bool,
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
            camera_embedding: GEOMETRY,
            geometry: true,
            fallbacks: true,
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
            camera_embedding: 512,
            geometry: false,
            fallbacks: false,
            hidden: 256,
        }
    }

    /// The same for data without known extents: the encoders of camera images learn what the labels
    /// need.
    #[must_use]
    pub fn without_geometry(self) -> Self {
        Self {
            camera_embedding: self.embedding,
            geometry: false,
            ..self
        }
    }

    /// Whether a head is a sum of the touch head's log-odds and of parts of the extents.
    fn reads_extents(&self, head: Modality) -> bool {
        self.geometry && self.fallbacks && head.cameras().is_some()
    }

    /// Number of hidden units of a head.
    pub(super) fn hidden_of(&self, head: Modality) -> usize {
        if !self.reads_extents(head) {
            return self.hidden;
        }
        let cameras = head.cameras().map_or(0, |cameras| cameras.inputs().len());
        let touch = if head.has_touch() { self.hidden } else { 0 };
        touch + cameras * EXTENT_UNITS
    }

    /// Sets of inputs that a classifier of `modality` predicts from, all of its inputs first.
    pub fn heads(&self, modality: Modality) -> Vec<Modality> {
        match self.fallbacks {
            true => modality.subsets(),
            false => vec![modality],
        }
    }

    /// Size of the embedding of an image.
    pub(super) fn embedding_of(&self, kind: EncoderKind) -> usize {
        match kind {
            EncoderKind::Touch => self.embedding,
            EncoderKind::Vision | EncoderKind::Depth => self.camera_embedding,
        }
    }

    /// Size of the concatenated embeddings of some inputs.
    pub(super) fn joined(&self, modality: Modality) -> usize {
        let inputs = modality.inputs().into_iter();
        inputs
            .map(|name| self.embedding_of(EncoderKind::of(name)))
            .sum()
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

    /// Whether the last feature map of the touch encoder has the cells of [`ContactMaps`], so that it
    /// can learn them.
    pub fn has_contact(&self) -> bool {
        let [height, width, _] = self.shapes().last().map_or(IMAGE, ConvShape::output);
        self.geometry && [height, width] == ContactMaps::CELLS
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

/// Kind of encoder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum EncoderKind {
    /// Encoder of tactile differences.
    Touch,
    /// Encoder of the colour image.
    Vision,
    /// Encoder of the depth image.
    Depth,
}

impl EncoderKind {
    /// All kinds, in the order of the inputs.
    pub(crate) const ALL: [Self; 3] = [Self::Touch, Self::Vision, Self::Depth];

    /// The encoder of an input; both sensors share one.
    pub(crate) fn of(input: InputName) -> Self {
        match input {
            InputName::TactileLeft | InputName::TactileRight => Self::Touch,
            InputName::Rgb => Self::Vision,
            InputName::Depth => Self::Depth,
        }
    }

    /// Inputs of the encoder.
    pub(crate) fn inputs(self) -> &'static [InputName] {
        match self {
            Self::Touch => &[InputName::TactileLeft, InputName::TactileRight],
            Self::Vision => &[InputName::Rgb],
            Self::Depth => &[InputName::Depth],
        }
    }

    /// Name in parameter names.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Touch => "touch",
            Self::Vision => "vision",
            Self::Depth => "depth",
        }
    }

    /// Whether a classifier has it.
    pub(crate) fn is_in(self, modality: Modality) -> bool {
        self.inputs().iter().all(|name| modality.has(*name))
    }
}

/// Parameters of one encoder.
#[derive(Clone, Debug)]
pub(super) struct EncoderParams {
    pub(super) kind: EncoderKind,
    /// Weight, γ, β of each convolution.
    pub(super) convolutions: Vec<[Param; 3]>,
    /// Weight and bias.
    pub(super) projection: [Param; 2],
    /// Ranges of mean and variance of each convolution in the running statistics.
    pub(super) stats: Vec<[std::ops::Range<usize>; 2]>,
}

impl EncoderParams {
    /// All parameter tensors in order.
    pub(super) fn params(&self) -> impl Iterator<Item = &Param> {
        self.convolutions.iter().flatten().chain(&self.projection)
    }
}

/// Parameters of the dense layers on the embeddings of some inputs.
#[derive(Clone, Debug)]
pub(crate) struct HeadParams {
    /// The inputs.
    pub(crate) modality: Modality,
    /// Weight and bias of the hidden layer.
    pub(crate) hidden: [Param; 2],
    /// Weight and bias of the output layer.
    pub(crate) logit: [Param; 2],
    /// Whether it is set from the extents, not trained.
    pub(crate) reads_extents: bool,
}

impl HeadParams {
    /// All parameter tensors in order.
    pub(super) fn params(&self) -> impl Iterator<Item = &Param> {
        self.hidden.iter().chain(&self.logit)
    }
}

/// Layout of all parameters in one slice.
#[derive(Clone, Debug)]
pub struct Layout {
    pub(super) encoders: Vec<EncoderParams>,
    /// Those of all inputs first.
    pub(super) heads: Vec<HeadParams>,
    /// Weight and bias of the contact map at each cell of the touch encoder's last feature map;
    /// only training has it.
    pub(super) contact: Option<[Param; 2]>,
    params: Vec<Param>,
    running_stats_len: usize,
}

/// Start of the parameter names of a head.
pub(crate) fn head_name(head: Modality, all: Modality) -> String {
    if head == all {
        return "head".to_owned();
    }
    format!("head_{}", head.name().to_ascii_lowercase())
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
        let mut encoder = |kind: EncoderKind| {
            let shapes = architecture.shapes();
            let prefix = kind.name();
            let convolutions = shapes.iter().enumerate().map(|(i, shape)| {
                let channels = shape.channels;
                let name = |what: &str| format!("{prefix}.conv{}.{what}", i + 1);
                [
                    add(name("weight"), [shape.fan_in(), channels]),
                    add(name("gamma"), [1, channels]),
                    add(name("beta"), [1, channels]),
                ]
            });
            let convolutions = convolutions.collect();
            let pooled = architecture.pooled().iter().product();
            let embedding = architecture.embedding_of(kind);
            let projection = [
                add(format!("{prefix}.projection.weight"), [pooled, embedding]),
                add(format!("{prefix}.projection.bias"), [1, embedding]),
            ];
            let ranges = shapes.iter().map(|shape| {
                let mean = running_stats_len..running_stats_len + shape.channels;
                running_stats_len = mean.end + shape.channels;
                [mean.clone(), mean.end..running_stats_len]
            });
            EncoderParams {
                kind,
                convolutions,
                projection,
                stats: ranges.collect(),
            }
        };
        let kinds = EncoderKind::ALL.into_iter();
        let encoders: Vec<EncoderParams> = kinds
            .filter(|kind| kind.is_in(modality))
            .map(&mut encoder)
            .collect();
        let heads = architecture.heads(modality).into_iter().map(|head| {
            let name = head_name(head, modality);
            let hidden = architecture.hidden_of(head);
            HeadParams {
                modality: head,
                reads_extents: architecture.reads_extents(head),
                hidden: [
                    add(
                        format!("{name}.hidden.weight"),
                        [architecture.joined(head), hidden],
                    ),
                    add(format!("{name}.hidden.bias"), [1, hidden]),
                ],
                logit: [
                    add(format!("{name}.logit.weight"), [hidden, 1]),
                    add(format!("{name}.logit.bias"), [1, 1]),
                ],
            }
        });
        let heads: Vec<HeadParams> = heads.collect();
        let has_contact = architecture.has_contact() && EncoderKind::Touch.is_in(modality);
        let channels = architecture.convolutions.last().map_or(0, |c| c.channels);
        let contact = has_contact.then(|| {
            let weight = [channels, CONTACT_CHANNELS];
            [
                add("contact.projection.weight".to_owned(), weight),
                add("contact.projection.bias".to_owned(), [1, CONTACT_CHANNELS]),
            ]
        });
        Self {
            encoders,
            heads,
            contact,
            params,
            running_stats_len,
        }
    }

    /// All parameter tensors in order.
    pub fn params(&self) -> &[Param] {
        &self.params
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
