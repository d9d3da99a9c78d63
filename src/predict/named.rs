//! Models by name: the one that gripcast has built in, and files.

use std::path::Path;

use super::{Model, baseline, onnx};
use crate::error::Result;

/// Name of the built-in contact-strength heuristic, `models/baseline-contact.onnx`.
pub const BASELINE: &str = "baseline-contact";

/// The bytes of a model: [`BASELINE`], or a file.
///
/// # Errors
/// As [`onnx::read`].
pub fn model_bytes(name: &str) -> Result<Vec<u8>> {
    match name {
        BASELINE => baseline::onnx_bytes(),
        path => onnx::read(Path::new(path)),
    }
}

impl Model {
    /// The model of a name, as of [`model_bytes`].
    ///
    /// # Errors
    /// As [`Model::load`].
    pub fn named(name: &str) -> Result<Self> {
        match name {
            BASELINE => Self::from_bytes(&model_bytes(name)?),
            path => Self::load(Path::new(path)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn other_names_are_files() {
        let named = Model::named(BASELINE).unwrap();
        assert_eq!(named.sha256(), Model::baseline().unwrap().sha256());
        let error = Model::named("no-such-model").unwrap_err();
        assert!(error.to_string().contains("no-such-model"), "{error}");
    }
}
