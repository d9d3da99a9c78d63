//! Sheets and tags as posed images, for renderers.

use glam::DVec2;
use image::{GrayImage, Luma};

use super::ObjectSheet;
use super::png::raster;
use crate::{BoardFile, BoardMarker, Dictionary, MarkerCells};
use gripcast_base::error::Result;
use gripcast_imaging::FlatPrint;

/// Resolution of a sheet, dots per inch.
const SHEET_DPI: f64 = 300.0;
/// Pixels per cell of a tag.
const CELL_PX: u32 = 24;

impl ObjectSheet {
    /// The sheet in the world frame, printed to scale.
    ///
    /// # Errors
    /// Those of [`raster`].
    pub fn flat_print(&self) -> Result<FlatPrint> {
        let paper = raster(&self.drawing, SHEET_DPI)?;
        // The size of the image: that of the sheet, rounded to whole pixels.
        let size_mm = DVec2::new(f64::from(paper.width()), f64::from(paper.height()));
        let size_mm = size_mm * 25.4 / SHEET_DPI;
        let corner = |x: f64, y: f64| self.to_world(DVec2::new(x, y)).to_array();
        Ok(FlatPrint {
            paper,
            corners_m: [
                corner(0.0, 0.0),
                corner(size_mm.x, 0.0),
                corner(size_mm.x, size_mm.y),
                corner(0.0, size_mm.y),
            ],
        })
    }
}

impl BoardFile {
    /// The markers with a quiet zone of one cell, in their body frames, each with its displacement
    /// along x per metre of opening.
    pub fn flat_prints(&self) -> Vec<(f64, FlatPrint)> {
        let markers = self.board.markers.iter();
        let print = |marker: &BoardMarker| {
            let cells = self.dictionary.marker(marker.id)?;
            Some((marker.body.slide(), tag(marker, &cells, &self.dictionary)))
        };
        markers.filter_map(print).collect()
    }
}

fn tag(marker: &BoardMarker, cells: &MarkerCells, dictionary: &Dictionary) -> FlatPrint {
    let count = dictionary.cells_per_side() as u32;
    let border = dictionary.border_cells();
    let is_white = |x: u32, y: u32| {
        let cell = |at: u32| (at / CELL_PX).checked_sub(1).filter(|cell| *cell < count);
        let (Some(column), Some(row)) = (cell(x), cell(y)) else {
            return true;
        };
        let inner = |at: u32| (at as usize).checked_sub(border);
        match (inner(row), inner(column)) {
            (Some(row), Some(column)) if row.max(column) < cells.side() => {
                cells.is_white(row, column)
            }
            _ => false,
        }
    };
    let side = (count + 2) * CELL_PX;
    let [top_left, top_right, _, bottom_left] = marker.corners_m;
    let cell = 1.0 / f64::from(count);
    let (right, down) = (top_right - top_left, bottom_left - top_left);
    let at = |x: f64, y: f64| (top_left + x * right + y * down).to_array();
    FlatPrint {
        paper: GrayImage::from_fn(side, side, |x, y| {
            Luma([if is_white(x, y) { 255 } else { 0 }])
        }),
        corners_m: [
            at(-cell, -cell),
            at(1.0 + cell, -cell),
            at(1.0 + cell, 1.0 + cell),
            at(-cell, 1.0 + cell),
        ],
    }
}
