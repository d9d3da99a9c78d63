//! Heat maps: a fraction per cell, as a shade and as a number.

use maud::{Markup, html};

use super::text::{Anchor, text};
use super::{Chart, px};
use crate::{MISSING, fixed};

/// Width and height of a cell, px.
const CELL: [f64; 2] = [46.0, 32.0];
/// Width of the row names, px.
const LEFT: f64 = 40.0;
const LIGHT: [f64; 3] = [240.0, 243.0, 246.0];
const DARK: [f64; 3] = [8.0, 64.0, 116.0];

/// Content of a cell.
#[derive(Clone, Debug, Default)]
pub struct HeatCell {
    /// Fraction; a cell without one is crossed out.
    pub fraction: Option<f64>,
    /// Text below the number.
    pub note: String,
    /// CSS class of a frame around it.
    pub frame: Option<&'static str>,
}

/// A heat map.
pub struct HeatMap<'a> {
    /// Accessible name.
    pub title: String,
    /// Accessible description.
    pub description: String,
    /// Row names, from the top.
    pub rows: &'a [String],
    /// Column names.
    pub columns: &'a [String],
}

impl HeatMap<'_> {
    /// Draws the map; `cell` returns the cell of a row and a column.
    pub fn chart(self, cell: impl Fn(usize, usize) -> HeatCell) -> Chart {
        let [columns, rows] = [self.columns.len() as f64, self.rows.len() as f64];
        let size = [LEFT + CELL[0] * columns + 4.0, CELL[1] * rows + 20.0];
        let corner = |row: usize, column: usize| {
            [LEFT + CELL[0] * column as f64, 2.0 + CELL[1] * row as f64]
        };
        let body = html! {
            @for (row, name) in self.rows.iter().enumerate() {
                @let [x, y] = corner(row, 0);
                (text("small", [x - 5.0, y + 0.5 * CELL[1] + 4.0], Anchor::End, name))
                @for column in 0..self.columns.len() {
                    (draw(corner(row, column), &cell(row, column)))
                }
            }
            @for (column, name) in self.columns.iter().enumerate() {
                @let [x, _] = corner(0, column);
                (text("small", [x + 0.5 * CELL[0], size[1] - 4.0], Anchor::Middle, name))
            }
            // Frames come last, or cells would cover them.
            @for row in 0..self.rows.len() {
                @for column in 0..self.columns.len() {
                    @if let Some(class) = cell(row, column).frame {
                        (rectangle(class, corner(row, column).map(|v| v - 1.0), CELL, None))
                    }
                }
            }
        };
        Chart {
            size,
            title: self.title,
            description: self.description,
            body,
        }
    }
}

fn draw([x, y]: [f64; 2], cell: &HeatCell) -> Markup {
    let size = CELL.map(|side| side - 2.0);
    let middle = x + 0.5 * size[0];
    let Some(fraction) = cell.fraction.filter(|fraction| fraction.is_finite()) else {
        return html! {
            g.cell {
                (rectangle("empty", [x, y], size, None))
                path.empty d={ "M" (px(x)) " " (px(y + size[1])) "l" (px(size[0])) " " (px(-size[1])) } {}
                (text("halo", [middle, y + 19.0], Anchor::Middle, MISSING))
            }
        };
    };
    let shade = Shade::new(fraction);
    html! {
        g.cell fill=(shade.text) {
            (rectangle("", [x, y], size, Some(&shade.fill)))
            (text("small number", [middle, y + 14.0], Anchor::Middle, &fixed(fraction, 2)))
            (text("small note", [middle, y + 25.0], Anchor::Middle, &cell.note))
        }
    }
}

fn rectangle(class: &str, at: [f64; 2], size: [f64; 2], fill: Option<&str>) -> Markup {
    let ([x, y], [width, height]) = (at.map(px), size.map(px));
    html! {
        rect class=[(!class.is_empty()).then_some(class)] x=(x) y=(y) width=(width)
            height=(height) fill=[fill] {}
    }
}

/// Draws a colour scale.
pub fn heat_scale() -> Markup {
    html! {
        p.scale aria-hidden="true" {
            @for fraction in [0.0, 0.25, 0.5, 0.75, 1.0] {
                @let shade = Shade::new(fraction);
                span style={ "background:" (shade.fill) ";color:" (shade.text) } {
                    (fixed(fraction, 2))
                }
            }
        }
    }
}

/// Colour of a cell and of its text; the same in the light and the dark scheme.
struct Shade {
    fill: String,
    text: &'static str,
}

impl Shade {
    fn new(fraction: f64) -> Self {
        // Most fractions are above one half: the square spreads them.
        let t = fraction.clamp(0.0, 1.0).powi(2);
        let mix = |i: usize| (LIGHT[i] + t * (DARK[i] - LIGHT[i])).round() as u8;
        let [r, g, b] = [mix(0), mix(1), mix(2)];
        Self {
            fill: format!("#{r:02x}{g:02x}{b:02x}"),
            text: if t < 0.65 { "#14181d" } else { "#ffffff" },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Relative luminance (WCAG 2).
    fn luminance(rgb: [u8; 3]) -> f64 {
        let linear = rgb.map(|v| {
            let v = f64::from(v) / 255.0;
            if v <= 0.040_45 {
                v / 12.92
            } else {
                ((v + 0.055) / 1.055).powf(2.4)
            }
        });
        0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
    }

    #[test]
    fn numbers_are_legible_on_every_shade() {
        for i in 0..=20 {
            let shade = Shade::new(f64::from(i) / 20.0);
            let of = |hex: &str| {
                let byte = |at: usize| u8::from_str_radix(&hex[at..at + 2], 16).unwrap();
                luminance([byte(1), byte(3), byte(5)]) + 0.05
            };
            let (a, b) = (of(&shade.fill), of(shade.text));
            assert!(a.max(b) / a.min(b) >= 4.3, "{}", shade.fill);
        }
    }

    #[test]
    fn empty_cells_are_crossed_out_and_frames_come_last() {
        let map = HeatMap {
            title: "<map>".to_owned(),
            description: "words".to_owned(),
            rows: &["0.4".to_owned()],
            columns: &["20".to_owned(), "40".to_owned()],
        };
        let chart = map.chart(|_, column| HeatCell {
            fraction: [Some(0.75), Some(f64::NAN)][column],
            note: "3 of 4".to_owned(),
            frame: (column == 0).then_some("chosen"),
        });
        super::super::layout::check(&chart.to_svg());
        let drawn = chart.inline().into_string();
        assert_eq!(drawn.matches("<g class=\"cell\"").count(), 2);
        assert_eq!(drawn.matches("<rect class=\"empty\"").count(), 1);
        assert!(
            drawn.find("\"chosen\"") > drawn.rfind("\"cell\""),
            "{drawn}"
        );
    }
}
