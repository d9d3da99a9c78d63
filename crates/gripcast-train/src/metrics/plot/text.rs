//! Text of figures: how much room it takes, and shortening it to what there is.

use std::fmt::Write as _;

use gripcast_report::{Esc, put};

/// Font size of names and labels, px; as in `style.css`.
pub(super) const NORMAL: f64 = 12.0;
/// Font size of numbers at axes and bars, px; as in `style.css`.
pub(super) const SMALL: f64 = 11.0;

/// Where the reference point of a text is.
#[derive(Clone, Copy)]
pub(super) enum Anchor {
    Start,
    Middle,
    End,
}

impl Anchor {
    fn name(self) -> &'static str {
        match self {
            Self::Start => "start",
            Self::Middle => "middle",
            Self::End => "end",
        }
    }
}

/// A line of text with its baseline at a point, of the size [`NORMAL`].
pub(super) fn label(out: &mut String, [x, y]: [f64; 2], anchor: Anchor, text: &str) {
    put!(
        out,
        "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{}\">{}</text>",
        anchor.name(),
        Esc(text)
    );
}

/// A line of text of the size [`SMALL`].
pub(super) fn small(out: &mut String, [x, y]: [f64; 2], anchor: Anchor, text: &str) {
    put!(
        out,
        "<text class=\"small\" x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{}\">{}</text>",
        anchor.name(),
        Esc(text)
    );
}

/// A number of the size [`SMALL`], centred, that stays readable on lines.
pub(super) fn value(out: &mut String, [x, y]: [f64; 2], text: &str) {
    put!(
        out,
        "<text class=\"small value\" x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"middle\">{}</text>",
        Esc(text)
    );
}

/// A line of text that runs upwards, centred on a point of its baseline.
pub(super) fn upright(out: &mut String, [x, y]: [f64; 2], text: &str) {
    put!(
        out,
        "<text transform=\"translate({x:.1} {y:.1}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
        Esc(text)
    );
}

/// A count with its thousands set apart: `12,000`.
pub(super) fn count(n: usize) -> String {
    let digits = n.to_string();
    let mut text = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

/// Room that a text takes at a font size, px. The font is the reader's, so this is the width in
/// DejaVu Sans, one of the widest, rounded up.
pub(super) fn width(text: &str, size: f64) -> f64 {
    size * text.chars().map(em).sum::<f64>()
}

/// Width of a character as a share of the font size.
fn em(c: char) -> f64 {
    match c {
        'i' | 'j' | 'l' | '|' | '\'' => 0.34,
        ' ' | '.' | ',' | ':' | ';' | 'f' | 'I' | '!' => 0.36,
        '(' | ')' | '[' | ']' | 't' | 'r' | '-' | '/' => 0.42,
        '0'..='9' | 'a'..='e' | 'g' | 'h' | 'k' | 'n'..='q' | 's' | 'u'..='v' | 'x'..='z' => 0.64,
        'm' | 'M' | 'w' | 'W' | '@' | '%' | '…' => 1.02,
        'A'..='Z' => 0.79,
        '!'..='~' => 0.84,
        // Also CJK, which are as wide as high, and symbols.
        _ => 1.05,
    }
}

/// The text, or as much of its beginning as fits into a width, with an ellipsis.
pub(super) fn fitted(text: &str, size: f64, room: f64) -> String {
    if width(text, size) <= room {
        return text.to_owned();
    }
    let mut short = String::new();
    let mut taken = width("…", size);
    for c in text.chars() {
        taken += size * em(c);
        if taken > room {
            break;
        }
        short.push(c);
    }
    format!("{}…", short.trim_end())
}

/// At most `limit` lines that fit into a width, broken between words; the last one is shortened.
pub(super) fn wrapped(text: &str, size: f64, room: f64, limit: usize) -> Vec<String> {
    let mut lines = Vec::new();
    let mut line = String::new();
    for word in text.split_whitespace() {
        let longer = if line.is_empty() {
            word.to_owned()
        } else {
            format!("{line} {word}")
        };
        if line.is_empty() || lines.len() + 1 >= limit || width(&longer, size) <= room {
            line = longer;
        } else {
            lines.push(std::mem::replace(&mut line, word.to_owned()));
        }
    }
    lines.push(line);
    lines.iter().map(|line| fitted(line, size, room)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_names_are_shortened_to_fit() {
        assert_eq!(fitted("V+T", NORMAL, 100.0), "V+T");
        let short = fitted("a very long name of a model", NORMAL, 80.0);
        assert!(
            short.starts_with("a very") && short.ends_with('…'),
            "{short}"
        );
        assert!(width(&short, NORMAL) <= 80.0);
        // It uses the room that there is.
        assert!(width(&short, NORMAL) > 60.0);
        assert_eq!(fitted("名前", NORMAL, 0.0), "…");
    }

    #[test]
    fn thousands_are_set_apart() {
        let counts = [0, 999, 1000, 12_345, 100_000, 1_234_567].map(count);
        let expected = ["0", "999", "1,000", "12,345", "100,000", "1,234,567"];
        assert_eq!(counts, expected);
    }

    #[test]
    fn lines_break_between_words() {
        let room = width("unseen objects", NORMAL);
        let lines = wrapped("seen objects unseen objects", NORMAL, room, 3);
        assert_eq!(lines, ["seen objects", "unseen objects"]);
        let lines = wrapped("seen objects unseen objects", NORMAL, room, 1);
        assert!(lines.len() == 1 && lines[0].ends_with('…'), "{lines:?}");
        assert_eq!(wrapped("", NORMAL, room, 3), [""]);
        let lines = wrapped("incomprehensibilities", NORMAL, 50.0, 3);
        assert!(lines.len() == 1 && lines[0].ends_with('…'), "{lines:?}");
    }
}
