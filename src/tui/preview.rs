//! Camera images as half blocks: two pixels per cell, aspect ratio kept.

use image::RgbImage;
use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Style;
use ratatui::text::{Line, Span};

use super::palette::{ColourDepth, Palette};
use super::text::{clipped, inset, row, write};
use crate::daemon::{EngineStatus, Preview};
use gripcast_imaging::Role;

/// Minimum width of an image; otherwise the last cameras are omitted.
const MIN_COLUMNS: u16 = 16;
/// Aspect ratio assumed for the layout.
const DEFAULT_ASPECT: (u32, u32) = (4, 3);
/// Characters from empty to full, for terminals without colours.
const SHADES: &[u8] = b" .:-=+*#%@";
/// Grey level of no change in a tactile difference.
const NO_CHANGE: u8 = 128;

/// Draws the images of as many cameras as fit, each with its caption.
pub(super) fn draw(buffer: &mut Buffer, area: Rect, status: &EngineStatus, palette: Palette) {
    let mut roles: Vec<Role> = status.cameras.iter().map(|camera| camera.role).collect();
    roles.extend(status.previews.keys());
    roles.sort_unstable();
    roles.dedup();
    while roles.len() > 1 && grid(area, roles.len()).1.width < MIN_COLUMNS {
        roles.pop();
    }
    if roles.is_empty() || area.height < 2 {
        return;
    }
    let (across, cell) = grid(area, roles.len());
    for (index, role) in (0..).zip(&roles) {
        let tile = Rect {
            x: area.x + index % across * (cell.width + 1),
            y: area.y + index / across * cell.height,
            ..cell
        };
        draw_tile(buffer, tile, *role, status, palette);
    }
}

/// Returns the number of columns and the tile size with the largest images.
fn grid(area: Rect, count: usize) -> (u16, Rect) {
    let count = u16::try_from(count).unwrap_or(u16::MAX).max(1);
    let tile = |across: u16| {
        let width = (area.width + 1) / across - u16::from(across <= area.width);
        Rect::new(0, 0, width, area.height / count.div_ceil(across))
    };
    let across = (1..=count)
        .max_by_key(|&across| {
            let tile = tile(across);
            fitted(DEFAULT_ASPECT, tile.width, tile.height.saturating_sub(1)).area()
        })
        .unwrap_or(1);
    (across, tile(across))
}

fn draw_tile(buffer: &mut Buffer, tile: Rect, role: Role, status: &EngineStatus, palette: Palette) {
    if tile.height < 2 || tile.width < 3 {
        return;
    }
    let preview = status.previews.get(&role);
    let contact = status.contact.get(&role).copied();
    let caption = caption(role, (preview, contact), tile.width, palette);
    write(buffer, row(tile, 0), &caption);
    let below = inset(tile, 0, 1);
    match preview {
        Some(preview) if preview.image.width() > 0 && preview.image.height() > 0 => {
            draw_image(buffer, below, preview, palette.depth);
        }
        _ => {
            let text = clipped("no image yet", usize::from(below.width));
            let line = Line::styled(text, palette.faint());
            write(buffer, row(below, below.height / 2), &line);
        }
    }
}

fn caption(
    role: Role,
    (preview, contact): (Option<&Preview>, Option<f64>),
    width: u16,
    palette: Palette,
) -> Line<'static> {
    let room = usize::from(width).saturating_sub(role.name().len());
    let detail = match (contact, preview) {
        (Some(contact), _) => match format!(" contact {contact:.1}") {
            long if long.len() <= room => long,
            _ => format!(" {contact:.1}"),
        },
        (None, Some(preview)) if preview.difference.is_some() => " difference".to_owned(),
        _ => String::new(),
    };
    Line::from(vec![
        Span::styled(role.name(), palette.strong()),
        Span::styled(clipped(&detail, room), palette.faint()),
    ])
}

/// Fits an image into `columns` × `rows` cells; a cell is two square pixels high.
fn fitted((width, height): (u32, u32), columns: u16, rows: u16) -> Rect {
    let (width, height) = (f64::from(width.max(1)), f64::from(height.max(1)));
    let scale = (f64::from(columns) / width).min(2.0 * f64::from(rows) / height);
    Rect::new(
        0,
        0,
        ((width * scale).round() as u16).clamp(columns.min(1), columns),
        ((height * scale / 2.0).round() as u16).clamp(rows.min(1), rows),
    )
}

