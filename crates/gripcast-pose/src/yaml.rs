//! YAML written by third-party programs.

use serde::de::DeserializeOwned;

use gripcast_base::error::{Error, Result};

/// Parses a document; `what` names it in the error.
///
/// OpenCV's first line `%YAML:1.0` is not a valid YAML directive and is skipped.
///
/// # Errors
/// `Input` with the position in the text.
pub(crate) fn read<T: DeserializeOwned>(text: &str, what: &str) -> Result<T> {
    let text = text.trim_start_matches('\u{feff}');
    let body = match text.split_once('\n') {
        // An empty line keeps the line numbers.
        Some((first, rest)) if first.starts_with("%YAML:") => format!("\n{rest}"),
        _ => text.to_owned(),
    };
    serde_saphyr::from_str(&body).map_err(|e| {
        let message = e.to_string();
        let line = message.lines().next().unwrap_or_default();
        Error::input(format!("cannot read {what}: {line}"))
    })
}
