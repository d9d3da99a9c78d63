//! Large digits and capitals, readable from a distance: a block font 5 pixels high.

use ratatui::buffer::Buffer;
use ratatui::layout::{Position, Rect};
use ratatui::style::Style;

/// Font size.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Size {
    /// 3 rows; a pixel is half a cell.
    Small,
    /// 5 rows; a pixel is 2×1 cells.
    Medium,
    /// 10 rows; a pixel is 4×2 cells.
    Large,
}

/// Rows of the font.
const GLYPH_ROWS: u16 = 5;

impl Size {
    /// All sizes, largest first.
    pub(super) const DESCENDING: [Self; 3] = [Self::Large, Self::Medium, Self::Small];

    /// Returns the height of a text, rows.
    pub(super) fn rows(self) -> u16 {
        match self {
            Self::Small => 3,
            Self::Medium => 5,
            Self::Large => 10,
        }
    }

    /// Returns the width of `text`, columns.
    pub(super) fn columns(self, text: &str) -> u16 {
        let pixels: u16 = text.chars().map(|c| glyph(c).width + 1).sum();
        pixels.saturating_sub(1) * self.pixel_columns()
    }

    fn pixel_columns(self) -> u16 {
        match self {
            Self::Small => 1,
            Self::Medium => 2,
            Self::Large => 4,
        }
    }
}

/// A character: pixel rows from the top, leftmost pixel in the most significant of `width` bits.
#[derive(Clone, Copy)]
struct Glyph {
    width: u16,
    rows: [u8; GLYPH_ROWS as usize],
}

impl Glyph {
    fn is_set(self, x: u16, y: u16) -> bool {
        self.rows
            .get(usize::from(y))
            .is_some_and(|row| row >> (self.width - 1 - x) & 1 == 1)
    }
}

fn glyph(character: char) -> Glyph {
    let (width, rows) = match character.to_ascii_uppercase() {
        '0' | 'O' => (3, [7, 5, 5, 5, 7]),
        '1' => (3, [2, 6, 2, 2, 7]),
        '2' => (3, [7, 1, 7, 4, 7]),
        '3' => (3, [7, 1, 3, 1, 7]),
        '4' => (3, [5, 5, 7, 1, 1]),
        '5' | 'S' => (3, [7, 4, 7, 1, 7]),
        '6' => (3, [7, 4, 7, 5, 7]),
        '7' => (3, [7, 1, 2, 2, 2]),
        '8' => (3, [7, 5, 7, 5, 7]),
        '9' => (3, [7, 5, 7, 1, 7]),
        '.' => (1, [0, 0, 0, 0, 1]),
        '-' => (3, [0, 0, 7, 0, 0]),
        'A' => (3, [7, 5, 7, 5, 5]),
        'B' => (3, [6, 5, 6, 5, 6]),
        'C' => (3, [7, 4, 4, 4, 7]),
        'D' => (3, [6, 5, 5, 5, 6]),
        'E' => (3, [7, 4, 6, 4, 7]),
        'F' => (3, [7, 4, 6, 4, 4]),
        'G' => (3, [7, 4, 5, 5, 7]),
        'H' => (3, [5, 5, 7, 5, 5]),
        'I' => (1, [1, 1, 1, 1, 1]),
        'J' => (3, [1, 1, 1, 5, 7]),
        'K' => (3, [5, 5, 6, 5, 5]),
        'L' => (3, [4, 4, 4, 4, 7]),
        'M' => (5, [17, 27, 21, 17, 17]),
        'N' => (4, [9, 13, 11, 9, 9]),
        'P' => (3, [7, 5, 7, 4, 4]),
        'Q' => (4, [14, 10, 10, 14, 1]),
        'R' => (3, [7, 5, 6, 5, 5]),
        'T' => (3, [7, 2, 2, 2, 2]),
        'U' => (3, [5, 5, 5, 5, 7]),
        'V' => (3, [5, 5, 5, 5, 2]),
        'W' => (5, [17, 17, 21, 27, 17]),
        'X' => (3, [5, 5, 2, 5, 5]),
        'Y' => (3, [5, 5, 2, 2, 2]),
        'Z' => (3, [7, 1, 2, 4, 7]),
        _ => (2, [0; 5]),
    };
    Glyph { width, rows }
}

/// Draws `text` at the top left of `area`, clipped to `area`.
pub(super) fn draw(buffer: &mut Buffer, area: Rect, text: &str, size: Size, style: Style) {
    let area = area.intersection(buffer.area);
    let mut left = area.x;
    for character in text.chars() {
        let glyph = glyph(character);
        for y in 0..size.rows() {
            for x in 0..glyph.width * size.pixel_columns() {
                let position = Position::new(left.saturating_add(x), area.y.saturating_add(y));
                let symbol = symbol(glyph, x, y, size);
                if symbol != " "
                    && area.contains(position)
                    && let Some(cell) = buffer.cell_mut(position)
                {
                    cell.set_symbol(symbol).set_style(style);
                }
            }
        }
        left = left.saturating_add((glyph.width + 1) * size.pixel_columns());
    }
}

/// Returns the symbol of cell (`x`, `y`) of a glyph.
fn symbol(glyph: Glyph, x: u16, y: u16, size: Size) -> &'static str {
    let (above, below) = match size {
        Size::Small => (glyph.is_set(x, 2 * y), glyph.is_set(x, 2 * y + 1)),
        Size::Medium => [glyph.is_set(x / 2, y); 2].into(),
        Size::Large => [glyph.is_set(x / 4, y / 2); 2].into(),
    };
    match (above, below) {
        (true, true) => "█",
        (true, false) => "▀",
        (false, true) => "▄",
        (false, false) => " ",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drawn(text: &str, size: Size) -> Vec<String> {
        let area = Rect::new(0, 0, size.columns(text), size.rows());
        let mut buffer = Buffer::empty(area);
        draw(&mut buffer, area, text, size, Style::new());
        (0..area.height)
            .map(|y| (0..area.width).map(|x| buffer[(x, y)].symbol()).collect())
            .collect()
    }

    #[test]
    fn small_digits_use_half_blocks() {
        assert_eq!(
            drawn("0.7", Size::Small),
            ["█▀█   ▀▀█", "█ █    █ ", "▀▀▀ ▀  ▀ "]
        );
    }

    #[test]
    fn medium_digits_are_five_rows_of_double_blocks() {
        assert_eq!(
            drawn("41", Size::Medium),
            [
                "██  ██    ██  ",
                "██  ██  ████  ",
                "██████    ██  ",
                "    ██    ██  ",
                "    ██  ██████",
            ]
        );
    }

    #[test]
    fn glyphs_fit_their_width_and_are_distinct() {
        let all = "0123456789.-ABCDEFGHIJKLMNPQRTUVWXYZ";
        let mut seen = std::collections::BTreeMap::new();
        for character in all.chars() {
            let glyph = glyph(character);
            for row in glyph.rows {
                assert!(row < 1 << glyph.width, "{character}");
            }
            if let Some(other) = seen.insert((glyph.width, glyph.rows), character) {
                panic!("{character} looks like {other}");
            }
        }
    }

    #[test]
    fn drawing_is_clipped_to_the_area() {
        let mut buffer = Buffer::empty(Rect::new(0, 0, 5, 2));
        draw(
            &mut buffer,
            Rect::new(3, 1, 40, 40),
            "888",
            Size::Large,
            Style::new(),
        );
        assert_eq!(buffer[(4, 1)].symbol(), "█");
        assert_eq!(buffer[(2, 1)].symbol(), " ");
    }
}
