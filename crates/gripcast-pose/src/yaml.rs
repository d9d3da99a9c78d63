//! YAML of other programs.

use serde::de::DeserializeOwned;

use gripcast_base::error::{Error, Result};

/// Reads a document; `what` says of what in the error.
///
/// OpenCV's first line `%YAML:1.0` is no directive of YAML and is passed over.
///
/// # Errors
/// `Input`, with the place in the text.
pub(crate) fn read<T: DeserializeOwned>(text: &str, what: &str) -> Result<T> {
    let text = text.trim_start_matches('\u{feff}');
    let body = match text.split_once('\n') {
        // The line stays, empty, so that line numbers are those of the file.
        Some((first, rest)) if first.starts_with("%YAML:") => format!("\n{rest}"),
        _ => text.to_owned(),
    };
    serde_saphyr::from_str(&body).map_err(|e| {
        let said = e.to_string();
        let line = said.lines().next().unwrap_or_default().to_owned();
        Error::input(format!("{what} cannot be read: {line}"))
    })
}
