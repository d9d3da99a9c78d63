//! Text in charts: estimated widths, truncation and line breaks.

use maud::{Markup, html};

use super::px;

/// Font size of names and labels, px; as in `style.css`.
pub const NORMAL: f64 = 12.0;
/// Font size of the class `small`, px; as in `style.css`.
pub const SMALL: f64 = 11.0;

/// Anchor point of a text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Anchor {
    /// Start of the text.
    Start,
    /// Middle of the text.
    Middle,
    /// End of the text.
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

/// Draws a line of text with its baseline at a point; nothing for an empty text. Classes: `small`,
/// `halo`.
pub fn text(class: &str, [x, y]: [f64; 2], anchor: Anchor, text: &str) -> Markup {
    html! {
        @if !text.is_empty() {
            text class=[(!class.is_empty()).then_some(class)] x=(px(x)) y=(px(y))
                text-anchor=(anchor.name()) { (text) }
        }
    }
}

/// Draws a vertical line of text.
pub fn upright(class: &str, [x, y]: [f64; 2], anchor: Anchor, text: &str) -> Markup {
    html! {
        @if !text.is_empty() {
            text class=[(!class.is_empty()).then_some(class)]
                transform={ "translate(" (px(x)) " " (px(y)) ") rotate(-90)" }
                text-anchor=(anchor.name()) { (text) }
        }
    }
}

/// Formats a count with thousands separators: `12,000`.
pub fn count(n: usize) -> String {
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

/// Estimates the width of a text at a font size, px: an upper bound for DejaVu Sans, one of the
/// widest fonts that a reader may have.
pub fn width(text: &str, size: f64) -> f64 {
    size * text.chars().map(em).sum::<f64>()
}

/// Width of a character as a fraction of the font size.
fn em(c: char) -> f64 {
    match c {
        'i' | 'j' | 'l' | '|' | '\'' => 0.34,
        ' ' | '.' | ',' | ':' | ';' | 'f' | 'I' | '!' => 0.36,
        '(' | ')' | '[' | ']' | 't' | 'r' | '-' | '/' => 0.42,
        '0'..='9' | 'a'..='e' | 'g' | 'h' | 'k' | 'n'..='q' | 's' | 'u'..='v' | 'x'..='z' => 0.64,
        'm' | 'M' | 'w' | 'W' | '@' | '%' | '…' => 1.02,
        'A'..='Z' => 0.79,
        '!'..='~' => 0.84,
        // Also CJK, which are square, and symbols.
        _ => 1.05,
    }
}

/// Truncates a text to a width, with an ellipsis.
pub fn truncated(text: &str, size: f64, max_width: f64) -> String {
    if width(text, size) <= max_width {
        return text.to_owned();
    }
    let mut short = String::new();
    let mut taken = width("…", size);
    for c in text.chars() {
        taken += size * em(c);
        if taken > max_width {
            break;
        }
        short.push(c);
    }
    format!("{}…", short.trim_end())
}

/// Breaks a text between words into at most `limit` lines of a width; the last line is truncated.
pub fn wrapped(text: &str, size: f64, max_width: f64, limit: usize) -> Vec<String> {
    let mut lines = Vec::new();
    let mut line = String::new();
    for word in text.split_whitespace() {
        let longer = if line.is_empty() {
            word.to_owned()
        } else {
            format!("{line} {word}")
        };
        if line.is_empty() || lines.len() + 1 >= limit || width(&longer, size) <= max_width {
            line = longer;
        } else {
            lines.push(std::mem::replace(&mut line, word.to_owned()));
        }
    }
    lines.push(line);
    lines
        .iter()
        .map(|line| truncated(line, size, max_width))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_names_are_truncated() {
        assert_eq!(truncated("V+T", NORMAL, 100.0), "V+T");
        let short = truncated("a very long name of a model", NORMAL, 80.0);
        assert!(
            short.starts_with("a very") && short.ends_with('…'),
            "{short}"
        );
        assert!(width(&short, NORMAL) <= 80.0);
        // It uses the available width.
        assert!(width(&short, NORMAL) > 60.0);
        assert_eq!(truncated("名前", NORMAL, 0.0), "…");
    }

    #[test]
    fn counts_have_thousands_separators() {
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
