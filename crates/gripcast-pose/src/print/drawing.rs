//! Vector drawing of a sheet.

use glam::DVec2;

use crate::{Dictionary, MarkerCells};

/// Width of a thin line, mm.
pub(super) const THIN_MM: f64 = 0.25;

/// Red, green, blue.
pub type Colour = [u8; 3];

/// Black.
pub(super) const BLACK: Colour = [0; 3];

/// Anchor of a text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TextAnchor {
    /// Left end of the baseline.
    Start,
    /// Centre of the baseline.
    Middle,
}

/// An element of a drawing; positions in mm from the top left corner of the sheet, y down.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// A black rectangle with white holes: x, y, width, height of each.
    Marker {
        /// The black rectangle.
        outer: [f64; 4],
        /// Disjoint white rectangles within it.
        holes: Vec<[f64; 4]>,
    },
    /// A polyline.
    Line {
        /// The points.
        points: Vec<DVec2>,
        /// Whether the last point connects to the first.
        closed: bool,
        /// Width, mm.
        width_mm: f64,
        /// Lengths of dashes and gaps, mm.
        dash_mm: Option<[f64; 2]>,
        /// Colour.
        colour: Colour,
    },
    /// A line of text, ASCII.
    Text {
        /// Position of the anchor.
        at: DVec2,
        /// Font size, mm.
        size_mm: f64,
        /// Anchor.
        anchor: TextAnchor,
        /// The text.
        text: String,
    },
}

/// A sheet of paper.
#[derive(Clone, Debug, PartialEq)]
pub struct Drawing {
    /// Width and height, mm.
    pub size_mm: [f64; 2],
    /// Title in the file's metadata.
    pub title: String,
    /// Elements in drawing order.
    pub shapes: Vec<Shape>,
}

impl Drawing {
    /// An empty sheet.
    pub fn new(size_mm: [f64; 2], title: &str) -> Self {
        Self {
            size_mm,
            title: ascii(title),
            shapes: Vec::new(),
        }
    }

    /// Adds a marker with the top left corner of its border at `corner`.
    pub(super) fn marker(
        &mut self,
        dictionary: &Dictionary,
        cells: &MarkerCells,
        corner: DVec2,
        side_mm: f64,
    ) {
        let cell = side_mm / dictionary.cells_per_side() as f64;
        let border = dictionary.border_cells();
        let at = |index: usize| (border + index) as f64 * cell;
        let mut holes = Vec::new();
        for row in 0..cells.side() {
            let mut column = 0;
            while column < cells.side() {
                let start = column;
                while column < cells.side() && cells.is_white(row, column) {
                    column += 1;
                }
                if column > start {
                    let width = (column - start) as f64 * cell;
                    holes.push([corner.x + at(start), corner.y + at(row), width, cell]);
                }
                column += 1;
            }
        }
        self.shapes.push(Shape::Marker {
            outer: [corner.x, corner.y, side_mm, side_mm],
            holes,
        });
    }

    /// Adds a thin black line.
    pub(super) fn thin_line(&mut self, from: DVec2, to: DVec2) {
        self.line(vec![from, to], THIN_MM, BLACK);
    }

    /// Adds a solid line.
    pub(super) fn line(&mut self, points: Vec<DVec2>, width_mm: f64, colour: Colour) {
        self.shapes.push(Shape::Line {
            points,
            closed: false,
            width_mm,
            dash_mm: None,
            colour,
        });
    }

    /// Adds a dashed line.
    pub(super) fn dashed_line(&mut self, points: Vec<DVec2>, closed: bool) {
        self.shapes.push(Shape::Line {
            points,
            closed,
            width_mm: THIN_MM,
            dash_mm: Some([2.0, 1.5]),
            colour: BLACK,
        });
    }

    /// Adds text; other than ASCII characters become `?`.
    pub fn text(&mut self, at: DVec2, size_mm: f64, anchor: TextAnchor, text: &str) {
        self.shapes.push(Shape::Text {
            at,
            size_mm,
            anchor,
            text: ascii(text),
        });
    }

    /// Outer rectangles of the markers: x, y, width, height.
    pub fn markers(&self) -> impl Iterator<Item = [f64; 4]> {
        self.shapes.iter().filter_map(|shape| match shape {
            Shape::Marker { outer, .. } => Some(*outer),
            _ => None,
        })
    }
}

fn ascii(text: &str) -> String {
    let plain = |c: char| {
        if c == ' ' || c.is_ascii_graphic() {
            c
        } else {
            '?'
        }
    };
    text.chars().map(plain).collect()
}
