//! Input and output tensors of a model, and their preprocessing.

use std::fmt::{self, Debug, Display};

use serde::{Deserialize, Serialize};

use gripcast_imaging::{CropProfile, Role};
use gripcast_shear::ContactMaps;

/// Width of input images, pixels.
pub const IMAGE_WIDTH: u32 = 320;
/// Height of input images, pixels.
pub const IMAGE_HEIGHT: u32 = 240;
/// Shape of every input: one image, NCHW.
pub const INPUT_SHAPE: [i64; 4] = [1, 3, IMAGE_HEIGHT as i64, IMAGE_WIDTH as i64];
/// Name of the output, the probability that the grasp is stable; shape `[1, 1]`. Outputs of fewer
/// inputs have their modality appended, as `p_stable_t`.
pub const OUTPUT: &str = "p_stable";
/// Shape of the output.
pub const OUTPUT_SHAPE: [i64; 2] = [1, 1];
/// Number of values of a grasp's geometry, see [`GraspGeometry`](gripcast_geometry::GraspGeometry).
pub const GEOMETRY: usize = gripcast_geometry::GraspGeometry::LEN;
/// Unit of the geometry in networks and model files, m.
pub const GEOMETRY_UNIT_M: f64 = 0.03;
/// Shape of the output `geometry_rgb` or `geometry_depth`: the geometry in units of 0.03 m.
pub const GEOMETRY_SHAPE: [i64; 2] = [1, GEOMETRY as i64];

/// Rows and columns of the cells of a contact map.
pub const CONTACT_CELLS: [usize; 2] = ContactMaps::CELLS;
/// Numbers of a cell of a contact map as the touch encoder learns it: displacement into the gel, its
/// slope to the right and down, and the displacement to the right and down.
pub const CONTACT_CHANNELS: usize = 5;
/// Shape of the outputs `contact_tactile_left` and `contact_tactile_right`: planes of cells by
/// channel, in units of 0.25 mm for the displacement into the gel and 0.125 mm for the others.
pub const CONTACT_SHAPE: [i64; 2] = [
    1,
    (CONTACT_CHANNELS * CONTACT_CELLS[0] * CONTACT_CELLS[1]) as i64,
];

/// Name of the output of the predictions from `inputs` in a model with the inputs `all`.
#[must_use]
pub fn output_of(inputs: Modality, all: Modality) -> String {
    match inputs == all {
        true => OUTPUT.to_owned(),
        false => format!("{OUTPUT}_{}", inputs.name().to_ascii_lowercase()),
    }
}

/// Whether an output is a prediction from fewer inputs than the model has.
#[must_use]
pub fn is_fallback(output: &str) -> bool {
    let rest = output.strip_prefix(OUTPUT);
    rest.is_some_and(|rest| rest.starts_with('_'))
}

/// Name of the output of the geometry that is read from an input.
#[must_use]
pub fn geometry_output(input: InputName) -> String {
    format!("geometry_{input}")
}

/// Name of the output of the contact map that is read from a tactile input.
#[must_use]
pub fn contact_output(input: InputName) -> String {
    format!("contact_{input}")
}

/// Name of an input tensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum InputName {
    /// Difference of the left tactile sensor.
    TactileLeft,
    /// Difference of the right tactile sensor.
    TactileRight,
    /// Image of the colour camera.
    Rgb,
    /// Image of the depth camera, as points in the gripper frame.
    Depth,
}

impl InputName {
    /// All inputs in order.
    pub const ALL: [Self; 4] = [
        Self::TactileLeft,
        Self::TactileRight,
        Self::Rgb,
        Self::Depth,
    ];

    /// Name in the graph.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::TactileLeft => "tactile_left",
            Self::TactileRight => "tactile_right",
            Self::Rgb => "rgb",
            Self::Depth => "depth",
        }
    }

    /// Role of the camera.
    #[must_use]
    pub fn role(self) -> Role {
        match self {
            Self::TactileLeft => Role::Left,
            Self::TactileRight => Role::Right,
            Self::Rgb => Role::Rgb,
            Self::Depth => Role::Depth,
        }
    }
}

