//! Text of mesh files as programs write it: encodings, line ends and numbers.

use std::borrow::Cow;
use std::str::FromStr;

/// Decodes a text file: UTF-16 with a byte order mark, else UTF-8 with or without one. Names and
/// comments may have any encoding, so invalid bytes are replaced.
pub(super) fn decode(bytes: &[u8]) -> Cow<'_, str> {
    let units = |decode: fn([u8; 2]) -> u16| -> Vec<u16> {
        bytes[2..]
            .chunks_exact(2)
            .map(|pair| decode([pair[0], pair[1]]))
            .collect()
    };
    match bytes {
        [0xff, 0xfe, ..] => String::from_utf16_lossy(&units(u16::from_le_bytes)).into(),
        [0xfe, 0xff, ..] => String::from_utf16_lossy(&units(u16::from_be_bytes)).into(),
        [0xef, 0xbb, 0xbf, rest @ ..] => String::from_utf8_lossy(rest),
        _ => String::from_utf8_lossy(bytes),
    }
}

/// Lines of a text, which may end with LF, CR LF or CR.
pub(super) fn lines(text: &str) -> impl Iterator<Item = &str> {
    text.split('\n').flat_map(|line| {
        let line = line.strip_suffix('\r').unwrap_or(line);
        line.split('\r')
    })
}

/// Parses a number with a decimal point or, as some locales write it, one decimal comma.
pub(super) fn number<T: FromStr>(word: &str) -> Option<T> {
    let is_decimal_comma = !word.contains('.') && word.matches(',').count() == 1;
    match word.parse() {
        Ok(number) => Some(number),
        Err(_) if is_decimal_comma => word.replace(',', ".").parse().ok(),
        Err(_) => None,
    }
}

/// A name without its comment: `#` between blanks. Names like `Material #25` keep theirs.
pub(super) fn without_comment(name: &str) -> &str {
    let mut positions = name.match_indices('#').map(|(position, _)| position);
    let is_comment = |&at: &usize| {
        let (before, after) = (&name[..at], &name[at + 1..]);
        before.ends_with(char::is_whitespace)
            && after.chars().next().is_none_or(char::is_whitespace)
    };
    let end = positions.find(is_comment).unwrap_or(name.len());
    name[..end].trim()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn encodings_give_the_same_text() {
        let text = "v 1 2 3\n# Größe";
        let utf16 = |encode: fn(u16) -> [u8; 2]| -> Vec<u8> {
            ('\u{feff}'.to_string() + text)
                .encode_utf16()
                .flat_map(encode)
                .collect()
        };
        for bytes in [
            text.as_bytes().to_vec(),
            ('\u{feff}'.to_string() + text).into_bytes(),
            utf16(u16::to_le_bytes),
            utf16(u16::to_be_bytes),
        ] {
            assert_eq!(decode(&bytes), text);
        }
        assert_eq!(decode(b"\xff\xfe"), "");
        assert_eq!(decode(b"a\xe4"), "a\u{fffd}");
    }

    #[test]
    fn line_ends_of_all_systems_split_lines() {
        for text in ["a\nb\nc", "a\r\nb\r\nc", "a\rb\rc", "a\r\nb\rc"] {
            assert_eq!(lines(text).collect::<Vec<_>>(), ["a", "b", "c"], "{text:?}");
        }
    }

    #[test]
    fn decimal_commas_are_numbers_but_lists_are_not() {
        assert_eq!(number::<f64>("-20,5"), Some(-20.5));
        assert_eq!(number::<f32>("1,5e-3"), Some(1.5e-3));
        for word in ["1,2,3", "1,234.5", "", ",", "x"] {
            assert_eq!(number::<f64>(word), None, "{word}");
        }
    }

    #[test]
    fn only_a_hash_between_blanks_starts_a_comment() {
        for (name, expected) in [
            ("m # red", "m"),
            ("m #", "m"),
            ("Material #25", "Material #25"),
            ("Mat#25", "Mat#25"),
            ("a#b # c # d", "a#b"),
        ] {
            assert_eq!(without_comment(name), expected);
        }
    }
}
