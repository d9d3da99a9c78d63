//! The contract between a model file and gripcast, kept in the file's `metadata_props`.
//!
//! A model says which tensors it wants, how they are made from pictures, what its output means and
//! where it comes from. Whatever does not agree with the graph or with this build is refused with
//! the key, what was expected and what was found: a model that is fed something else than it was
//! made for answers without complaint, and wrongly.
//!
//! | key | value |
//! | --- | --- |
//! | `gripcast.schema` | `1` |
//! | `gripcast.name` | name of the model |
//! | `gripcast.kind` | `trained` or `heuristic` |
//! | `gripcast.variant` | `V`, `T` or `VT` |
//! | `gripcast.inputs` | JSON list of [`InputSpec`] |
//! | `gripcast.output` | `p_stable` |
//! | `gripcast.threshold` | at or above it the grasp counts as stable; in (0, 1) |
//! | `gripcast.temperature` | calibration temperature, already part of the graph |
//! | `gripcast.crop_profile` | crop of the tactile pictures; `any` where the model does not depend on it |
//! | `gripcast.seed`, `gripcast.train.manifest_sha256` | origin of a trained model; `none` for a heuristic |
//! | `gripcast.card` | Markdown: intended use, data, limits, licence |
//! | other `gripcast.*` | validation figures, split digests, simulator, date; kept as they are |

use std::collections::BTreeMap;
use std::fmt::{self, Debug, Display};
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use tract_onnx::pb::ModelProto;

use super::graph_check::check_graph;
use super::onnx::OnnxGraphBuilder;
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_imaging::{CropProfile, Role};

/// Version of the contract that this build reads and writes.
pub const SCHEMA: u32 = 1;
/// Width of every picture that becomes a tensor, pixels.
pub const IMAGE_WIDTH: u32 = 320;
/// Height of every picture that becomes a tensor, pixels.
pub const IMAGE_HEIGHT: u32 = 240;
/// Shape of every input: one picture, NCHW.
pub const INPUT_SHAPE: [i64; 4] = [1, 3, IMAGE_HEIGHT as i64, IMAGE_WIDTH as i64];
/// Name of the output, the probability that the grasp is stable; shape `[1, 1]`.
pub const OUTPUT: &str = "p_stable";
/// Shape of the output.
pub const OUTPUT_SHAPE: [i64; 2] = [1, 1];

/// Crop profile of a model that does not depend on the crop.
const ANY_CROP: &str = "any";
const NONE: &str = "none";
const HOW_TO_EXPORT: &str = "export the model again with gripcast's contract, see models/README.md";

/// An input tensor; the name in the graph.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum InputName {
    /// Difference of the left tactile sensor.
    TactileLeft,
    /// Difference of the right tactile sensor.
    TactileRight,
    /// Picture of the colour camera.
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

    /// Camera whose pictures it is made from.
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

/// Senses that a model uses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Variant {
    /// Vision alone.
    V,
    /// Touch alone.
    T,
    /// Vision and touch.
    #[serde(rename = "VT")]
    Vt,
}

impl Variant {
    /// Inputs of a model of this variant.
    #[must_use]
    pub fn inputs(self) -> &'static [InputName] {
        use InputName::{Rgb, TactileLeft, TactileRight};
        match self {
            Self::V => &[Rgb],
            Self::T => &[TactileLeft, TactileRight],
            Self::Vt => &[TactileLeft, TactileRight, Rgb],
        }
    }

    /// Whether it sees the tactile differences.
    #[must_use]
    pub fn has_touch(self) -> bool {
        self != Self::V
    }

    /// Whether it sees the colour picture.
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

impl Display for Variant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// Where a model comes from.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase", tag = "kind")]
pub enum Origin {
    /// Learned from labelled grasps.
    Trained {
        /// Seed of the run.
        seed: u64,
        /// sha256 of the manifest of the training data, lower-case hex.
        manifest_sha256: String,
    },
    /// Written by hand; never measured on outcomes.
    Heuristic,
}

impl Origin {
    /// Name in the metadata.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Trained { .. } => "trained",
            Self::Heuristic => "heuristic",
        }
    }
}

