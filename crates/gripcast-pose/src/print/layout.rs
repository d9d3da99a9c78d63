//! Where the markers of an object's sheet go: a ring along the paper's border.

use glam::DVec2;

use super::drawing::Drawing;
use super::furniture::{LABEL_MM, MARGIN_MM};
use super::paper::Paper;
use super::silhouette::Silhouette;

/// Height of the strip of notes below the markers, mm.
pub(super) const NOTES_MM: f64 = 20.0;
/// Width of the strip of the vertical ruler, mm.
const RULER_STRIP_MM: f64 = 8.0;
/// Least distance between an object and a marker's quiet zone, mm: room for the line, and for
/// seeing the marker past the object.
const CLEARANCE_MM: f64 = 4.0;
/// Fewest markers on two opposite sides.
const MIN: usize = 3;

/// Sizes that a layout keeps to, mm.
#[derive(Clone, Copy, Debug)]
pub(super) struct MarkerSize {
    pub(super) side: f64,
    /// Width of a cell: that of the quiet zone.
    pub(super) cell: f64,
}

/// Markers and object on a sheet.
#[derive(Clone, Debug)]
pub(super) struct Layout {
    /// Width and height of the sheet, mm.
    pub(super) size_mm: [f64; 2],
    /// Place of the silhouette's middle on the sheet.
    pub(super) middle: DVec2,
    /// Top left corners of the markers, clockwise from the top left one.
    pub(super) corners: Vec<DVec2>,
}

/// The best layout on a paper, in portrait or landscape: that with the most markers. None if the
/// object leaves too few places.
pub(super) fn layout(paper: Paper, size: MarkerSize, silhouette: &Silhouette) -> Option<Layout> {
    let tried = [paper.landscape_mm(), paper.portrait_mm()];
    let found = tried.map(|sheet| on_sheet(sheet, size, silhouette));
    // Landscape where both are as good.
    let best = found.into_iter().flatten().rev();
    best.max_by_key(|layout| layout.corners.len())
}

/// The rectangle that markers may fill: its corners, mm.
fn area(size_mm: [f64; 2], size: MarkerSize) -> [DVec2; 2] {
    let [width, height] = size_mm;
    [
        DVec2::new(MARGIN_MM + RULER_STRIP_MM + size.cell, MARGIN_MM),
        DVec2::new(
            width - MARGIN_MM,
            height - MARGIN_MM - NOTES_MM - size.cell - 1.5 * LABEL_MM,
        ),
    ]
}

fn on_sheet(size_mm: [f64; 2], size: MarkerSize, silhouette: &Silhouette) -> Option<Layout> {
    let [low, high] = area(size_mm, size);
    let middle = 0.5 * (low + high);
    let half = 0.5 * (silhouette.high - silhouette.low);
    if half.x > 0.5 * (high.x - low.x) || half.y > 0.5 * (high.y - low.y) {
        return None;
    }
    let room = size.cell + CLEARANCE_MM;
    let is_free = |corner: &Place| {
        // The sheet's y runs down, the object's up.
        let of_object = |p: DVec2| {
            let off = p - middle;
            0.5 * (silhouette.low + silhouette.high) + DVec2::new(off.x, -off.y)
        };
        let (a, b) = (
            of_object(corner.at - room),
            of_object(corner.at + size.side + room),
        );
        !silhouette.touches(a.min(b), a.max(b))
    };
    let places: Vec<Place> = ring(low, high, size)?.into_iter().filter(is_free).collect();
    let count = |side: Side| {
        places
            .iter()
            .filter(|p| p.sides.contains(&Some(side)))
            .count()
    };
    let both = |a: Side, b: Side| count(a) >= MIN && count(b) >= MIN;
    if !both(Side::Top, Side::Bottom) && !both(Side::Left, Side::Right) {
        return None;
    }
    Some(Layout {
        size_mm,
        middle,
        corners: places.into_iter().map(|p| p.at).collect(),
    })
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Side {
    Top,
    Right,
    Bottom,
    Left,
}

/// A place of a marker: its top left corner, and the sides of the ring that it is part of.
#[derive(Clone, Copy, Debug)]
struct Place {
    at: DVec2,
    sides: [Option<Side>; 2],
}

/// Places evenly along the border of a rectangle, clockwise from the top left one; none if it is
/// too small for two along each side.
fn ring(low: DVec2, high: DVec2, size: MarkerSize) -> Option<Vec<Place>> {
    // Room for two quiet zones and the number between them.
    let gap = (0.5 * size.side).max(2.0 * size.cell + 1.5 * LABEL_MM);
    let count = |length: f64| ((length + gap) / (size.side + gap)).floor() as usize;
    let (columns, rows) = (count(high.x - low.x), count(high.y - low.y));
    if columns < 2 || rows < 2 {
        return None;
    }
    let pitch = |length: f64, count: usize| (length - size.side) / (count - 1) as f64;
    let step = DVec2::new(pitch(high.x - low.x, columns), pitch(high.y - low.y, rows));
    let place = |column: usize, row: usize| {
        let x = match column {
            0 => Some(Side::Left),
            c if c + 1 == columns => Some(Side::Right),
            _ => None,
        };
        let y = match row {
            0 => Some(Side::Top),
            r if r + 1 == rows => Some(Side::Bottom),
            _ => None,
        };
        Place {
            at: low + step * DVec2::new(column as f64, row as f64),
            sides: [x, y],
        }
    };
    let top = (0..columns).map(|c| place(c, 0));
    let right = (1..rows).map(|r| place(columns - 1, r));
    let bottom = (0..columns - 1).rev().map(|c| place(c, rows - 1));
    let left = (1..rows - 1).rev().map(|r| place(0, r));
    Some(top.chain(right).chain(bottom).chain(left).collect())
}

/// Whether a rectangle keeps out of the quiet zones of all markers of a drawing, `cell` mm wide.
pub(super) fn keeps_quiet(drawing: &Drawing, low: DVec2, high: DVec2, cell: f64) -> bool {
    drawing.markers().all(|[x, y, width, height]| {
        high.x <= x - cell
            || low.x >= x + width + cell
            || high.y <= y - cell
            || low.y >= y + height + cell
    })
}