impl Display for InputName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// Modalities that a model uses: a non-empty set of vision (V), touch (T) and depth (D).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
pub enum Modality {
    /// Colour image, both tactile differences and depth image.
    Vtd,
    /// Colour image and tactile differences.
    Vt,
    /// Tactile differences and depth image.
    Td,
    /// Tactile differences.
    T,
    /// Colour and depth image.
    Vd,
    /// Colour image.
    V,
    /// Depth image.
    D,
}

impl Modality {
    /// All modalities; those with touch first, more inputs before fewer.
    pub const ALL: [Self; 7] = [
        Self::Vtd,
        Self::Vt,
        Self::Td,
        Self::T,
        Self::Vd,
        Self::V,
        Self::D,
    ];

    /// Returns the modality of a set of inputs; none without a complete one.
    #[must_use]
    pub fn of(has: impl Fn(InputName) -> bool) -> Option<Self> {
        let complete = |modality: &Self| modality.inputs().into_iter().all(&has);
        Self::ALL.into_iter().find(complete)
    }

    /// Returns the modality of a name.
    #[must_use]
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|m| m.name() == name)
    }

    /// Inputs of a model with these modalities.
    #[must_use]
    pub fn inputs(self) -> Vec<InputName> {
        let all = InputName::ALL.into_iter();
        all.filter(|name| self.has(*name)).collect()
    }

    /// Whether it includes an input.
    #[must_use]
    pub fn has(self, input: InputName) -> bool {
        match input {
            InputName::TactileLeft | InputName::TactileRight => self.has_touch(),
            InputName::Rgb => self.has_vision(),
            InputName::Depth => self.has_depth(),
        }
    }

    /// Whether it includes all inputs of another.
    #[must_use]
    pub fn includes(self, other: Self) -> bool {
        other.inputs().into_iter().all(|name| self.has(name))
    }

    /// Returns the camera inputs; none without one.
    pub fn cameras(self) -> Option<Self> {
        Self::of(|name| !name.role().is_tactile() && self.has(name))
    }

    /// All modalities that it includes, itself first.
    #[must_use]
    pub fn subsets(self) -> Vec<Self> {
        let all = Self::ALL.into_iter();
        all.filter(|other| self.includes(*other)).collect()
    }

    /// Whether it includes the tactile differences.
    #[must_use]
    pub fn has_touch(self) -> bool {
        matches!(self, Self::Vtd | Self::Vt | Self::Td | Self::T)
    }

    /// Whether it includes the colour image.
    #[must_use]
    pub fn has_vision(self) -> bool {
        matches!(self, Self::Vtd | Self::Vt | Self::Vd | Self::V)
    }

    /// Whether it includes the depth image.
    #[must_use]
    pub fn has_depth(self) -> bool {
        matches!(self, Self::Vtd | Self::Td | Self::Vd | Self::D)
    }

    /// Name in the metadata.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Vtd => "VTD",
            Self::Vt => "VT",
            Self::Td => "TD",
            Self::T => "T",
            Self::Vd => "VD",
            Self::V => "V",
            Self::D => "D",
        }
    }

    /// What it is, in words.
    #[must_use]
    pub fn words(self) -> &'static str {
        match self {
            Self::Vtd => "vision, touch and depth",
            Self::Vt => "vision and touch",
            Self::Td => "touch and depth",
            Self::T => "touch",
            Self::Vd => "vision and depth",
            Self::V => "vision",
            Self::D => "depth",
        }
    }
}

impl Display for Modality {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// Specification of an input tensor and its preprocessing.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InputSpec {
    /// Name in the graph.
    pub name: InputName,
    /// `[1, 3, 240, 320]`.
    pub shape: Vec<i64>,
    /// `f32`.
    pub dtype: String,
    /// `NCHW`.
    pub layout: String,
    /// `RGB`: order of the channels; `XYD` for the depth image.
    pub colour: String,
    /// `diff` (tactile difference), `normalised` (colour image) or `points` (depth image).
    pub encoding: String,
    /// Formula of a value from 8-bit pixels.
    pub formula: String,
    /// Minimum and maximum value; tactile differences only.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub range: Option<[f32; 2]>,
    /// Mean of each channel of [0, 1] pixels; colour image only.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mean: Option<[f32; 3]>,
    /// Standard deviation of each channel of [0, 1] pixels; colour image only.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub std: Option<[f32; 3]>,
    /// Resize method to 320×240; colour image only.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub resize: Option<String>,
    /// Crop before the resize; colour image only.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub crop: Option<String>,
}

