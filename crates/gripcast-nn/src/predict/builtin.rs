//! Models by name: built-in ones and files.

use std::path::Path;

use super::baseline::{self, BASELINE};
use super::{Model, onnx};
use gripcast_base::error::{Error, ErrorKind, Result};

/// Name of the built-in classifier, `models/gripcast-vt.onnx`, trained on simulated grasps.
pub const SHIPPED: &str = "gripcast-vt";

static SHIPPED_BYTES: &[u8] = include_bytes!("../../../../models/gripcast-vt.onnx");

/// Returns the bytes of a model: [`SHIPPED`], [`BASELINE`], or a file.
///
/// # Errors
/// As [`onnx::read`].
pub fn model_bytes(name: &str) -> Result<Vec<u8>> {
    match name {
        SHIPPED => Ok(SHIPPED_BYTES.to_vec()),
        BASELINE => baseline::onnx_bytes(),
        path => onnx::read(Path::new(path)).map_err(with_built_in_names),
    }
}

/// Adds the built-in names to the remedy for a missing file.
fn with_built_in_names(error: Error) -> Error {
    if error.kind() != ErrorKind::NotFound {
        return error;
    }
    error.remedy(format!(
        "give a .onnx file, or one of the built-in models {SHIPPED} and {BASELINE}"
    ))
}

impl Model {
    /// The built-in contact-strength heuristic; the same bytes as `models/baseline-contact.onnx`.
    ///
    /// # Errors
    /// As [`Model::from_bytes`].
    pub fn baseline() -> Result<Self> {
        Self::from_bytes(&baseline::onnx_bytes()?)
    }

    /// Loads a model by name, as [`model_bytes`].
    ///
    /// # Errors
    /// As [`Model::load`].
    pub fn by_name(name: &str) -> Result<Self> {
        match name {
            SHIPPED => Self::from_bytes(SHIPPED_BYTES),
            BASELINE => Self::baseline(),
            path => Self::load(Path::new(path)).map_err(with_built_in_names),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::predict::contract::{Modality, Origin};

    #[test]
    fn unknown_name_is_a_file() {
        let named = Model::by_name(BASELINE).unwrap();
        assert_eq!(named.sha256(), Model::baseline().unwrap().sha256());
        let error = Model::by_name("no-such-model").unwrap_err();
        assert!(error.to_string().contains("no-such-model"), "{error}");
        let bytes_error = model_bytes("no-such-model").unwrap_err();
        for error in [error, bytes_error] {
            let remedy = error.remedy_text().unwrap();
            assert!(remedy.contains(SHIPPED) && remedy.contains(BASELINE));
        }
    }

    #[test]
    fn shipped_classifier_matches_its_card() {
        let model = Model::by_name(SHIPPED).unwrap();
        let contract = model.contract();
        assert_eq!(
            (&*contract.name, contract.modality),
            (SHIPPED, Modality::Vtd)
        );
        assert!(matches!(contract.origin, Origin::Trained { .. }));
        assert!(model.is_native() && model.ood_detector().is_some());
        assert!(model.lift_head().is_some() && model.conformal_scores().is_some());
        assert!(SHIPPED_BYTES.len() <= 12 << 20);
        let card = concat!(env!("CARGO_MANIFEST_DIR"), "/../../models/gripcast-vt.toml");
        let card: toml::Table = std::fs::read_to_string(card).unwrap().parse().unwrap();
        assert_eq!(card["name"].as_str(), Some(SHIPPED));
        assert_eq!(card["sha256"].as_str(), Some(model.sha256()));
        assert_eq!(card["modality"].as_str(), Some(contract.modality.name()));
        assert_eq!(card["threshold"].as_float(), Some(contract.threshold));
        assert_eq!(
            card["crop_profile"].as_str(),
            Some(contract.crop_profile_name())
        );
    }
}
