//! Input and output tensors of a model, and their preprocessing.

use std::fmt::{self, Debug, Display};

use serde::{Deserialize, Serialize};

use gripcast_imaging::{CropProfile, Role};

/// Width of input images, pixels.
pub const IMAGE_WIDTH: u32 = 320;
/// Height of input images, pixels.
pub const IMAGE_HEIGHT: u32 = 240;
/// Shape of every input: one image, NCHW.
pub const INPUT_SHAPE: [i64; 4] = [1, 3, IMAGE_HEIGHT as i64, IMAGE_WIDTH as i64];
/// Name of the output, the probability that the grasp is stable; shape `[1, 1]`.
pub const OUTPUT: &str = "p_stable";
/// Shape of the output.
pub const OUTPUT_SHAPE: [i64; 2] = [1, 1];

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
}

impl InputName {
    /// Name in the graph.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::TactileLeft => "tactile_left",
            Self::TactileRight => "tactile_right",
            Self::Rgb => "rgb",
        }
    }

    /// Role of the camera.
    #[must_use]
    pub fn role(self) -> Role {
        match self {
            Self::TactileLeft => Role::Left,
            Self::TactileRight => Role::Right,
            Self::Rgb => Role::Rgb,
        }
    }
}

impl Display for InputName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// Modalities that a model uses: a non-empty set of vision (V) and touch (T).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Modality {
    /// Vision only.
    V,
    /// Touch only.
    T,
    /// Vision and touch.
    #[serde(rename = "VT")]
    Vt,
}

impl Modality {
    /// Inputs of a model with these modalities.
    #[must_use]
    pub fn inputs(self) -> &'static [InputName] {
        use InputName::{Rgb, TactileLeft, TactileRight};
        match self {
            Self::V => &[Rgb],
            Self::T => &[TactileLeft, TactileRight],
            Self::Vt => &[TactileLeft, TactileRight, Rgb],
        }
    }

    /// Whether it includes the tactile differences.
    #[must_use]
    pub fn has_touch(self) -> bool {
        self != Self::V
    }

    /// Whether it includes the colour image.
    #[must_use]
    pub fn has_vision(self) -> bool {
        self != Self::T
    }

    /// Name in the metadata.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::V => "V",
            Self::T => "T",
            Self::Vt => "VT",
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
    /// `RGB`: order of the channels.
    pub colour: String,
    /// `diff` (tactile difference) or `normalised` (colour image).
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
