//! Camera images, aspect ratio kept: through the terminal's graphics protocol, else as half blocks,
//! two pixels per cell.

use std::sync::Arc;

use image::RgbImage;
use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Style;
use ratatui::text::{Line, Span};

use super::graphics::TerminalGraphics;
use super::palette::{ColourDepth, Palette};
use super::state::ScreenState;
use super::text::{clipped, inset, row, write};
use crate::daemon::{EngineStatus, ShearStatus};
use gripcast_imaging::Role;
use gripcast_shear::FingerForce;

/// Minimum width of an image; otherwise the last cameras are omitted.
const MIN_COLUMNS: u16 = 16;
/// Minimum size of an image with its caption if gels are shown twice.
const MIN_TWICE: (u16, u16) = (20, 8);
/// Aspect ratio assumed for the layout.
const DEFAULT_ASPECT: (u32, u32) = (4, 3);
/// Characters from empty to full, for terminals without colours.
const SHADES: &[u8] = b" .:-=+*#%@";
/// Grey level of no change in a tactile difference.
const NO_CHANGE: u8 = 128;

/// Which images of the gels are shown once there is an initial frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum GelImages {
    /// Image and difference where there is room for both, else the difference.
    #[default]
    Both,
    /// The image of the camera.
    Image,
    /// The difference to the initial frame.
    Difference,
}

impl GelImages {
    /// Returns the next choice.
    #[must_use]
    pub fn next(self) -> Self {
        match self {
            Self::Both => Self::Image,
            Self::Image => Self::Difference,
            Self::Difference => Self::Both,
        }
    }
}

/// One image of a camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Shown {
    role: Role,
    is_difference: bool,
    /// Whether the other image of this gel is not shown.
    is_alone: bool,
}

/// Draws the images of as many cameras as fit, each with its caption.
pub(super) fn draw(
    buffer: &mut Buffer,
    area: Rect,
    status: &EngineStatus,
    state: &ScreenState,
    mut graphics: Option<&mut TerminalGraphics>,
) {
    if area.height < 2 {
        return;
    }
    let (shown, across, cell) = layout(area, status, state.gels);
    for (index, shown) in (0..).zip(&shown) {
        let tile = Rect {
            x: area.x + index % across * (cell.width + 1),
            y: area.y + index / across * cell.height,
            ..cell
        };
        draw_tile(
            buffer,
            tile,
            *shown,
            status,
            state.palette,
            graphics.as_deref_mut(),
        );
    }
}

