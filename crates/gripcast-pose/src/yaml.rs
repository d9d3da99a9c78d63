//! YAML written by third-party programs.

use serde::de::DeserializeOwned;

use gripcast_base::error::{Error, Result};

/// Parses the first document of a text; `what` names it in the error.
///
/// OpenCV's first line `%YAML:1.0` is not a valid YAML directive and is skipped; tabs indent like two
/// spaces.
///
/// # Errors
/// `Input` with the position in the text.
pub(crate) fn read<T: DeserializeOwned>(text: &str, what: &str) -> Result<T> {
    let mut body = String::new();
    let mut has_content = false;
    for line in text.trim_start_matches('\u{feff}').lines() {
        let is_marker = line.trim_end() == "---" || line.trim_end() == "...";
        if is_marker && has_content {
            break;
        }
        let content = line.trim_start_matches([' ', '\t']);
        let is_directive = line.starts_with("%YAML:");
        has_content |= !is_marker && !content.is_empty() && !content.starts_with(['#', '%']);
        // An empty line keeps the line numbers.
        if !is_directive {
            let indent = &line[..line.len() - content.len()];
            body += &indent.replace('\t', "  ");
            body += content;
        }
        body.push('\n');
    }
    serde_saphyr::from_str(&body).map_err(|e| {
        let message = e.to_string();
        let line = message.lines().next().unwrap_or_default();
        Error::input(format!("cannot read {what}: {line}"))
    })
}
