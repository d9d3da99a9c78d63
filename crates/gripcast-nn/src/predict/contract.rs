//! Contract between a model file and gripcast, stored in the file's `metadata_props`.
//!
//! It specifies input tensors, preprocessing, meaning of the output and origin of the model. Any
//! mismatch with the graph or with this build is refused with key, expected and found value: a
//! model with wrong inputs would silently predict wrong values.
//!
//! | key | value |
//! | --- | --- |
//! | `gripcast.schema` | `1` |
//! | `gripcast.name` | name of the model |
//! | `gripcast.kind` | `trained` or `heuristic` |
//! | `gripcast.variant` | modalities: `V`, `T`, `VT`, `D`, `VD`, `TD` or `VTD` |
//! | `gripcast.inputs` | JSON list of [`InputSpec`] |
//! | `gripcast.output` | `p_stable` |
//! | `gripcast.threshold` | decision threshold: stable at or above it; in (0, 1) |
//! | `gripcast.temperature` | calibration temperature, already part of the graph |
//! | `gripcast.fallbacks` | JSON list of [`OutputSpec`]: outputs from fewer inputs, `p_stable_t`, …; absent without any |
//! | `gripcast.geometry` | JSON list of the inputs from which the graph reads the geometry, output `geometry_depth`, …; absent without any |
//! | `gripcast.contact` | JSON list of the tactile inputs from which the graph reads contact maps, outputs `contact_tactile_left`, …; absent without any |
//! | `gripcast.crop_profile` | crop of the tactile images; `any` if the model does not depend on it |
//! | `gripcast.seed`, `gripcast.train.manifest_sha256` | origin of a trained model; `none` for a heuristic |
//! | `gripcast.card` | Markdown: intended use, data, limits, licence |
//! | other `gripcast.*` | validation metrics, split digests, simulator, date; not interpreted |

use std::collections::BTreeMap;
use std::str::FromStr;

use prost::Message as _;
use serde::{Deserialize, Serialize};
use tract_onnx::pb::{ModelProto, StringStringEntryProto};

use super::graph_check::{check_graph, list, refusal};
use super::onnx::OnnxGraphBuilder;
pub use super::tensors::{
    CONTACT_CELLS, CONTACT_CHANNELS, CONTACT_SHAPE, GEOMETRY, GEOMETRY_SHAPE, GEOMETRY_UNIT_M,
    IMAGE_HEIGHT, IMAGE_WIDTH, INPUT_SHAPE, InputName, InputSpec, Modality, OUTPUT, OUTPUT_SHAPE,
    RgbNormalisation, contact_output, geometry_output, is_fallback, output_of,
};
use gripcast_base::error::{Error, Result};
use gripcast_imaging::CropProfile;

/// Supported version of the contract.
pub const SCHEMA: u32 = 1;
/// Crop profile of a model that does not depend on the crop.
const ANY_CROP: &str = "any";
const NONE: &str = "none";
/// Key of the outputs from fewer inputs.
const FALLBACKS: &str = "gripcast.fallbacks";
/// Key of the inputs from which the geometry is read.
const GEOMETRY_INPUTS: &str = "gripcast.geometry";
/// Key of the inputs from which contact maps are read.
const CONTACT_INPUTS: &str = "gripcast.contact";
/// Start of the contract's keys.
const PREFIX: &str = "gripcast.";
const HOW_TO_EXPORT: &str = "write gripcast's contract into the file with `gripcast predict stamp`, \
                             see models/README.md";

/// Origin of a model.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase", tag = "kind")]
pub enum Origin {
    /// Trained on labelled grasps.
    Trained {
        /// Seed of the run.
        seed: u64,
        /// sha256 of the manifest of the training data, lower-case hex.
        manifest_sha256: String,
    },
    /// Written by hand; not evaluated on outcomes.
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

/// A prediction that a model makes from some of its inputs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OutputSpec {
    /// The inputs.
    #[serde(rename = "variant")]
    pub modality: Modality,
    /// Decision threshold: the grasp is predicted stable at or above it; in (0, 1).
    pub threshold: f64,
    /// Calibration temperature, already part of the graph.
    pub temperature: f64,
}

