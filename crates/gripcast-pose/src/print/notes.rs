//! Rulers and notes of a sheet.

use glam::DVec2;

use super::RULER_MM;
use super::drawing::{Drawing, TextAnchor};
use super::layout::NOTES_MM;

/// Unprintable border, mm.
pub(super) const MARGIN_MM: f64 = 8.0;
/// Font size of the notes, mm.
pub(super) const NOTE_MM: f64 = 2.6;
/// Font size of labels, mm.
pub(super) const LABEL_MM: f64 = 2.2;
/// Upper bound of the mean letter width, relative to the font size.
const LETTER: f64 = 0.56;

/// Draws a ruler of 100 mm from `start`, along x or upwards along y. It ends at the centres of its
/// first and last tick.
pub(super) fn ruler(drawing: &mut Drawing, start: DVec2, is_vertical: bool) {
    let (along, across) = if is_vertical {
        (DVec2::NEG_Y, DVec2::X)
    } else {
        (DVec2::X, DVec2::NEG_Y)
    };
    drawing.thin_line(start, start + along * RULER_MM);
    for tick in 0..=10 {
        let at = start + along * (0.1 * RULER_MM * f64::from(tick));
        let length = match tick {
            0 | 10 => 4.0,
            5 => 3.0,
            _ => 2.0,
        };
        drawing.thin_line(at, at + across * length);
    }
    let axis = if is_vertical { "y" } else { "x" };
    let label = format!("{RULER_MM:.0} mm");
    let end = start + along * RULER_MM;
    let (first, second) = if is_vertical {
        (DVec2::new(0.0, -1.2 - LABEL_MM), DVec2::new(0.0, -1.2))
    } else {
        (DVec2::new(1.5, -LABEL_MM), DVec2::new(1.5, 0.0))
    };
    drawing.text(end + first, LABEL_MM, TextAnchor::Start, axis);
    drawing.text(end + second, LABEL_MM, TextAnchor::Start, &label);
}

/// Draws both rulers in the lower left corner, and notes beside them at the offset `corner`.
pub(super) fn footer(drawing: &mut Drawing, corner: DVec2, lines: &[String]) {
    let [width, height] = drawing.size_mm;
    let floor = height - MARGIN_MM;
    ruler(drawing, DVec2::new(MARGIN_MM, floor), false);
    ruler(drawing, DVec2::new(MARGIN_MM, floor - NOTES_MM), true);
    let start = DVec2::new(MARGIN_MM + RULER_MM, floor - NOTES_MM) + corner;
    notes(drawing, start, width - MARGIN_MM - start.x, lines);
}

/// Draws notes from `corner` downwards, wrapped to `width` mm.
pub(super) fn notes(drawing: &mut Drawing, corner: DVec2, width: f64, lines: &[String]) {
    let max_length = (width / (LETTER * NOTE_MM)).floor().max(8.0) as usize;
    let mut y = corner.y;
    for line in lines.iter().flat_map(|line| wrap(line, max_length)) {
        y += 1.25 * NOTE_MM;
        drawing.text(DVec2::new(corner.x, y), NOTE_MM, TextAnchor::Start, &line);
    }
}

/// Splits text into lines of at most `max_length` letters; longer words are cut.
fn wrap(text: &str, max_length: usize) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in text.split_whitespace() {
        let letters: Vec<char> = word.chars().collect();
        for piece in letters.chunks(max_length) {
            let piece: String = piece.iter().collect();
            let count = lines.len();
            let last = &mut lines[count - 1];
            if last.is_empty() {
                *last = piece;
            } else if last.chars().count() + 1 + piece.chars().count() <= max_length {
                *last += " ";
                *last += &piece;
            } else {
                lines.push(piece);
            }
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn notes_wrap_between_words() {
        assert_eq!(wrap("aa bb cc", 5), ["aa bb", "cc"]);
        assert_eq!(wrap("abcdefgh i", 4), ["abcd", "efgh", "i"]);
        assert_eq!(wrap("", 4), [""]);
    }
}