impl InputSpec {
    /// Specification of a tactile difference.
    pub fn tactile(name: InputName) -> Self {
        Self {
            name,
            shape: INPUT_SHAPE.to_vec(),
            dtype: "f32".to_owned(),
            layout: "NCHW".to_owned(),
            colour: "RGB".to_owned(),
            encoding: "diff".to_owned(),
            formula: "(grasp-initial)/255".to_owned(),
            range: Some([-1.0, 1.0]),
            mean: None,
            std: None,
            resize: None,
            crop: None,
        }
    }

    /// Specification of the colour image, normalised with the statistics of the training data.
    pub fn rgb(normalisation: RgbNormalisation) -> Self {
        Self {
            encoding: "normalised".to_owned(),
            formula: "(x/255-mean)/std".to_owned(),
            range: None,
            mean: Some(normalisation.mean),
            std: Some(normalisation.std),
            resize: Some("bilinear-antialias".to_owned()),
            crop: Some(CropProfile::FULL.name().to_owned()),
            ..Self::tactile(InputName::Rgb)
        }
    }

    /// Specification of the depth image: for each pixel of the colour camera x and y of the surface
    /// in the gripper frame and its inverse depth; zeros where there is no depth.
    pub fn depth() -> Self {
        Self {
            colour: "XYD".to_owned(),
            encoding: "points".to_owned(),
            formula: "x/0.1 m, y/0.1 m, 0.2 m/depth; 0 without depth".to_owned(),
            range: None,
            resize: Some("nearest".to_owned()),
            crop: Some(CropProfile::FULL.name().to_owned()),
            ..Self::tactile(InputName::Depth)
        }
    }

    /// Normalisation of a colour image.
    pub fn normalisation(&self) -> Option<RgbNormalisation> {
        Some(RgbNormalisation {
            mean: self.mean?,
            std: self.std?,
        })
    }

    /// Compares with the specification of this build; returns the first difference.
    pub(super) fn check(&self) -> Result<(), String> {
        let expected = match self.name {
            InputName::TactileLeft | InputName::TactileRight => Self::tactile(self.name),
            InputName::Rgb => {
                let normalisation = self
                    .normalisation()
                    .filter(RgbNormalisation::is_usable)
                    .ok_or_else(|| {
                        format!(
                            "input `rgb`: expected `mean` of three finite numbers and `std` of \
                             three numbers above 0, found mean {:?} and std {:?}",
                            self.mean, self.std
                        )
                    })?;
                Self::rgb(normalisation)
            }
            InputName::Depth => Self::depth(),
        };
        for ((field, found), (_, expected)) in self.fields().into_iter().zip(expected.fields()) {
            if found != expected {
                let name = self.name;
                return Err(format!(
                    "input `{name}`: expected {field} {expected}, found {found}"
                ));
            }
        }
        Ok(())
    }

    fn fields(&self) -> [(&'static str, String); 11] {
        let text = |value: &dyn Debug| format!("{value:?}");
        [
            ("shape", text(&self.shape)),
            ("dtype", text(&self.dtype)),
            ("layout", text(&self.layout)),
            ("colour", text(&self.colour)),
            ("encoding", text(&self.encoding)),
            ("formula", text(&self.formula)),
            ("range", text(&self.range)),
            ("mean", text(&self.mean)),
            ("std", text(&self.std)),
            ("resize", text(&self.resize)),
            ("crop", text(&self.crop)),
        ]
    }
}

/// Mean and standard deviation of each channel of [0, 1] pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RgbNormalisation {
    /// Mean, red green blue.
    pub mean: [f32; 3],
    /// Standard deviation, red green blue.
    pub std: [f32; 3],
}

impl RgbNormalisation {
    /// Leaves pixels as they are.
    pub const NONE: Self = Self {
        mean: [0.0; 3],
        std: [1.0; 3],
    };

    fn is_usable(&self) -> bool {
        self.mean.iter().all(|x| x.is_finite())
            && self.std.iter().all(|&x| x > 0.0 && x.is_finite())
    }
}