/// Contract of a model file.
#[derive(Clone, Debug, PartialEq)]
pub struct ModelContract {
    /// Name of the model.
    pub name: String,
    /// Origin of the model.
    pub origin: Origin,
    /// Modalities of the inputs.
    pub modality: Modality,
    /// Inputs, in the order of [`Modality::inputs`].
    pub inputs: Vec<InputSpec>,
    /// Decision threshold: the grasp is predicted stable at or above it; in (0, 1).
    pub threshold: f64,
    /// Calibration temperature, already part of the graph.
    pub temperature: f64,
    /// Predictions from fewer inputs, in the order of [`Modality::ALL`].
    pub fallbacks: Vec<OutputSpec>,
    /// Inputs from which the graph reads the geometry of the grasp.
    pub geometry: Vec<InputName>,
    /// Tactile inputs from which the graph reads contact maps: both or none.
    pub contact: Vec<InputName>,
    /// Crop of the tactile images; `None` if the model does not depend on it.
    pub crop_profile: Option<CropProfile>,
    /// Markdown: intended use, data, limits, licence.
    pub card: String,
    /// Other `gripcast.*` metadata.
    pub other: BTreeMap<String, String>,
}

impl ModelContract {
    /// Reads the contract of a model and checks it against the graph.
    ///
    /// # Errors
    /// When a key is missing or invalid, or the graph violates the contract.
    pub fn from_proto(model: &ModelProto) -> Result<Self> {
        let read = || {
            let contract = Self::from_metadata(model)?;
            check_graph(&contract, model)?;
            Ok(contract)
        };
        read().map_err(|error: Error| error.remedy(HOW_TO_EXPORT))
    }

    /// Writes the contract into the metadata of a graph.
    ///
    /// # Errors
    /// When the contract is invalid.
    pub fn write(&self, graph: &mut OnnxGraphBuilder) -> Result<()> {
        for (key, value) in self.metadata()? {
            graph.metadata(&key, value);
        }
        Ok(())
    }

    /// Writes the contract into the metadata of an ONNX file, in place of one that it may have.
    /// Network and other metadata stay as they are.
    ///
    /// # Errors
    /// When the contract is invalid, the bytes are no ONNX file, or the network violates the
    /// contract.
    pub fn stamp(&self, onnx: &[u8]) -> Result<Vec<u8>> {
        let mut model = super::onnx::decode(onnx)?;
        let metadata = self.metadata()?;
        let entries = &mut model.metadata_props;
        entries.retain(|entry| !entry.key.starts_with(PREFIX));
        entries.extend(
            metadata
                .into_iter()
                .map(|(key, value)| StringStringEntryProto { key, value }),
        );
        check_graph(self, &model)?;
        Ok(model.encode_to_vec())
    }

    /// Returns the pairs of the metadata.
    fn metadata(&self) -> Result<BTreeMap<String, String>> {
        self.check()?;
        let inputs = serde_json::to_string(&self.inputs)
            .map_err(|cause| Error::internal("cannot write the inputs").because(cause))?;
        let (seed, manifest) = match &self.origin {
            Origin::Trained {
                seed,
                manifest_sha256,
            } => (seed.to_string(), manifest_sha256.clone()),
            Origin::Heuristic => (NONE.to_owned(), NONE.to_owned()),
        };
        let pairs = [
            ("gripcast.schema", SCHEMA.to_string()),
            ("gripcast.name", self.name.clone()),
            ("gripcast.kind", self.origin.name().to_owned()),
            ("gripcast.variant", self.modality.name().to_owned()),
            ("gripcast.inputs", inputs),
            ("gripcast.output", OUTPUT.to_owned()),
            ("gripcast.threshold", self.threshold.to_string()),
            ("gripcast.temperature", self.temperature.to_string()),
            ("gripcast.crop_profile", self.crop_profile_name().to_owned()),
            ("gripcast.seed", seed),
            ("gripcast.train.manifest_sha256", manifest),
            ("gripcast.card", self.card.clone()),
        ];
        let mut metadata = self.other.clone();
        let text = |list: serde_json::Result<String>| {
            list.map_err(|cause| Error::internal("cannot write the outputs").because(cause))
        };
        if !self.fallbacks.is_empty() {
            let list = text(serde_json::to_string(&self.fallbacks))?;
            metadata.insert(FALLBACKS.to_owned(), list);
        }
        if !self.geometry.is_empty() {
            let list = text(serde_json::to_string(&self.geometry))?;
            metadata.insert(GEOMETRY_INPUTS.to_owned(), list);
        }
        if !self.contact.is_empty() {
            let list = text(serde_json::to_string(&self.contact))?;
            metadata.insert(CONTACT_INPUTS.to_owned(), list);
        }
        metadata.extend(pairs.map(|(key, value)| (key.to_owned(), value)));
        Ok(metadata)
    }

