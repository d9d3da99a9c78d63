//! Layout of the collect screen at all sizes.

use ratatui::Frame;
use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::text::Line;

use super::graphics::TerminalGraphics;
use super::palette::Palette;
use super::state::{Overlay, ScreenState};
use super::text::{inset, row, write};
use super::{
    counts, fault, footer, gauge, header, health, help, preview, prompt, refusal, sensors,
    start_report, steps,
};
use crate::daemon::EngineStatus;

/// Minimum size of the screen; smaller ones show one line only.
const MIN_COLUMNS: u16 = 40;
const MIN_ROWS: u16 = 10;
/// Minimum size for images and sensors.
const FULL_COLUMNS: u16 = 60;
const FULL_ROWS: u16 = 18;

/// Draws the whole screen with characters, a pure function of status and state.
pub fn draw(frame: &mut Frame<'_>, status: &EngineStatus, state: &ScreenState) {
    draw_with(frame, status, state, None);
}

/// Draws the whole screen, images through the graphics protocol of the terminal if it has one.
pub(super) fn draw_with(
    frame: &mut Frame<'_>,
    status: &EngineStatus,
    state: &ScreenState,
    graphics: Option<&mut TerminalGraphics>,
) {
    let area = frame.area();
    let buffer = frame.buffer_mut();
    if area.width < MIN_COLUMNS || area.height < MIN_ROWS {
        draw_tiny(buffer, area, status, state.palette);
    } else {
        draw_screen(buffer, area, status, state, graphics);
    }
    let last = row(area, area.height.saturating_sub(1));
    if let Some(prompt) = &state.prompt
        && let Some(cursor) = prompt::draw(frame.buffer_mut(), last, prompt, state.palette)
    {
        frame.set_cursor_position(cursor);
    }
}

fn draw_screen(
    buffer: &mut Buffer,
    area: Rect,
    status: &EngineStatus,
    state: &ScreenState,
    graphics: Option<&mut TerminalGraphics>,
) {
    let palette = state.palette;
    let [top, middle, bottom] = split(area, 1, 3);
    header::draw(buffer, top, status, palette);
    footer::draw(
        buffer,
        bottom,
        &status.session,
        state.notice.as_deref(),
        palette,
    );
    if state.shows_fault(status) {
        fault::draw(buffer, middle, status, palette);
    } else {
        // A panel over an image would be hidden by the next image.
        let graphics = graphics.filter(|_| state.overlay == Overlay::None);
        let warnings: Vec<_> =
            start_report::open_warnings(status, &state.dismissed_warnings).collect();
        let rows = start_report::rows(warnings.len(), middle.height);
        let [list, work, _] = split(middle, rows, 0);
        start_report::draw(buffer, list, &warnings, palette);
        draw_work(buffer, work, status, state, graphics);
        // A dismissed fault replaces the message line.
        fault::draw_line(buffer, row(bottom, 1), status, palette);
    }
    match state.overlay {
        Overlay::None => {}
        Overlay::Help => help::draw(buffer, middle, palette),
        Overlay::Sensors => health::draw(buffer, middle, &status.cameras, palette),
    }
}

/// Draws step, gauge or refusal, counts, sensors and images.
fn draw_work(
    buffer: &mut Buffer,
    area: Rect,
    status: &EngineStatus,
    state: &ScreenState,
    graphics: Option<&mut TerminalGraphics>,
) {
    let (palette, refusal) = (state.palette, &status.session.refusal);
    let full = area.width >= FULL_COLUMNS && area.height + 4 >= FULL_ROWS;
    let banner_rows = match area.height {
        40.. => 5,
        18.. => 3,
        _ => 2,
    };
    let [banner, rest, _] = split(area, banner_rows, 0);
    steps::draw(buffer, banner, &status.session, palette);
    let kept_for_body = match full {
        true => (area.height / 3).clamp(6, 9),
        false => 0,
    };
    let mut gauge_rows = gauge::rows(area.width, rest.height.saturating_sub(kept_for_body));
    if refusal.is_some() && !full {
        gauge_rows = rest.height;
    }
    let [gauge_area, body, _] = split(rest, gauge_rows, 0);
    match refusal {
        Some(refusal) => refusal::draw(buffer, gauge_area, refusal, palette),
        None => gauge::draw(buffer, gauge_area, status, palette),
    }
    if full {
        draw_body(buffer, body, status, state, graphics);
    } else {
        counts::draw(buffer, inset(body, 1, 0), status, palette);
    }
}

fn draw_body(
    buffer: &mut Buffer,
    area: Rect,
    status: &EngineStatus,
    state: &ScreenState,
    graphics: Option<&mut TerminalGraphics>,
) {
    let side_columns = match area.width {
        130.. => 32,
        _ => 24,
    };
    let mut side = inset(area, 1, 0);
    side.width = side_columns;
    let rest = inset(area, side_columns + 3, 0);
    draw_side(buffer, side, status, state.palette);
    preview::draw(buffer, rest, status, state, graphics);
}

/// Draws counts above sensors; on low screens sensors take precedence.
fn draw_side(buffer: &mut Buffer, area: Rect, status: &EngineStatus, palette: Palette) {
    let cameras = u16::try_from(status.cameras.len()).unwrap_or(u16::MAX);
    let spare = area.height.saturating_sub(counts::ROWS + cameras);
    let count_rows = area.height.saturating_sub(cameras).min(counts::ROWS);
    let gap = match spare {
        0 => 0,
        1 => 1,
        _ => 2,
    };
    let [upper, lower, _] = split(area, count_rows, 0);
    counts::draw(buffer, upper, status, palette);
    let [between, lower, _] = split(lower, gap, 0);
    if gap > 0 {
        let title = row(between, gap - 1);
        write(buffer, title, &Line::styled("SENSORS", palette.strong()));
    }
    sensors::draw(buffer, lower, status, palette);
}

/// Draws one line: a fault, else verdict and instruction.
fn draw_tiny(buffer: &mut Buffer, area: Rect, status: &EngineStatus, palette: Palette) {
    let middle = row(area, area.height / 2);
    if let Some(camera) = fault::faults(status).next() {
        let summary = fault::summary(camera, status);
        write(buffer, middle, &Line::styled(summary, palette.fault()));
        return;
    }
    let mut line: Line<'_> = gauge::brief(status, palette).into_iter().collect();
    let room = usize::from(area.width).saturating_sub(line.width());
    line.push_span(steps::brief(&status.session, room, palette));
    write(buffer, middle, &line);
}

/// Splits `area` into `top` rows, the rest, and `bottom` rows.
fn split(area: Rect, top: u16, bottom: u16) -> [Rect; 3] {
    let top = top.min(area.height);
    let bottom = bottom.min(area.height - top);
    let middle = area.height - top - bottom;
    let rows = |y, height| Rect {
        y: area.y + y,
        height,
        ..area
    };
    [rows(0, top), rows(top, middle), rows(top + middle, bottom)]
}
