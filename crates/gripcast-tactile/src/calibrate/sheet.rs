//! Overview image of a calibration: real, rendered and residual per press.

use image::{Rgb, RgbImage};

use super::press_set::PressSet;
use super::score::{ChangePlanes, PressScore, observe};
use gripcast_imaging::caption::{self, write_text};

/// Margin of a tile beyond the contact border, px.
const MARGIN_PX: f64 = 45.0;
/// Range of the side of a tile, px.
const SIDE: std::ops::RangeInclusive<u32> = 96..=400;
/// Gap between tiles, px.
const GAP: u32 = 4;
/// Height of a caption, px.
const CAPTION: u32 = caption::HEIGHT + 4;
/// Gain of the residual image.
const RESIDUAL_GAIN: f32 = 2.0;
/// Titles of the columns.
const COLUMNS: [&str; 4] = ["no contact", "real", "rendered", "residual x2"];

/// A press with its rendered change.
pub(super) struct Row<'a> {
    pub(super) index: usize,
    pub(super) change: ChangePlanes,
    pub(super) score: &'a PressScore,
}

/// One row per press: background with drift, real image, rendered image, and real − rendered at
/// twice its size around grey, captioned with file and scores.
pub(super) fn sheet(set: &PressSet, rows: &[Row<'_>]) -> RgbImage {
    let radius = rows
        .iter()
        .map(|row| set.presses[row.index].radius_px)
        .fold(0.0, f64::max);
    let side = (2.0 * (radius + MARGIN_PX)) as u32;
    let side = side.clamp(*SIDE.start(), *SIDE.end());
    let columns = COLUMNS.len() as u32;
    let width = columns * (side + GAP) + GAP;
    let height = CAPTION + rows.len() as u32 * (side + CAPTION + GAP) + GAP;
    let mut sheet = RgbImage::from_pixel(width, height, Rgb([24; 3]));
    for (column, title) in COLUMNS.into_iter().enumerate() {
        let x = GAP + column as u32 * (side + GAP);
        write_text(&mut sheet, x, 3, title, Rgb([230; 3]));
    }
    for (i, row) in rows.iter().enumerate() {
        let y = CAPTION + i as u32 * (side + CAPTION + GAP);
        let text = format!(
            "{}  fve {:.2}  psnr {:.1}",
            row.score.file, row.score.fve, row.score.patch_psnr_db
        );
        write_text(&mut sheet, GAP, y + 3, &text, Rgb([180; 3]));
        draw_row(&mut sheet, set, row, side, y + CAPTION);
    }
    sheet
}

fn draw_row(sheet: &mut RgbImage, set: &PressSet, row: &Row<'_>, side: u32, top: u32) {
    let press = &set.presses[row.index];
    let observed = observe(set, press);
    let (width, height) = press.image.dimensions();
    let corner = |centre: f64, full: u32| {
        let first = centre - 0.5 * f64::from(side);
        first.clamp(0.0, f64::from(full.saturating_sub(side))) as u32
    };
    let (left, upper) = (
        corner(press.centre_px[0], width),
        corner(press.centre_px[1], height),
    );
    for dy in 0..side.min(height) {
        for dx in 0..side.min(width) {
            let (x, y) = (left + dx, upper + dy);
            let i = (y * width + x) as usize;
            let real = press.image.get_pixel(x, y).0;
            let background: [f32; 3] = std::array::from_fn(|c| {
                (observed.gain[c] * f64::from(set.untouched[c][i]) + observed.offset[c]) as f32
            });
            let rendered: [f32; 3] = std::array::from_fn(|c| background[c] + row.change[c][i]);
            let residual: [f32; 3] =
                std::array::from_fn(|c| 128.0 + RESIDUAL_GAIN * (f32::from(real[c]) - rendered[c]));
            let tiles = [background, real.map(f32::from), rendered, residual];
            for (column, colour) in tiles.into_iter().enumerate() {
                let column_x = GAP + column as u32 * (side + GAP) + dx;
                sheet.put_pixel(column_x, top + dy, Rgb(colour.map(|v| (v + 0.5) as u8)));
            }
        }
    }
}
