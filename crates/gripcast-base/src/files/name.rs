//! Types for names from files, flags and clients; they cannot contain a path.

use std::borrow::Borrow;
use std::fmt;
use std::ops::Deref;
use std::str::FromStr;

use serde::{Deserialize, Deserializer, Serialize};
use unicode_normalization::{UnicodeNormalization as _, is_nfc};

use super::sha256_hex;
use crate::error::{Error, Result};

/// Maximum length of a file name, bytes: that of Linux file systems.
const MAX_FILE_NAME_BYTES: usize = 255;
/// Maximum length of an id, bytes: leaves room for suffixes in a file name.
const MAX_ID_BYTES: usize = 80;
/// Maximum length of the name of an object, a scene or an operator, characters.
pub const MAX_LABEL_CHARS: usize = 120;
/// Maximum length in bytes: leaves room for suffixes in a file name.
const MAX_LABEL_BYTES: usize = 240;

/// Whether a character affects the display of the text around it: controls, bidirectional controls,
/// line and paragraph separators, zero-width characters, the byte-order mark.
#[must_use]
pub fn is_unsafe_char(c: char) -> bool {
    c.is_control()
        || matches!(c,
            '\u{061c}' | '\u{200b}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}'
            | '\u{2060}'..='\u{206f}' | '\u{feff}' | '\u{fff9}'..='\u{fffb}'
            | '\u{e0000}'..='\u{e007f}')
}

/// Untrusted text, escaped for a terminal or a message: it cannot move the cursor, change colours,
/// reorder or hide other text. `\n` and `\t` are kept.
#[derive(Clone, Copy, Debug)]
pub struct Printable<'a>(pub &'a str);

impl fmt::Display for Printable<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut rest = self.0;
        while let Some(index) = rest.find(|c| is_unsafe_char(c) && c != '\n' && c != '\t') {
            let (clean, tail) = rest.split_at(index);
            f.write_str(clean)?;
            let mut chars = tail.chars();
            if let Some(c) = chars.next() {
                write!(f, "{}", c.escape_unicode())?;
            }
            rest = chars.as_str();
        }
        f.write_str(rest)
    }
}

/// Normalises to NFC, so that equivalent names have equal bytes (UAX #15).
fn nfc(text: &str) -> String {
    if is_nfc(text) {
        text.to_owned()
    } else {
        text.nfc().collect()
    }
}

fn invalid(kind: &str, text: &str, expected: &str) -> Error {
    Error::input(format!("invalid {kind} {text:.80?}: expected {expected}"))
}

/// Whether a character is invisible and never changes the display of the text around it: soft
/// hyphen, grapheme joiner, fillers, blanks without width.
fn is_invisible(c: char) -> bool {
    matches!(c,
        '\u{ad}' | '\u{34f}' | '\u{115f}' | '\u{1160}' | '\u{17b4}' | '\u{17b5}' | '\u{180e}'
        | '\u{2800}' | '\u{3164}' | '\u{ffa0}' | '\u{1bca0}'..='\u{1bca3}'
        | '\u{1d173}'..='\u{1d17a}')
}

/// Whether a character joins or separates its neighbours in some scripts and in emoji.
fn is_joiner(c: char) -> bool {
    matches!(c, '\u{200c}' | '\u{200d}')
}

/// Whether a character selects a variant of the one before it.
fn is_variation_selector(c: char) -> bool {
    matches!(c, '\u{180b}'..='\u{180d}' | '\u{180f}' | '\u{fe00}'..='\u{fe0f}'
        | '\u{e0100}'..='\u{e01ef}')
}

