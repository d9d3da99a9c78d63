//! Layout of an object sheet: a ring of markers along the border of the paper.

use glam::DVec2;

use super::drawing::Drawing;
use super::notes::{LABEL_MM, MARGIN_MM};
use super::paper::Paper;
use super::silhouette::Silhouette;

/// Height of the strip of notes below the markers, mm.
pub(super) const NOTES_MM: f64 = 20.0;
/// Width of the strip of the vertical ruler, mm.
const RULER_STRIP_MM: f64 = 8.0;
/// Minimum distance between the object and a marker's quiet zone, mm.
const CLEARANCE_MM: f64 = 4.0;
/// Minimum number of markers on each of two opposite sides.
const MIN: usize = 3;

/// Sizes of a marker, mm.
#[derive(Clone, Copy, Debug)]
pub(super) struct MarkerSize {
    pub(super) side: f64,
    /// Width of a cell and of the quiet zone.
    pub(super) cell: f64,
}

/// Markers and object on a sheet.
#[derive(Clone, Debug)]
pub(super) struct Layout {
    /// Width and height of the sheet, mm.
    pub(super) size_mm: [f64; 2],
    /// Position of the silhouette's centre on the sheet.
    pub(super) centre: DVec2,
    /// Top left corners of the markers, clockwise from the top left one.
    pub(super) corners: Vec<DVec2>,
}

/// The layout with the most markers, in portrait or landscape. `None`: too few markers fit.
pub(super) fn layout(paper: Paper, size: MarkerSize, silhouette: &Silhouette) -> Option<Layout> {
    let tried = [paper.landscape_mm(), paper.portrait_mm()];
    let found = tried.map(|sheet| on_sheet(sheet, size, silhouette));
    // Landscape if both have as many markers.
    let best = found.into_iter().flatten().rev();
    best.max_by_key(|layout| layout.corners.len())
}

/// Corners of the rectangle for markers, mm.
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
    let centre = 0.5 * (low + high);
    let half = 0.5 * (silhouette.high - silhouette.low);
    if half.x > 0.5 * (high.x - low.x) || half.y > 0.5 * (high.y - low.y) {
        return None;
    }
    let room = size.cell + CLEARANCE_MM;
    let is_free = |corner: DVec2| {
        // y is down on the sheet and up in the silhouette.
        let to_silhouette = |p: DVec2| {
            let off = p - centre;
            0.5 * (silhouette.low + silhouette.high) + DVec2::new(off.x, -off.y)
        };
        let (a, b) = (
            to_silhouette(corner - room),
            to_silhouette(corner + size.side + room),
        );
        !silhouette.touches(a.min(b), a.max(b))
    };
    let (mut ring, counts) = ring(low, high, size)?;
    ring.retain(|(_, corner)| is_free(*corner));
    let has_both_sides = |axis: usize| {
        let count = |index: usize| ring.iter().filter(|(at, _)| at[axis] == index).count();
        count(0) >= MIN && count(counts[axis] - 1) >= MIN
    };
    (has_both_sides(0) || has_both_sides(1)).then(|| Layout {
        size_mm,
        centre,
        corners: ring.iter().map(|(_, corner)| *corner).collect(),
    })
}

/// Column and row of a marker, and its top left corner.
type RingMarker = ([usize; 2], DVec2);

/// Evenly spaced markers along the border of a rectangle, clockwise from the top left, and the
/// number of columns and rows. `None`: it is too small for two along each side.
fn ring(low: DVec2, high: DVec2, size: MarkerSize) -> Option<(Vec<RingMarker>, [usize; 2])> {
    // Room for two quiet zones with the label between them.
    let gap = (0.5 * size.side).max(2.0 * size.cell + 1.5 * LABEL_MM);
    let count = |length: f64| ((length + gap) / (size.side + gap)).floor() as usize;
    let (columns, rows) = (count(high.x - low.x), count(high.y - low.y));
    if columns < 2 || rows < 2 {
        return None;
    }
    let pitch = |length: f64, count: usize| (length - size.side) / (count - 1) as f64;
    let step = DVec2::new(pitch(high.x - low.x, columns), pitch(high.y - low.y, rows));
    let marker = |column: usize, row: usize| {
        let corner = low + step * DVec2::new(column as f64, row as f64);
        ([column, row], corner)
    };
    let top = (0..columns).map(|c| marker(c, 0));
    let right = (1..rows).map(|r| marker(columns - 1, r));
    let bottom = (0..columns - 1).rev().map(|c| marker(c, rows - 1));
    let left = (1..rows - 1).rev().map(|r| marker(0, r));
    let ring = top.chain(right).chain(bottom).chain(left);
    Some((ring.collect(), [columns, rows]))
}

/// Whether a rectangle is outside the quiet zones (`cell` mm wide) of all markers of a drawing.
pub(super) fn is_outside_quiet_zones(
    drawing: &Drawing,
    low: DVec2,
    high: DVec2,
    cell: f64,
) -> bool {
    drawing.markers().all(|[x, y, width, height]| {
        high.x <= x - cell
            || low.x >= x + width + cell
            || high.y <= y - cell
            || low.y >= y + height + cell
    })
}