/// Returns the images, the number of columns and the size of a tile.
fn layout(area: Rect, status: &EngineStatus, gels: GelImages) -> (Vec<Shown>, u16, Rect) {
    let mut roles: Vec<Role> = status.cameras.iter().map(|camera| camera.role).collect();
    roles.extend(status.previews.keys());
    roles.sort_unstable();
    roles.dedup();
    let has_difference = |role: Role| {
        let preview = status.previews.get(&role);
        preview.is_some_and(|preview| preview.difference.is_some())
    };
    let twice = roles.iter().filter(|role| has_difference(**role)).count();
    let (across, cell) = grid(area, roles.len() + twice);
    let (width, height) = MIN_TWICE;
    if gels == GelImages::Both && twice > 0 && cell.width >= width && cell.height >= height {
        let image = |is_difference| {
            move |role: &Role| Shown {
                role: *role,
                is_difference,
                is_alone: false,
            }
        };
        let mut shown: Vec<Shown> = roles.iter().map(image(false)).collect();
        shown.extend(
            roles
                .iter()
                .filter(|role| has_difference(**role))
                .map(image(true)),
        );
        // The difference of a gel stands beside its image, or below it.
        if across % 2 == 0 || across == 1 {
            shown.sort_by_key(|shown| shown.role);
        }
        return (shown, across, cell);
    }
    while roles.len() > 1 && grid(area, roles.len()).1.width < MIN_COLUMNS {
        roles.pop();
    }
    let (across, cell) = grid(area, roles.len());
    let single = |role: &Role| Shown {
        role: *role,
        is_difference: gels != GelImages::Image && has_difference(*role),
        is_alone: true,
    };
    (roles.iter().map(single).collect(), across, cell)
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

fn draw_tile(
    buffer: &mut Buffer,
    tile: Rect,
    shown: Shown,
    status: &EngineStatus,
    palette: Palette,
    graphics: Option<&mut TerminalGraphics>,
) {
    if tile.height < 2 || tile.width < 3 {
        return;
    }
    let caption = caption(shown, status, tile.width, palette);
    write(buffer, row(tile, 0), &caption);
    let below = inset(tile, 0, 1);
    let preview = status.previews.get(&shown.role);
    let image = preview.and_then(|preview| match shown.is_difference {
        true => preview.difference.as_ref(),
        false => Some(&preview.image),
    });
    let Some(image) = image.filter(|image| image.width() > 0 && image.height() > 0) else {
        let text = clipped("no image yet", usize::from(below.width));
        let line = Line::styled(text, palette.faint());
        write(buffer, row(below, below.height / 2), &line);
        return;
    };
    let is_drawn =
        graphics.is_some_and(|graphics| graphics.draw(buffer, below, image_id(shown), image));
    if !is_drawn {
        draw_image(buffer, below, image, shown.is_difference, palette.depth);
    }
}

/// Returns a number of the image among all cameras, from 1.
fn image_id(shown: Shown) -> u32 {
    1 + 2 * shown.role as u32 + u32::from(shown.is_difference)
}

fn caption(shown: Shown, status: &EngineStatus, width: u16, palette: Palette) -> Line<'static> {
    let role = shown.role;
    let has_difference = status
        .previews
        .get(&role)
        .is_some_and(|preview| preview.difference.is_some());
    let kind = match (shown.is_difference, has_difference && shown.is_alone) {
        (true, _) => " difference",
        (false, true) => " image",
        (false, false) => "",
    };
    let contact = status
        .contact
        .get(&role)
        .filter(|_| shown.is_difference || shown.is_alone);
    let shear = status.shear.get(&role).and_then(ShearStatus::words);
    let force = status.force.get(&role).map(FingerForce::words);
    let details = match (contact, shear) {
        (Some(contact), shear) => {
            let touched = format!("{kind} · contact {contact:.1}");
            let with_force = force.map(|force| format!("{touched} · {force}"));
            let full = shear.map(|shear| {
                let before = with_force.as_ref().unwrap_or(&touched);
                format!("{before} · {shear}")
            });
            let full = full.into_iter().chain(with_force);
            let shorter = [
                touched,
                format!(" contact {contact:.1}"),
                format!(" {contact:.1}"),
            ];
            full.chain(shorter).collect()
        }
        // Beside its difference, the image of a gel has room for force and shear.
        (None, shear) if kind.is_empty() => {
            let bare = shear
                .as_ref()
                .map(|s| s.replace("shear ", "").replace("slip ", ""));
            let both = force.as_ref().zip(shear.as_ref());
            let both = both.map(|(force, shear)| format!("{force} · {shear}"));
            let words = [both, force, shear, bare].into_iter().flatten();
            let mut words: Vec<String> = words.map(|words| format!(" {words}")).collect();
            words.push(String::new());
            words
        }
        (None, _) => vec![kind.to_owned()],
    };
    let room = usize::from(width).saturating_sub(role.name().len());
    let fitting = details.iter().find(|detail| detail.chars().count() <= room);
    Line::from(vec![
        Span::styled(role.name(), palette.strong()),
        Span::styled(fitting.cloned().unwrap_or_default(), palette.faint()),
    ])
}

/// Fits an image into `columns` × `rows` cells; a cell is two square pixels high.
fn fitted(size: (u32, u32), columns: u16, rows: u16) -> Rect {
    fitted_to_cells(size, columns, rows, (1.0, 2.0))
}

/// Fits an image into `columns` × `rows` cells of a width and height.
pub(super) fn fitted_to_cells(
    (width, height): (u32, u32),
    columns: u16,
    rows: u16,
    (cell_width, cell_height): (f64, f64),
) -> Rect {
    let width = f64::from(width.max(1)) / cell_width;
    let height = f64::from(height.max(1)) / cell_height;
    let scale = (f64::from(columns) / width).min(f64::from(rows) / height);
    Rect::new(
        0,
        0,
        ((width * scale).round() as u16).clamp(columns.min(1), columns),
        ((height * scale).round() as u16).clamp(rows.min(1), rows),
    )
}