fn draw_image(buffer: &mut Buffer, area: Rect, preview: &Preview, depth: ColourDepth) {
    let (image, is_difference) = preview.shown();
    let size = fitted(image.dimensions(), area.width, area.height);
    for y in 0..size.height {
        for x in 0..size.width {
            let pixel = |half: u16| {
                mean(
                    image,
                    span(x, size.width, image.width()),
                    span(2 * y + half, 2 * size.height, image.height()),
                )
            };
            let (upper, lower) = (pixel(0), pixel(1));
            let Some(cell) = buffer.cell_mut((area.x + x, area.y + y)) else {
                continue;
            };
            match (depth.colour(upper), depth.colour(lower)) {
                (Some(fg), Some(bg)) => {
                    cell.set_symbol("▀").set_style(Style::new().fg(fg).bg(bg));
                }
                _ => {
                    cell.set_char(shade(upper, lower, is_difference));
                }
            }
        }
    }
}

/// Returns the source pixels of segment `index` of `parts`, at least one.
fn span(index: u16, parts: u16, pixels: u32) -> std::ops::Range<u32> {
    let edge = |i: u32| i * pixels / u32::from(parts.max(1));
    let start = edge(u32::from(index)).min(pixels - 1);
    start..edge(u32::from(index) + 1).clamp(start + 1, pixels)
}

fn mean(image: &RgbImage, columns: std::ops::Range<u32>, rows: std::ops::Range<u32>) -> [u8; 3] {
    let count = ((columns.end - columns.start) * (rows.end - rows.start)).max(1);
    let mut sum = [0_u32; 3];
    for y in rows {
        for x in columns.clone() {
            for (total, value) in sum.iter_mut().zip(image.get_pixel(x, y).0) {
                *total += u32::from(value);
            }
        }
    }
    sum.map(|total| (total / count) as u8)
}

/// Returns a character for the brightness, or for the strength of change in a difference image.
fn shade(upper: [u8; 3], lower: [u8; 3], is_difference: bool) -> char {
    let strength = |pixel: [u8; 3]| -> usize {
        if is_difference {
            let change = pixel.map(|v| usize::from(v.abs_diff(NO_CHANGE)));
            (2 * change.into_iter().max().unwrap_or(0)).min(255)
        } else {
            pixel.into_iter().map(usize::from).sum::<usize>() / 3
        }
    };
    let level = (strength(upper) + strength(lower)) * (SHADES.len() - 1) / 510;
    char::from(SHADES[level.min(SHADES.len() - 1)])
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use image::Rgb;
    use ratatui::style::Color;

    use super::*;

    fn preview(image: RgbImage, is_difference: bool) -> Preview {
        let image = Arc::new(image);
        Preview {
            difference: is_difference.then(|| Arc::clone(&image)),
            image,
        }
    }

    #[test]
    fn aspect_ratio_is_kept() {
        assert_eq!(fitted((320, 240), 40, 100), Rect::new(0, 0, 40, 15));
        assert_eq!(fitted((320, 240), 400, 15), Rect::new(0, 0, 40, 15));
        assert_eq!(fitted((1, 10_000), 40, 15), Rect::new(0, 0, 1, 15));
        assert_eq!(fitted((320, 240), 0, 0), Rect::new(0, 0, 0, 0));
    }

    #[test]
    fn cell_shows_upper_and_lower_pixel() {
        let image = RgbImage::from_fn(4, 4, |_, y| {
            Rgb(if y < 2 { [200, 10, 20] } else { [0, 90, 250] })
        });
        let area = Rect::new(0, 0, 2, 1);
        let mut buffer = Buffer::empty(area);
        draw_image(&mut buffer, area, &preview(image, false), ColourDepth::True);
        for x in 0..2 {
            let cell = &buffer[(x, 0)];
            assert_eq!(cell.symbol(), "▀");
            assert_eq!(cell.fg, Color::Rgb(200, 10, 20));
            assert_eq!(cell.bg, Color::Rgb(0, 90, 250));
        }
    }

    #[test]
    fn monochrome_difference_shows_changes_only() {
        let image = RgbImage::from_fn(2, 1, |x, _| Rgb([128 + 127 * x as u8; 3]));
        let area = Rect::new(0, 0, 2, 1);
        let mut buffer = Buffer::empty(area);
        draw_image(&mut buffer, area, &preview(image, true), ColourDepth::Mono);
        assert_eq!(buffer[(0, 0)].symbol(), " ");
        assert_ne!(buffer[(1, 0)].symbol(), " ");
    }

    #[test]
    fn grid_maximises_image_size() {
        assert_eq!(grid(Rect::new(0, 0, 60, 9), 3).0, 3);
        assert_eq!(grid(Rect::new(0, 0, 100, 40), 4).0, 2);
        assert_eq!(grid(Rect::new(0, 0, 30, 60), 3).0, 1);
    }

    #[test]
    fn spans_cover_each_source_pixel_once() {
        let covered: Vec<u32> = (0..7).flat_map(|i| span(i, 7, 320)).collect();
        assert_eq!(covered, (0..320).collect::<Vec<_>>());
        assert_eq!(span(5, 100, 3), 0..1);
    }
}