/// One input tensor and how it is made from pictures.
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
    /// `diff` (tactile difference) or `normalised` (colour picture).
    pub encoding: String,
    /// How a value follows from 8-bit pixels.
    pub formula: String,
    /// Smallest and largest value, tactile differences.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub range: Option<[f32; 2]>,
    /// Mean of each channel of [0, 1] pixels, colour picture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mean: Option<[f32; 3]>,
    /// Standard deviation of each channel of [0, 1] pixels, colour picture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub std: Option<[f32; 3]>,
    /// How a picture of another size becomes 320×240, colour picture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub resize: Option<String>,
    /// Crop before the resize, colour picture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub crop: Option<String>,
}

impl InputSpec {
    /// A tactile difference.
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

    /// The colour picture, standardised with the statistics of the training data.
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

    /// Mean and deviation of a colour picture.
    pub fn normalisation(&self) -> Option<RgbNormalisation> {
        Some(RgbNormalisation {
            mean: self.mean?,
            std: self.std?,
        })
    }

    fn check(&self) -> Result<()> {
        let expected = match self.name {
            InputName::TactileLeft | InputName::TactileRight => Self::tactile(self.name),
            InputName::Rgb => {
                let normalisation = self
                    .normalisation()
                    .filter(RgbNormalisation::is_usable)
                    .ok_or_else(|| {
                        refusal(format!(
                            "input `rgb` needs `mean` (three finite numbers) and `std` (three \
                             numbers above 0), found mean {:?} and std {:?}",
                            self.mean, self.std
                        ))
                    })?;
                Self::rgb(normalisation)
            }
        };
        for ((field, found), (_, expected)) in self.fields().into_iter().zip(expected.fields()) {
            if found != expected {
                return Err(refusal(format!(
                    "input `{}`: expected {field} {expected}, found {found}",
                    self.name
                )));
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
    fn is_usable(&self) -> bool {
        self.mean.iter().all(|x| x.is_finite())
            && self.std.iter().all(|&x| x > 0.0 && x.is_finite())
    }
}

/// What a model file promises.
#[derive(Clone, Debug, PartialEq)]
pub struct ModelContract {
    /// Name of the model.
    pub name: String,
    /// Where the model comes from.
    pub origin: Origin,
    /// Senses that it uses.
    pub variant: Variant,
    /// Inputs, in the order of [`Variant::inputs`].
    pub inputs: Vec<InputSpec>,
    /// At or above this probability the grasp counts as stable; in (0, 1).
    pub threshold: f64,
    /// Calibration temperature, already part of the graph.
    pub temperature: f64,
    /// Crop of the tactile pictures; `None` where the model does not depend on it.
    pub crop_profile: Option<CropProfile>,
    /// Markdown: intended use, data, limits, licence.
    pub card: String,
    /// Other `gripcast.*` metadata.
    pub other: BTreeMap<String, String>,
}

impl ModelContract {
    /// Reads the contract of a model and holds it against the model's graph.
    ///
    /// # Errors
    /// When a key is missing or wrong, or the graph does not keep what the contract promises.
    pub fn of(model: &ModelProto) -> Result<Self> {
        let read = || {
            let contract = Self::from_metadata(model)?;
            check_graph(&contract, model)?;
            Ok(contract)
        };
        read().map_err(|error: Error| error.remedy(HOW_TO_EXPORT))
    }

    /// Writes the contract into a graph that is being built.
    ///
    /// # Errors
    /// When the contract itself would be refused.
    pub fn write(&self, graph: &mut OnnxGraphBuilder) -> Result<()> {
        self.check()?;
        let inputs = serde_json::to_string(&self.inputs).map_err(|cause| {
            Error::new(ErrorKind::Internal, "cannot write the inputs").because(cause)
        })?;
        for (key, value) in &self.other {
            graph.metadata(key, value);
        }
        let (seed, manifest) = match &self.origin {
            Origin::Trained {
                seed,
                manifest_sha256,
            } => (seed.to_string(), manifest_sha256.clone()),
            Origin::Heuristic => (NONE.to_owned(), NONE.to_owned()),
        };
        graph.metadata("gripcast.schema", SCHEMA.to_string());
        graph.metadata("gripcast.name", &self.name);
        graph.metadata("gripcast.kind", self.origin.name());
        graph.metadata("gripcast.variant", self.variant.name());
        graph.metadata("gripcast.inputs", inputs);
        graph.metadata("gripcast.output", OUTPUT);
        graph.metadata("gripcast.threshold", self.threshold.to_string());
        graph.metadata("gripcast.temperature", self.temperature.to_string());
        graph.metadata("gripcast.crop_profile", self.crop_profile_name());
        graph.metadata("gripcast.seed", seed);
        graph.metadata("gripcast.train.manifest_sha256", manifest);
        graph.metadata("gripcast.card", &self.card);
        Ok(())
    }

    /// The input named `name`, if the model uses it.
    #[must_use]
    pub fn input(&self, name: InputName) -> Option<&InputSpec> {
        self.inputs.iter().find(|input| input.name == name)
    }

    /// Whether the model was written by hand and not trained.
    #[must_use]
    pub fn is_heuristic(&self) -> bool {
        self.origin == Origin::Heuristic
    }

    /// Refuses a rig whose tactile pictures are cropped in another way than the model's were.
    ///
    /// # Errors
    /// When the profiles differ.
    pub fn check_crop_profile(&self, rig_profile: &str) -> Result<()> {
        let wanted = match self.crop_profile {
            Some(profile) if profile.name() != rig_profile => profile,
            _ => return Ok(()),
        };
        Err(refusal(format!(
            "the model `{}` was made for the crop profile `{wanted}`, the tactile pictures are \
             cropped with `{rig_profile}`",
            self.name
        ))
        .remedy(format!(
            "crop with `{wanted}` (`crop_profile` of the tactile cameras in the rig file), or use \
             a model that was made for `{rig_profile}`"
        )))
    }

    /// Name of the crop profile, or `any`.
    #[must_use]
    pub fn crop_profile_name(&self) -> &'static str {
        self.crop_profile.map_or(ANY_CROP, |profile| profile.name())
    }

    fn from_metadata(model: &ModelProto) -> Result<Self> {
        let mut metadata = Metadata::of(model)?;
        let schema: u32 = metadata.parse("gripcast.schema", "a whole number")?;
        if schema != SCHEMA {
            return Err(Error::new(
                ErrorKind::Input,
                format!("`gripcast.schema`: expected {SCHEMA}, found {schema}"),
            )
            .remedy(if schema > SCHEMA {
                "the model is newer than this gripcast: update gripcast, or export the model for \
                 this version"
            } else {
                HOW_TO_EXPORT
            }));
        }
        let variant = match metadata.take("gripcast.variant")?.as_str() {
            "V" => Variant::V,
            "T" => Variant::T,
            "VT" => Variant::Vt,
            found => {
                return Err(refusal(format!(
                    "`gripcast.variant`: expected V, T or VT, found `{found}`"
                )));
            }
        };
        let inputs: Vec<InputSpec> = serde_json::from_str(&metadata.take("gripcast.inputs")?)
            .map_err(|cause| {
                refusal("`gripcast.inputs` is no list of input descriptions").because(cause)
            })?;
        let output = metadata.take("gripcast.output")?;
        if output != OUTPUT {
            return Err(refusal(format!(
                "`gripcast.output`: expected `{OUTPUT}`, found `{output}`"
            )));
        }
        let kind = metadata.take("gripcast.kind")?;
        let origin = match kind.as_str() {
            "heuristic" => {
                metadata.take("gripcast.seed")?;
                metadata.take("gripcast.train.manifest_sha256")?;
                Origin::Heuristic
            }
            "trained" => Origin::Trained {
                seed: metadata.parse("gripcast.seed", "a whole number")?,
                manifest_sha256: metadata.take("gripcast.train.manifest_sha256")?,
            },
            found => {
                return Err(refusal(format!(
                    "`gripcast.kind`: expected `trained` or `heuristic`, found `{found}`"
                )));
            }
        };
        let mut contract = Self {
            name: metadata.take("gripcast.name")?,
            origin,
            variant,
            inputs,
            threshold: metadata.parse("gripcast.threshold", "a number")?,
            temperature: metadata.parse("gripcast.temperature", "a number")?,
            crop_profile: metadata.crop_profile()?,
            card: metadata.take("gripcast.card")?,
            other: metadata.rest(),
        };
        contract.check()?;
        contract.inputs.sort_by_key(|input| input.name);
        Ok(contract)
    }

    fn check(&self) -> Result<()> {
        if self.name.trim().is_empty() {
            return Err(refusal("`gripcast.name` is empty"));
        }
        if !(self.threshold > 0.0 && self.threshold < 1.0) {
            return Err(refusal(format!(
                "`gripcast.threshold`: expected a probability between 0 and 1, found {}",
                self.threshold
            )));
        }
        if !(self.temperature > 0.0 && self.temperature.is_finite()) {
            return Err(refusal(format!(
                "`gripcast.temperature`: expected a finite number above 0, found {}",
                self.temperature
            )));
        }
        if let Origin::Trained {
            manifest_sha256, ..
        } = &self.origin
            && !is_sha256(manifest_sha256)
        {
            return Err(refusal(format!(
                "`gripcast.train.manifest_sha256`: expected 64 lower-case hex digits, found \
                 `{manifest_sha256}`"
            )));
        }
        if self.crop_profile.is_none() && !self.is_heuristic() && self.variant != Variant::V {
            // What a network learned depends on the crop, whether or not its author knows.
            return Err(refusal(format!(
                "`gripcast.crop_profile`: a trained model with touch must name its crop profile, \
                 found `{ANY_CROP}`"
            )));
        }
        let mut named: Vec<_> = self.inputs.iter().map(|input| input.name).collect();
        named.sort_unstable();
        if named != self.variant.inputs() {
            return Err(refusal(format!(
                "`gripcast.inputs`: a model of variant {} has the inputs {}, found {}",
                self.variant,
                list(self.variant.inputs()),
                list(&named)
            )));
        }
        self.inputs.iter().try_for_each(InputSpec::check)
    }
}

/// `metadata_props` as a map that is emptied while it is read.
struct Metadata(BTreeMap<String, String>);

impl Metadata {
    fn of(model: &ModelProto) -> Result<Self> {
        let mut map = BTreeMap::new();
        for entry in &model.metadata_props {
            if map.insert(entry.key.clone(), entry.value.clone()).is_some() {
                return Err(refusal(format!(
                    "the metadata has the key `{}` twice",
                    entry.key
                )));
            }
        }
        Ok(Self(map))
    }

    fn take(&mut self, key: &str) -> Result<String> {
        self.0.remove(key).ok_or_else(|| {
            let what = if key == "gripcast.schema" {
                "an ONNX file, but no gripcast model: the metadata has no key `gripcast.schema`"
                    .to_owned()
            } else {
                format!("the model's metadata has no key `{key}`")
            };
            refusal(what)
        })
    }

    fn parse<T: FromStr>(&mut self, key: &str, expected: &str) -> Result<T> {
        let text = self.take(key)?;
        text.trim()
            .parse()
            .map_err(|_| refusal(format!("`{key}`: expected {expected}, found `{text}`")))
    }

    fn crop_profile(&mut self) -> Result<Option<CropProfile>> {
        let name = self.take("gripcast.crop_profile")?;
        if name == ANY_CROP {
            return Ok(None);
        }
        CropProfile::by_name(&name).map(Some).map_err(|unknown| {
            let error = refusal(format!("`gripcast.crop_profile`: {}", unknown.what()));
            error.remedy(unknown.remedy_text().unwrap_or(HOW_TO_EXPORT))
        })
    }

    fn rest(self) -> BTreeMap<String, String> {
        self.0
            .into_iter()
            .filter(|(key, _)| key.starts_with("gripcast."))
            .collect()
    }
}

fn is_sha256(text: &str) -> bool {
    text.len() == 64
        && text
            .bytes()
            .all(|b| b.is_ascii_digit() || (b'a'..=b'f').contains(&b))
}

pub(super) fn refusal(what: impl Into<String>) -> Error {
    Error::new(ErrorKind::Input, what)
}

pub(super) fn list<T: Display>(items: impl IntoIterator<Item = T>) -> String {
    let names: Vec<String> = items.into_iter().map(|item| format!("`{item}`")).collect();
    if names.is_empty() {
        "none".to_owned()
    } else {
        names.join(", ")
    }
}

#[cfg(test)]
#[path = "contract_test.rs"]
mod tests;