fn draw_image(
    buffer: &mut Buffer,
    area: Rect,
    image: &Arc<RgbImage>,
    is_difference: bool,
    depth: ColourDepth,
) {
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
    use image::Rgb;
    use ratatui::style::Color;

    use super::*;
    use crate::daemon::Preview;
    use gripcast_shear::{ShearSource, ShearSummary};

    const PALETTE: Palette = Palette {
        depth: ColourDepth::True,
    };

    /// Two gels with differences, and a colour camera.
    fn status() -> EngineStatus {
        let mut status = EngineStatus::starting("d", "r", gripcast_session::Labels::default());
        let image = Arc::new(RgbImage::new(64, 48));
        for role in [Role::Left, Role::Right, Role::Rgb] {
            let difference = role.is_tactile().then(|| Arc::clone(&image));
            let image = Arc::clone(&image);
            let preview = Preview {
                image,
                difference,
                levels: None,
                driver_time_ns: 0,
            };
            status.previews.insert(role, preview);
        }
        status.contact.insert(Role::Left, 8.4);
        status
    }

    fn names(shown: &[Shown]) -> Vec<String> {
        let name = |shown: &Shown| match shown.is_difference {
            true => format!("{} difference", shown.role),
            false => shown.role.to_string(),
        };
        shown.iter().map(name).collect()
    }

    #[test]
    fn gels_are_shown_twice_where_there_is_room() {
        let images = |width, height, gels| {
            let (shown, across, _) = layout(Rect::new(0, 0, width, height), &status(), gels);
            (names(&shown), across)
        };
        let (shown, across) = images(160, 14, GelImages::Both);
        assert_eq!(across, 5);
        assert_eq!(
            shown,
            [
                "left",
                "right",
                "rgb",
                "left difference",
                "right difference"
            ]
        );
        let (shown, across) = images(60, 60, GelImages::Both);
        assert_eq!(across, 2);
        assert_eq!(
            shown,
            [
                "left",
                "left difference",
                "right",
                "right difference",
                "rgb"
            ]
        );
        for (gels, expected) in [
            (
                GelImages::Both,
                ["left difference", "right difference", "rgb"],
            ),
            (
                GelImages::Difference,
                ["left difference", "right difference", "rgb"],
            ),
            (GelImages::Image, ["left", "right", "rgb"]),
        ] {
            assert_eq!(images(53, 9, gels).0, expected);
        }
    }

    #[test]
    fn captions_name_the_image_and_its_contact() {
        let told = |status: &EngineStatus, is_difference, is_alone, width| {
            let shown = Shown {
                role: Role::Left,
                is_difference,
                is_alone,
            };
            caption(shown, status, width, PALETTE).to_string()
        };
        let of = |is_difference, is_alone, width| told(&status(), is_difference, is_alone, width);
        assert_eq!(of(true, true, 30), "left difference · contact 8.4");
        assert_eq!(of(true, true, 17), "left contact 8.4");
        assert_eq!(of(true, true, 8), "left 8.4");
        assert_eq!(of(false, true, 30), "left image · contact 8.4");
        assert_eq!(of(false, false, 30), "left");
        let mut sheared = status();
        let summary = ShearSummary {
            source: ShearSource::Markers,
            confidence: 0.9,
            tracked_fraction: 1.0,
            mean_displacement_mm: [0.3, 0.3],
            max_displacement_mm: 1.0,
            divergence: 0.0,
            curl: 0.0,
            contact_fraction: 0.2,
            slip_ratio: Some(0.12),
        };
        let shear = ShearStatus {
            summary: Some(summary),
            messages: Vec::new(),
        };
        sheared.shear.insert(Role::Left, shear);
        let of = |is_difference, is_alone, width| told(&sheared, is_difference, is_alone, width);
        let all = "left difference · contact 8.4 · shear 0.42 mm ↘ slip 12 %";
        assert_eq!(of(true, true, 60), all);
        assert_eq!(of(true, true, 40), "left difference · contact 8.4");
        assert_eq!(of(false, false, 40), "left shear 0.42 mm ↘ slip 12 %");
        assert_eq!(of(false, false, 21), "left 0.42 mm ↘ 12 %");
        assert_eq!(of(false, false, 10), "left");
        let force = FingerForce {
            normal_n: 12.3,
            normal_std_n: 2.1,
            shear_n: None,
            shear_std_n: None,
            is_calibrated: true,
        };
        sheared.force.insert(Role::Left, force);
        let of = |is_difference, is_alone, width| told(&sheared, is_difference, is_alone, width);
        let all = "left 12.3 N ± 2 · shear 0.42 mm ↘ slip 12 %";
        assert_eq!(of(false, false, 60), all);
        assert_eq!(of(false, false, 20), "left 12.3 N ± 2");
        let all = "left difference · contact 8.4 · 12.3 N ± 2 · shear 0.42 mm ↘ slip 12 %";
        assert_eq!(of(true, true, 80), all);
        assert_eq!(
            of(true, true, 50),
            "left difference · contact 8.4 · 12.3 N ± 2"
        );
        sheared.shear.clear();
        assert_eq!(told(&sheared, false, false, 20), "left 12.3 N ± 2");
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
        draw_image(
            &mut buffer,
            area,
            &Arc::new(image),
            false,
            ColourDepth::True,
        );
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
        draw_image(&mut buffer, area, &Arc::new(image), true, ColourDepth::Mono);
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