    /// Specification of an input, if the model uses it.
    #[must_use]
    pub fn input(&self, name: InputName) -> Option<&InputSpec> {
        self.inputs.iter().find(|input| input.name == name)
    }

    /// All predictions of the model, those from all inputs first.
    pub fn outputs(&self) -> impl Iterator<Item = OutputSpec> + '_ {
        let all = OutputSpec {
            modality: self.modality,
            threshold: self.threshold,
            temperature: self.temperature,
        };
        [all].into_iter().chain(self.fallbacks.iter().copied())
    }

    /// The prediction that uses most of the available inputs; none if no prediction can be made
    /// from them.
    #[must_use]
    pub fn output_from(&self, is_available: impl Fn(InputName) -> bool) -> Option<OutputSpec> {
        let complete =
            |output: &OutputSpec| output.modality.inputs().into_iter().all(&is_available);
        self.outputs().find(complete)
    }

    /// Whether the model is a heuristic, not trained.
    #[must_use]
    pub fn is_heuristic(&self) -> bool {
        self.origin == Origin::Heuristic
    }

    /// Refuses a rig whose crop profile differs from that of the model.
    ///
    /// # Errors
    /// When the profiles differ.
    pub fn check_crop_profile(&self, rig_profile: &str) -> Result<()> {
        let wanted = match self.crop_profile {
            Some(profile) if profile.name() != rig_profile => profile,
            _ => return Ok(()),
        };
        Err(refusal(format!(
            "the model `{}` expects the crop profile `{wanted}`, but the tactile images are \
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
        let mut metadata = Metadata::new(model)?;
        let schema: u32 = metadata.parse("gripcast.schema", "a whole number")?;
        if schema != SCHEMA {
            return Err(Error::input(format!(
                "`gripcast.schema`: expected {SCHEMA}, found {schema}"
            ))
            .remedy(if schema > SCHEMA {
                "the model needs a newer gripcast: update gripcast, or export the model for this \
                 version"
            } else {
                HOW_TO_EXPORT
            }));
        }
        let name = metadata.take("gripcast.variant")?;
        let Some(modality) = Modality::by_name(&name) else {
            return Err(refusal(format!(
                "`gripcast.variant`: expected {}, found `{name}`",
                list(Modality::ALL)
            )));
        };
        let inputs: Vec<InputSpec> = serde_json::from_str(&metadata.take("gripcast.inputs")?)
            .map_err(|cause| refusal("invalid `gripcast.inputs`").because(cause))?;
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
            modality,
            inputs,
            threshold: metadata.parse("gripcast.threshold", "a number")?,
            temperature: metadata.parse("gripcast.temperature", "a number")?,
            fallbacks: metadata.list(FALLBACKS)?,
            geometry: metadata.list(GEOMETRY_INPUTS)?,
            contact: metadata.list(CONTACT_INPUTS)?,
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
        for output in self.outputs() {
            // The keys of fallbacks are in their list.
            let key = |what: &str| match output.modality == self.modality {
                true => format!("`gripcast.{what}`"),
                false => format!("`{FALLBACKS}`, `{what}` of {}", output.modality),
            };
            if !(output.threshold > 0.0 && output.threshold < 1.0) {
                return Err(refusal(format!(
                    "{}: expected a probability between 0 and 1, found {}",
                    key("threshold"),
                    output.threshold
                )));
            }
            if !(output.temperature > 0.0 && output.temperature.is_finite()) {
                return Err(refusal(format!(
                    "{}: expected a finite number above 0, found {}",
                    key("temperature"),
                    output.temperature
                )));
            }
        }
        let mut fallbacks = self.fallbacks.iter().map(|output| output.modality);
        let all = self.modality;
        let is_part = |part: &Modality| all.includes(*part) && *part != all;
        if !fallbacks.clone().is_sorted_by(|a, b| a < b) || !fallbacks.all(|m| is_part(&m)) {
            let found = list(self.fallbacks.iter().map(|output| output.modality));
            return Err(refusal(format!(
                "`{FALLBACKS}`: expected parts of {all} in the order of {}, found {found}",
                list(Modality::ALL)
            )));
        }
        let is_camera =
            |name: &InputName| matches!(name, InputName::Rgb | InputName::Depth) && all.has(*name);
        if !self.geometry.is_sorted_by(|a, b| a < b) || !self.geometry.iter().all(is_camera) {
            return Err(refusal(format!(
                "`{GEOMETRY_INPUTS}`: expected `rgb` and `depth` of the inputs, found {}",
                list(&self.geometry)
            )));
        }
        let gels = [InputName::TactileLeft, InputName::TactileRight];
        let reads_gels = all.has_touch() && self.contact == gels;
        if !self.contact.is_empty() && !reads_gels {
            return Err(refusal(format!(
                "`{CONTACT_INPUTS}`: expected {} of a model with touch, found {}",
                list(gels),
                list(&self.contact)
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
        if self.crop_profile.is_none() && !self.is_heuristic() && self.modality.has_touch() {
            // A trained network always depends on the crop.
            return Err(refusal(format!(
                "`gripcast.crop_profile`: expected a name for a trained model with touch, found \
                 `{ANY_CROP}`"
            )));
        }
        let mut named: Vec<_> = self.inputs.iter().map(|input| input.name).collect();
        named.sort_unstable();
        if named != self.modality.inputs() {
            return Err(refusal(format!(
                "`gripcast.inputs`: expected {1} for modality {0}, found {2}",
                self.modality,
                list(self.modality.inputs()),
                list(&named)
            )));
        }
        self.inputs
            .iter()
            .try_for_each(|input| input.check().map_err(refusal))
    }
}

/// `metadata_props` as a map, emptied while it is read.
struct Metadata(BTreeMap<String, String>);

impl Metadata {
    fn new(model: &ModelProto) -> Result<Self> {
        let mut map = BTreeMap::new();
        for entry in &model.metadata_props {
            if map.insert(entry.key.clone(), entry.value.clone()).is_some() {
                return Err(refusal(format!(
                    "duplicate key `{}` in the metadata",
                    entry.key
                )));
            }
        }
        Ok(Self(map))
    }

    fn take(&mut self, key: &str) -> Result<String> {
        self.0.remove(key).ok_or_else(|| {
            let what = if key == "gripcast.schema" {
                "not a gripcast model: missing key `gripcast.schema` in the ONNX metadata"
                    .to_owned()
            } else {
                format!("missing key `{key}` in the model's metadata")
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

    /// Reads a JSON list; empty if the key is absent.
    fn list<T: serde::de::DeserializeOwned>(&mut self, key: &str) -> Result<Vec<T>> {
        let Some(text) = self.0.remove(key) else {
            return Ok(Vec::new());
        };
        serde_json::from_str(&text).map_err(|cause| {
            let what = format!("`{key}`: expected a JSON list, found `{text}`");
            refusal(what).because(cause)
        })
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
            .filter(|(key, _)| key.starts_with(PREFIX))
            .collect()
    }
}

fn is_sha256(text: &str) -> bool {
    text.len() == 64
        && text
            .bytes()
            .all(|b| b.is_ascii_digit() || (b'a'..=b'f').contains(&b))
}

#[cfg(test)]
#[path = "contract_test.rs"]
mod tests;