/// Brings a name into its normal form, in which names of the same appearance have the same bytes:
/// NFC, single ASCII spaces and none at the ends, no invisible characters. Joiners stay between
/// characters outside ASCII, variation selectors after one: elsewhere they have no effect.
fn normal_line(text: &str) -> String {
    let has_effect = |c: Option<&char>| {
        c.is_some_and(|c| {
            !(c.is_ascii() || c.is_whitespace() || is_joiner(*c) || is_variation_selector(*c))
        })
    };
    let visible: Vec<char> = nfc(text).chars().filter(|c| !is_invisible(*c)).collect();
    let mut kept: Vec<char> = Vec::with_capacity(visible.len());
    for (index, &c) in visible.iter().enumerate() {
        let after_effect = has_effect(kept.last());
        let is_kept = match c {
            c if is_joiner(c) => {
                let after_variant = kept.last().is_some_and(|c| is_variation_selector(*c));
                (after_effect || after_variant) && has_effect(visible.get(index + 1))
            }
            c if is_variation_selector(c) => after_effect,
            _ => true,
        };
        if is_kept {
            kept.push(c);
        }
    }
    let text: String = kept.into_iter().collect();
    let words: Vec<&str> = text.split_whitespace().collect();
    nfc(&words.join(" "))
}

/// Returns the form in which names that are easily confused are equal: normal form without case,
/// compatibility variants (NFKC), joiners and variation selectors.
#[must_use]
pub fn folded_name(name: &str) -> String {
    let lower: String = name.nfkc().flat_map(char::to_lowercase).collect();
    let plain: String = lower
        .chars()
        .filter(|c| !(is_joiner(*c) || is_variation_selector(*c)))
        .collect();
    normal_line(&plain)
}

/// Parses one line of at most [`MAX_LABEL_CHARS`] characters without unsafe ones, in its
/// [normal form](normal_line).
fn parse_line(kind: &str, text: &str) -> Result<String> {
    let name = normal_line(text);
    let is_long = name.chars().count() > MAX_LABEL_CHARS || name.len() > MAX_LABEL_BYTES;
    if is_long || text.chars().any(is_unsafe_char) {
        let expected = format!(
            "one line of at most {MAX_LABEL_CHARS} characters ({MAX_LABEL_BYTES} bytes) without \
             control, bidirectional or zero-width characters"
        );
        return Err(invalid(kind, text, &expected));
    }
    Ok(name)
}

/// Parses an ASCII id for file names: letters, digits, `-`, `_` and, not leading, `.`.
fn parse_id(kind: &str, text: &str, has_dots: bool) -> Result<String> {
    let is_allowed =
        |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_' || (has_dots && c == '.');
    let is_id = !text.is_empty()
        && text.len() <= MAX_ID_BYTES
        && !text.starts_with('.')
        && text.chars().all(is_allowed);
    if !is_id {
        let dots = if has_dots { ", `.`" } else { "" };
        let expected = format!("1 to {MAX_ID_BYTES} letters, digits, `-`, `_`{dots}");
        return Err(invalid(kind, text, &expected));
    }
    Ok(text.to_owned())
}

