//! Output to terminals. Control and bidirectional characters are escaped, so that text from data,
//! devices or other programs cannot control the terminal.

use std::fmt;
use std::io::{self, Write as _};

use gripcast_base::error::{Error, Result};
use gripcast_base::files::{Printable, is_unsafe_char};

/// Writes a line to stderr; used by [`note!`](crate::note).
pub(crate) fn write_note(text: fmt::Arguments<'_>) {
    // A closed stderr is ignored.
    let _ = writeln!(io::stderr().lock(), "{}", Printable(&text.to_string()));
}

/// Prints a line to stderr with unsafe characters escaped.
macro_rules! note {
    ($($text:tt)*) => {
        $crate::terminal_text::write_note(format_args!($($text)*))
    };
}
pub(crate) use note;

/// Writes lines to stdout; a closed pipe (`| head`) is not an error.
///
/// # Errors
/// Errors of the operating system.
pub(crate) fn print(text: &str) -> Result<()> {
    let text = text.strip_suffix('\n').unwrap_or(text);
    write_stdout(format_args!("{}", Printable(text)))
}

/// Prints a value as JSON on stdout with unsafe characters escaped.
///
/// # Errors
/// `Internal` for values that cannot be serialised; errors of the operating system.
pub(crate) fn print_json(value: &impl serde::Serialize) -> Result<()> {
    let text = serde_json::to_string_pretty(value)
        .map_err(|e| Error::internal("cannot serialise to JSON").because(e))?;
    write_stdout(format_args!("{}", escaped_json(&text)))
}

/// Prints a report: as JSON with `--json`, else as text.
///
/// # Errors
/// As [`print`] and [`print_json`].
pub(crate) fn print_report<T: serde::Serialize>(
    as_json: bool,
    report: &T,
    text: impl FnOnce(&T) -> String,
) -> Result<()> {
    if as_json {
        print_json(report)
    } else {
        print(&text(report))
    }
}

/// Escapes unsafe characters in JSON text.
pub(crate) fn escaped_json(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for c in text.chars() {
        if is_unsafe_char(c) && c != '\n' {
            for unit in c.encode_utf16(&mut [0; 2]) {
                escaped.push_str(&format!("\\u{unit:04x}"));
            }
        } else {
            escaped.push(c);
        }
    }
    escaped
}

fn write_stdout(text: fmt::Arguments<'_>) -> Result<()> {
    match writeln!(io::stdout().lock(), "{text}") {
        Err(e) if e.kind() != io::ErrorKind::BrokenPipe => {
            Err(Error::io("cannot write to stdout", e))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn escaped_json_keeps_its_value() {
        let value = serde_json::json!({"name": "a\u{9b}31m\u{202e}b\u{e0041}c\n", "n": [1]});
        let text = escaped_json(&serde_json::to_string_pretty(&value).unwrap());
        assert!(!text.chars().any(|c| is_unsafe_char(c) && c != '\n'));
        let back: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert_eq!(back, value);
    }
}
