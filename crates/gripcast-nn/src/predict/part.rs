//! Parts of a model that its metadata has as JSON.

use serde::de::DeserializeOwned;

use gripcast_base::error::{Error, Result};

/// Reads the part of a metadata key.
///
/// # Errors
/// `Input`: it is damaged, or not usable.
pub(super) fn read<T: DeserializeOwned>(
    key: &str,
    text: &str,
    is_usable: impl FnOnce(&T) -> bool,
) -> Result<T> {
    let refused = |what: &str| {
        let what = format!("invalid `{key}` of the model{what}");
        Error::input(what).remedy("train or export the model again")
    };
    let found: T = serde_json::from_str(text).map_err(|e| refused("").because(e))?;
    match is_usable(&found) {
        true => Ok(found),
        false => Err(refused(": expected finite numbers, as many as features")),
    }
}