macro_rules! name_type {
    ($(#[$doc:meta])* $name:ident, $parse:expr) => {
        $(#[$doc])*
        #[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
        #[serde(transparent)]
        pub struct $name(String);

        impl $name {
            /// Parses untrusted text.
            ///
            /// # Errors
            /// `Input` with the expected form.
            pub fn parse(text: &str) -> Result<Self> {
                let parse: fn(&str) -> Result<String> = $parse;
                parse(text).map(Self)
            }

            /// The name as text.
            #[must_use]
            pub fn as_str(&self) -> &str {
                &self.0
            }
        }

        impl FromStr for $name {
            type Err = Error;

            fn from_str(text: &str) -> Result<Self> {
                Self::parse(text)
            }
        }

        impl<'de> Deserialize<'de> for $name {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                let text = String::deserialize(deserializer)?;
                Self::parse(&text).map_err(|e| serde::de::Error::custom(e.what()))
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.pad(&self.0)
            }
        }

        impl Deref for $name {
            type Target = str;

            fn deref(&self) -> &str {
                &self.0
            }
        }

        impl AsRef<str> for $name {
            fn as_ref(&self) -> &str {
                &self.0
            }
        }

        impl Borrow<str> for $name {
            fn borrow(&self) -> &str {
                &self.0
            }
        }

        impl PartialEq<str> for $name {
            fn eq(&self, other: &str) -> bool {
                self.0 == other
            }
        }

        impl PartialEq<&str> for $name {
            fn eq(&self, other: &&str) -> bool {
                self.0 == *other
            }
        }

        impl From<$name> for String {
            fn from(name: $name) -> Self {
                name.0
            }
        }
    };
}

name_type!(
    /// Id of a grasp and name of its directory: `<utc>-<4 hex>`, for instance
    /// `2026-11-20T10-15-03Z-7f3a`. ASCII letters, digits, `-` and `_`.
    GraspId,
    |text| parse_id("grasp id", text, false)
        .map_err(|e| e.remedy("use an id such as 2026-11-20T10-15-03Z-7f3a"))
);

name_type!(
    /// Id of a planned simulation and prefix of its file names, for instance `mug-0003-07-40n`.
    /// ASCII letters, digits, `-`, `_` and `.`.
    SimulationId,
    |text| parse_id("simulation id", text, true)
);

name_type!(
    /// Name of a field array, such as `markers`: it begins with a lower-case letter, then also
    /// digits and `_`, so that it can be part of a column's name. At most 40 characters.
    FieldName,
    |text| {
        let is_word = text.bytes().all(|b| matches!(b, b'a'..=b'z' | b'0'..=b'9' | b'_'));
        if is_word && text.len() <= 40 && text.starts_with(|c: char| c.is_ascii_lowercase()) {
            Ok(text.to_owned())
        } else {
            Err(invalid("field name", text, "at most 40 lower-case letters, digits and `_`, a letter first"))
        }
    }
);

name_type!(
    /// File name without directories: one path component in NFC, not hidden, at most 255 bytes,
    /// without unsafe characters.
    FileName,
    |text| {
        let name = nfc(text);
        let is_name = !name.is_empty()
            && name.len() <= MAX_FILE_NAME_BYTES
            && !name.starts_with('.')
            && !name.chars().any(|c| c == '/' || c == '\\' || is_unsafe_char(c));
        if is_name {
            Ok(name)
        } else {
            Err(invalid("file name", &name, "a name without directories and without a leading `.`"))
        }
    }
);

name_type!(
    /// Name of an object: one line in normal form (NFC, single spaces, nothing invisible), not
    /// empty, valid as a file name: without `/`, `\` and a leading `.`.
    ObjectName,
    |text| {
        let name = parse_line("object name", text)?;
        if name.is_empty() {
            return Err(invalid("object name", text, "a name, found nothing visible"));
        }
        let is_name = !name.starts_with('.')
            && !name.contains(['/', '\\']);
        if is_name {
            Ok(name)
        } else {
            Err(invalid("object name", &name, "a name without `/`, `\\` and a leading `.`"))
        }
    }
);

name_type!(
    /// Name of a scene or an operator: one line in normal form, possibly empty; never a file name.
    Label,
    |text| parse_line("name", text)
);

name_type!(
    /// Key of a stored calibration, board or model card: the first 12 hex digits of its SHA-256.
    ContentKey,
    |text| {
        let is_digit = |b: u8| b.is_ascii_digit() || (b'a'..=b'f').contains(&b);
        if text.len() == 12 && text.bytes().all(is_digit) {
            Ok(text.to_owned())
        } else {
            Err(invalid("key", text, "12 lower-case hex digits"))
        }
    }
);

impl ContentKey {
    /// File name of a key with a literal suffix.
    #[must_use]
    pub fn with_suffix(&self, suffix: &'static str) -> FileName {
        FileName(format!("{}{suffix}", self.0))
    }

    /// Computes the key of some contents.
    #[must_use]
    pub fn from_contents(bytes: &[u8]) -> Self {
        let mut hex = sha256_hex(bytes);
        hex.truncate(12);
        Self(hex)
    }
}

impl FileName {
    /// Replaces invalid characters of a text.
    #[must_use]
    pub fn nearest(text: &str) -> Self {
        let mut name = cleaned(text, |c| c != '/' && c != '\\');
        if name.is_empty() || name.starts_with('.') {
            name.insert(0, '_');
        }
        Self(name)
    }

    /// Joins words of the program with dots: `stage.role.suffix`.
    pub fn from_words(words: &[&str]) -> Self {
        Self(join_words(words, "."))
    }
}

/// Joins words of the program to one component; invalid characters become `_`.
fn join_words(words: &[&str], separator: &str) -> String {
    let is_allowed = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
    let name = cleaned(&words.join(separator), is_allowed);
    match name.strip_prefix('.') {
        Some(rest) => format!("_{rest}"),
        None => name,
    }
}

impl GraspId {
    /// Joins words of the program with `-`: `utc-hex`.
    pub fn from_words(words: &[&str]) -> Self {
        Self(join_words(words, "-"))
    }

    /// The last four characters, for display.
    #[must_use]
    pub fn short(&self) -> &str {
        &self.0[self.0.len().saturating_sub(4)..]
    }
}

/// Replaces invalid characters by `_` and truncates: for records of versions that did not check
/// names.
fn cleaned(text: &str, is_allowed: impl Fn(char) -> bool) -> String {
    let clean = |c| {
        if is_allowed(c) && !is_unsafe_char(c) {
            c
        } else {
            '_'
        }
    };
    let mut name: String = nfc(text).chars().take(MAX_LABEL_CHARS).map(clean).collect();
    name.truncate(name.floor_char_boundary(MAX_LABEL_BYTES));
    name
}

impl ObjectName {
    /// Replaces invalid characters of a text.
    #[must_use]
    pub fn nearest(text: &str) -> Self {
        let mut name = normal_line(&cleaned(text, |c| c != '/' && c != '\\'));
        if name.starts_with('.') {
            name.replace_range(..1, "_");
        }
        if name.is_empty() {
            "unknown".clone_into(&mut name);
        }
        Self(name)
    }
}

impl Label {
    /// Replaces invalid characters of a text.
    #[must_use]
    pub fn nearest(text: &str) -> Self {
        Self(normal_line(&cleaned(text, |_| true)))
    }
}

/// The name of an object that was not given one.
impl Default for ObjectName {
    fn default() -> Self {
        Self("object".to_owned())
    }
}

/// An empty label.
impl Default for Label {
    fn default() -> Self {
        Self(String::new())
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Hostile names.
    const HOSTILE: [&str; 16] = [
        "",
        ".",
        "..",
        "../x",
        "/etc/passwd",
        "a/b",
        "..\\x",
        ".bashrc",
        "a\nb",
        "a\u{1b}[2Jb",
        "a\u{202e}b",
        "a\u{2028}b",
        "a\0b",
        "\u{feff}a",
        "a\u{200b}b",
        "a\u{2067}b",
    ];

    #[test]
    fn paths_and_control_characters_are_refused() {
        let long = "n".repeat(256);
        for text in HOSTILE.into_iter().chain([long.as_str()]) {
            assert!(GraspId::parse(text).is_err(), "{text:?}");
            assert!(SimulationId::parse(text).is_err(), "{text:?}");
            assert!(FileName::parse(text).is_err(), "{text:?}");
            assert!(ObjectName::parse(text).is_err(), "{text:?}");
            let json = serde_json::to_string(text).unwrap();
            assert!(serde_json::from_str::<GraspId>(&json).is_err(), "{text:?}");
            assert!(serde_json::from_str::<FileName>(&json).is_err(), "{text:?}");
        }
        for text in &HOSTILE[8..] {
            assert!(Label::parse(text).is_err(), "{text:?}");
        }
    }

    #[test]
    fn common_names_are_valid() {
        assert!(GraspId::parse("2026-11-20T10-15-03Z-7f3a").is_ok());
        assert!(SimulationId::parse("part-1.5-00-10n").is_ok());
        assert!(FileName::parse("initial.left.jpg").is_ok());
        for name in ["mug", "Größe", "杯子", "Tasse (blau) 2", "001", "a..b"] {
            assert_eq!(ObjectName::parse(name).unwrap(), name);
        }
        assert_eq!(Label::parse("").unwrap(), "");
        assert_eq!(Label::parse("lab 3 / table").unwrap(), "lab 3 / table");
    }

    #[test]
    fn equivalent_names_are_equal() {
        let composed = ObjectName::parse("Gr\u{f6}\u{df}e").unwrap();
        assert_eq!(ObjectName::parse("Gro\u{308}\u{df}e").unwrap(), composed);
    }

    #[test]
    fn names_of_the_same_appearance_are_equal() {
        let name = |text: &str| ObjectName::parse(text).unwrap();
        let mug = name("blue mug");
        for text in [
            "  blue mug ",
            "blue  mug",
            "blue\u{a0}mug",
            "blue\u{2009}mug",
            "blue\u{3000}mug\u{a0}",
            "blue mug\u{ad}",
            "blue\u{200d} mug",
            "blue mug\u{200c}",
            "blue mu\u{fe0f}g",
            "\u{2800}blue mug\u{3164}",
        ] {
            assert_eq!(name(text), mug, "{text:?}");
        }
        assert_ne!(name("Blue mug"), mug, "case is part of a name");
        // Joiners and selectors that change what is shown stay.
        for text in ["👩\u{200d}🔬", "❤\u{fe0f}", "می\u{200c}خواهم", "क्\u{200d}ष"]
        {
            assert_eq!(name(text), text, "{text:?}");
        }
        assert_eq!(Label::parse(" lab\u{a0} 3 ").unwrap(), "lab 3");
    }

    #[test]
    fn empty_and_invisible_object_names_are_refused() {
        for text in [
            "",
            " ",
            "\u{a0}",
            "\u{ad}",
            "\u{200d}",
            "\u{fe0f}",
            "\u{3164}\u{2800}",
        ] {
            let error = ObjectName::parse(text).unwrap_err().to_string();
            assert!(error.contains("nothing visible"), "{text:?}: {error}");
        }
        assert_eq!(Label::parse(" ").unwrap(), "");
    }

    #[test]
    fn confusable_names_have_the_same_folded_form() {
        let mug = folded_name("blue mug");
        for text in ["Blue Mug", "ＢＬＵＥ mug", "blue  mug", "blue mug\u{fe0f}"] {
            assert_eq!(folded_name(text), mug, "{text:?}");
        }
        assert_ne!(folded_name("blue mugs"), mug);
    }

    #[test]
    fn printable_escapes_terminal_commands() {
        let text = "a\u{1b}]0;t\u{7}b\u{9b}31m\u{202e}c\r\nd\te";
        let printed = Printable(text).to_string();
        assert_eq!(
            printed,
            "a\\u{1b}]0;t\\u{7}b\\u{9b}31m\\u{202e}c\\u{d}\nd\te"
        );
        assert_eq!(Printable("Größe").to_string(), "Größe");
    }

    proptest! {
        #[test]
        fn parsed_name_is_one_normal_component(text in any::<String>()) {
            use std::path::{Component, Path};
            let names = [
                GraspId::parse(&text).map(String::from),
                SimulationId::parse(&text).map(String::from),
                FileName::parse(&text).map(String::from),
                ObjectName::parse(&text).map(String::from),
                Ok(String::from(ObjectName::nearest(&text))),
            ];
            for name in names.into_iter().flatten() {
                let components: Vec<_> = Path::new(&name).components().collect();
                prop_assert_eq!(components, [Component::Normal(name.as_ref())]);
            }
            let nearest = ObjectName::nearest(&text);
            prop_assert_eq!(ObjectName::parse(&nearest).unwrap(), nearest);
            let nearest = Label::nearest(&text);
            prop_assert_eq!(Label::parse(&nearest).unwrap(), nearest);
            let names = [ObjectName::parse(&text), ObjectName::parse(&format!("ob{text}t"))];
            for name in names.into_iter().flatten() {
                prop_assert_eq!(ObjectName::parse(&name).unwrap(), name);
            }
            let printed = Printable(&text).to_string();
            prop_assert!(!printed.chars().any(|c| is_unsafe_char(c) && c != '\n' && c != '\t'));
        }
    }
}
