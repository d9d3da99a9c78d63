//! Text for terminals. What came from data, devices or other programs cannot command one: control
//! and bidirectional characters are escaped on the way out, in one place for each stream.

use std::fmt;
use std::io::{self, Write as _};

use gripcast_base::error::{Error, Result};
use gripcast_base::files::{Printable, is_unsafe_char};

/// Writes a line to stderr, for people. Use [`note!`](crate::note) to format one.
pub(crate) fn write_note(text: fmt::Arguments<'_>) {
    // There is nobody left to be told when stderr is closed.
    let _ = writeln!(io::stderr().lock(), "{}", Printable(&text.to_string()));
}

/// Like `note!`, with everything unsafe escaped.
macro_rules! note {
    ($($text:tt)*) => {
        $crate::terminal_text::write_note(format_args!($($text)*))
    };
}
pub(crate) use note;

/// Writes a line or more to stdout; a reader that has seen enough (`| head`) is no failure.
///
/// # Errors
/// That of the operating system.
pub(crate) fn print(text: &str) -> Result<()> {
    let text = text.strip_suffix('\n').unwrap_or(text);
    write_stdout(format_args!("{}", Printable(text)))
}

/// Prints one JSON object on stdout; unsafe characters are JSON escapes.
///
/// # Errors
/// `Internal` for values that JSON cannot hold; that of the operating system.
pub(crate) fn print_json(value: &impl serde::Serialize) -> Result<()> {
    let text = serde_json::to_string_pretty(value)
        .map_err(|e| Error::internal("cannot write JSON").because(e))?;
    write_stdout(format_args!("{}", escaped_json(&text)))
}

/// Prints what a command found: as JSON with `--json`, else as text for people.
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

/// One line of JSON for stdout or a file, without unsafe characters.
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
    fn json_stays_the_same_value_without_unsafe_characters() {
        let value = serde_json::json!({"name": "a\u{9b}31m\u{202e}b\u{e0041}c\n", "n": [1]});
        let text = escaped_json(&serde_json::to_string_pretty(&value).unwrap());
        assert!(!text.chars().any(|c| is_unsafe_char(c) && c != '\n'));
        let back: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert_eq!(back, value);
    }
}
