//! Models by name: those that gripcast has built in, and files.

use std::path::Path;

use super::baseline::{self, BASELINE};
use super::{Model, onnx};
use gripcast_base::error::{Error, ErrorKind, Result};

/// Name of the built-in classifier, `models/gripcast-vt.onnx`, trained on simulated grasps.
pub const SHIPPED: &str = "gripcast-vt";

static SHIPPED_BYTES: &[u8] = include_bytes!("../../../../models/gripcast-vt.onnx");

/// The bytes of a model: [`SHIPPED`], [`BASELINE`], or a file.
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

/// Who names a file that is not there may have meant a built-in model.
fn with_built_in_names(error: Error) -> Error {
    if error.kind() != ErrorKind::NotFound {
        return error;
    }
    error.remedy(format!(
        "name a .onnx file, or {SHIPPED} or {BASELINE}, which are built in"
    ))
}

impl Model {
    /// The built-in contact-strength heuristic; the same bytes as `models/baseline-contact.onnx`.
    ///
    /// # Errors
    /// As [`Model::from_bytes`]; a defect of gripcast.
    pub fn baseline() -> Result<Self> {
        Self::from_bytes(&baseline::onnx_bytes()?)
    }

    /// The model of a name, as of [`model_bytes`].
    ///
    /// # Errors
    /// As [`Model::load`].
    pub fn named(name: &str) -> Result<Self> {
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
    use crate::predict::contract::{Origin, Variant};

    #[test]
    fn other_names_are_files() {
        let named = Model::named(BASELINE).unwrap();
        assert_eq!(named.sha256(), Model::baseline().unwrap().sha256());
        let error = Model::named("no-such-model").unwrap_err();
        assert!(error.to_string().contains("no-such-model"), "{error}");
        let unread = model_bytes("no-such-model").unwrap_err();
        for error in [error, unread] {
            let remedy = error.remedy_text().unwrap();
            assert!(remedy.contains(SHIPPED) && remedy.contains(BASELINE));
        }
    }

    #[test]
    fn the_shipped_classifier_is_what_its_card_says() {
        let model = Model::named(SHIPPED).unwrap();
        let contract = model.contract();
        assert_eq!((&*contract.name, contract.variant), (SHIPPED, Variant::Vt));
        assert!(matches!(contract.origin, Origin::Trained { .. }));
        assert!(model.is_on_own_engine() && model.novelty().is_some());
        assert!(SHIPPED_BYTES.len() <= 12 << 20);
        let card = concat!(env!("CARGO_MANIFEST_DIR"), "/../../models/gripcast-vt.toml");
        let card: toml::Table = std::fs::read_to_string(card).unwrap().parse().unwrap();
        assert_eq!(card["name"].as_str(), Some(SHIPPED));
        assert_eq!(card["sha256"].as_str(), Some(model.sha256()));
        assert_eq!(card["variant"].as_str(), Some(contract.variant.name()));
        assert_eq!(card["threshold"].as_float(), Some(contract.threshold));
        assert_eq!(
            card["crop_profile"].as_str(),
            Some(contract.crop_profile_name())
        );
    }
}
