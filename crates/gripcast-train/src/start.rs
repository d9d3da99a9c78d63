//! The trained model that fine-tuning starts from, or that lends its encoders of camera images.

use std::collections::BTreeSet;
use std::path::Path;

use super::finish::{ARCHITECTURE, OBJECTS};
use super::run_folder::RunFolder;
use super::samples::Samples;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{BeneathPath, FileKind, sha256_hex};
use gripcast_nn::predict::contract::{InputName, Origin, RgbNormalisation};
use gripcast_nn::predict::{
    GraspHead, LiftHead, ModelContract, OodDetector, SHIPPED, grasp_head, lift, model_bytes, ood,
};
use gripcast_nn::{Architecture, Network, from_onnx};

/// A model that `train` wrote, ready to be trained further.
#[derive(Clone, Debug)]
pub struct StartModel {
    bytes: Vec<u8>,
    sha256: String,
    contract: ModelContract,
    network: Network,
    architecture: Architecture,
    ood_detector: Option<OodDetector>,
    grasp_head: GraspHead,
    lift_head: Option<LiftHead>,
}

impl StartModel {
    /// Loads a model: a built-in name, an ONNX file, or the folder of a run.
    ///
    /// # Errors
    /// `Input` for a model that `train` did not write. Errors of reading the file.
    pub fn by_name(name: &str) -> Result<Self> {
        let path = Path::new(name);
        let name = if path.is_dir() {
            let model = RunFolder::at(path).model();
            if !model.is_file() {
                return Err(Error::not_found("the run has no model")
                    .at(model.display())
                    .remedy("finish the run with the command that started it"));
            }
            model.display().to_string()
        } else {
            name.to_owned()
        };
        Self::from_bytes(model_bytes(&name)?).map_err(|e| e.at(name))
    }

    /// Reads the copy in the folder of a run.
    pub(super) fn of_run(folder: &RunFolder) -> Result<Self> {
        let path: BeneathPath = folder.start();
        let bytes = path
            .read(FileKind::Bulk)
            .map_err(|e| Error::io("cannot read the start model", e).at(path.display()))?;
        Self::from_bytes(bytes).map_err(|e| e.at(path.display()))
    }

    pub(super) fn from_bytes(bytes: Vec<u8>) -> Result<Self> {
        let (network, contract) = from_onnx(&bytes).map_err(refused)?;
        let not_trained = |why: &str| {
            let what = format!("cannot fine-tune the model `{}`: {why}", contract.name);
            refused(Error::input(what))
        };
        if !matches!(contract.origin, Origin::Trained { .. }) {
            return Err(not_trained("it is a heuristic, not a trained model"));
        }
        let name = contract.other.get(ARCHITECTURE).ok_or_else(|| {
            not_trained(&format!(
                "`{ARCHITECTURE}` is missing: `train` did not write it"
            ))
        })?;
        let architecture = Architecture {
            name: name.clone(),
            ..network.architecture().clone()
        };
        let ood_detector = contract.other.get(ood::METADATA);
        let ood_detector = ood_detector
            .map(|text| OodDetector::from_metadata(text))
            .transpose()?;
        let grasp_head = contract.other.get(grasp_head::METADATA);
        let grasp_head = grasp_head
            .map(|text| GraspHead::from_metadata(text))
            .transpose()?
            .unwrap_or_default();
        let lift_head = contract.other.get(lift::METADATA);
        let lift_head = lift_head
            .map(|text| LiftHead::from_metadata(text))
            .transpose()?;
        Ok(Self {
            grasp_head,
            lift_head,
            sha256: sha256_hex(&bytes),
            bytes,
            network,
            architecture,
            ood_detector,
            contract,
        })
    }

    /// Bytes of the file.
    pub(super) fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// SHA-256 of the file, lower-case hex.
    pub fn sha256(&self) -> &str {
        &self.sha256
    }

    /// Contract of the model.
    pub fn contract(&self) -> &ModelContract {
        &self.contract
    }

    /// The network; its logits include the model's temperature.
    pub(super) fn network(&self) -> &Network {
        &self.network
    }

    /// Architecture of the network.
    pub fn architecture(&self) -> &Architecture {
        &self.architecture
    }

    /// OOD detector of the model, if any.
    pub(super) fn ood_detector(&self) -> Option<&OodDetector> {
        self.ood_detector.as_ref()
    }

    /// Prediction before the lift from what the network reads; empty if the model has none.
    pub(super) fn grasp_head(&self) -> &GraspHead {
        &self.grasp_head
    }

    /// Verdict in the lift, if the model has it.
    pub(super) fn lift_head(&self) -> Option<&LiftHead> {
        self.lift_head.as_ref()
    }

    /// Normalisation of the colour images.
    pub(super) fn normalisation(&self) -> RgbNormalisation {
        let rgb = self.contract.input(InputName::Rgb);
        rgb.and_then(|input| input.normalisation())
            .unwrap_or(RgbNormalisation::NONE)
    }

    /// Names of the objects that it was trained on.
    pub(super) fn objects(&self) -> BTreeSet<String> {
        let names = self.contract.other.get(OBJECTS);
        names
            .and_then(|names| serde_json::from_str(names).ok())
            .unwrap_or_default()
    }

    /// Explains why its encoders of camera images cannot be used.
    pub(super) fn no_cameras(&self, error: Error) -> Error {
        error
            .at(format!("model `{}`", self.contract.name))
            .replace_remedy(
                "name a model that `train` wrote for a dataset with known extents, with the same \
                 `--arch` and at least the camera inputs of this run",
            )
    }

    /// Refuses samples with another crop profile.
    pub(super) fn check_crop_profile(&self, samples: &Samples) -> Result<()> {
        self.contract
            .check_crop_profile(samples.crop_profile())
            .map_err(|e| e.at(samples.location()))
    }

    /// Returns a warning if it was trained on objects of these samples.
    pub(super) fn seen(&self, samples: &Samples) -> Option<String> {
        let trained = self.objects();
        let shared = samples.count_named(&trained);
        (shared > 0).then(|| {
            format!(
                "`{}` was trained on {shared} objects of the split `{}`, by name; if they are the \
                 same objects, its score there is too good",
                self.contract.name,
                samples.split()
            )
        })
    }
}

fn refused(error: Error) -> Error {
    error.replace_remedy(format!(
        "start from `{SHIPPED}`, from an ONNX file that `gripcast train` wrote, or from the folder \
         of a run"
    ))
}

#[cfg(test)]
#[path = "start_test.rs"]
mod tests;
