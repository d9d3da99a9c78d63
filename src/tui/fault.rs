//! The fault screen: camera, port, duration and remedy.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::text::Line;

use super::big_digits::{self, Size};
use super::palette::Palette;
use super::sensors;
use super::text::{clipped, duration_ms, fill, inset, row, write, write_all};
use crate::daemon::{CameraState, CameraStatus, EngineStatus};
use gripcast_capture::camera::percent;
use gripcast_imaging::Role;
use gripcast_session::Step;

/// Iterates over failed cameras in the order of roles.
pub(super) fn faults(status: &EngineStatus) -> impl Iterator<Item = &CameraStatus> {
    status
        .cameras
        .iter()
        .filter(|camera| camera.state.is_fault())
}

fn camera_name(role: Role) -> &'static str {
    match role {
        Role::Left => "LEFT GELSIGHT",
        Role::Right => "RIGHT GELSIGHT",
        Role::Rgb => "COLOUR CAMERA",
        Role::Depth => "DEPTH CAMERA",
        Role::External => "EXTERNAL CAMERA",
    }
}

/// Returns the state in capitals, and its duration or extent if known.
pub(super) fn state_and_extent(state: &CameraState) -> (String, String) {
    let extent = match state {
        CameraState::Damaged { fraction, .. } => percent(*fraction),
        _ => state
            .since_s()
            .map_or_else(String::new, |for_s| duration_ms(for_s * 1e3)),
    };
    (state.word().to_uppercase(), extent)
}

/// Returns the remedy in one word, shown in large letters, and as a sentence.
fn remedy(state: &CameraState) -> (&'static str, &'static str) {
    match state {
        CameraState::Frozen { .. } => ("REPLUG", "REPLUG IT: the image does not change"),
        CameraState::Unplugged { .. } => ("PLUG IN", "PLUG IT IN: it reopens by itself"),
        CameraState::Unavailable { .. } => {
            ("FREE IT", "FREE IT: it is plugged in, but cannot be opened")
        }
        CameraState::Damaged { .. } => (
            "REPLUG",
            "REPLUG IT, or use another cable or port: many of its images are damaged",
        ),
        _ => ("REPLUG", "REPLUG IT: no frames arrive"),
    }
}

/// What the faults mean for triggers.
fn consequence(failed: &[&CameraStatus]) -> &'static str {
    match failed.iter().all(|camera| camera.state.delivers_frames()) {
        true => "triggers use the images that are whole",
        false => "capture is blocked until the camera recovers",
    }
}

/// Formats `2/3 cameras live`.
fn live_count(status: &EngineStatus) -> String {
    let live = status.cameras.iter().filter(|c| c.state.is_live()).count();
    format!("{live}/{} cameras live", status.cameras.len())
}

/// Formats product and port: `GelSight Mini R0B 2BNN-4ZE7   usb 3-2.1`, with the serial number if
/// the product string does not contain it.
pub(super) fn identity(camera: &CameraStatus) -> String {
    let port = match camera.port.as_str() {
        "" => "port unknown".to_owned(),
        port => format!("usb {port}"),
    };
    let (product, serial) = (&camera.product, &camera.serial);
    if product.replace('-', "").contains(serial.as_str()) {
        format!("{product}   {port}")
    } else {
        format!("{product}   serial {serial}   {port}")
    }
}

/// Formats the fault in one line: `LEFT GELSIGHT (2BNN4ZE7, usb 3-2.1) SILENT 1.4 s — replug …`.
pub(super) fn summary(camera: &CameraStatus, status: &EngineStatus) -> String {
    let (word, since) = state_and_extent(&camera.state);
    format!(
        "{} {word} {since}{}— {} ({}; {})",
        camera_name(camera.role),
        if since.is_empty() { "" } else { " " },
        remedy(&camera.state).1,
        identity(camera),
        live_count(status)
    )
}

/// Draws the fault screen between header and footer.
pub(super) fn draw(buffer: &mut Buffer, area: Rect, status: &EngineStatus, palette: Palette) {
    let failed: Vec<_> = faults(status).collect();
    let Some(first) = failed.first() else {
        return;
    };
    let below = u16::try_from(status.cameras.len() + 1).unwrap_or(u16::MAX);
    let block = Rect {
        height: area.height.saturating_sub(below).max(area.height.min(9)),
        ..area
    };
    let style = palette.fault();
    fill(buffer, area, ratatui::style::Style::new());
    fill(buffer, block, style);
    let margin = u16::from(block.height >= 6);
    let mut inner = inset(block, 2, margin);
    inner.height -= margin;
    let (word, remedy) = remedy(&first.state);
    let used = draw_heading(buffer, inner, first, palette);
    let mut lines = vec![
        identity(first),
        first.state.reason().unwrap_or_default().to_owned(),
        format!("→ {remedy}"),
        format!("{} · {}", live_count(status), consequence(&failed)),
    ];
    for other in failed.iter().skip(1) {
        let (word, since) = state_and_extent(&other.state);
        let (name, identity) = (camera_name(other.role), identity(other));
        lines.push(format!("also: {name} {word} {since}   {identity}"));
    }
    lines.push(match status.session.step {
        Step::Label => "the last grasp is saved; label it: s stable, f slip".to_owned(),
        _ => "all saved grasps are safe; this closes by itself (Esc minimises it)".to_owned(),
    });
    lines.retain(|line| !line.is_empty());
    let clipped = |line: &String| Line::styled(clipped(line, usize::from(inner.width)), style);
    let shown: Vec<_> = lines.iter().map(clipped).collect();
    write_all(buffer, inset(inner, 0, used), &shown);
    let written = used + u16::try_from(lines.len()).unwrap_or(u16::MAX);
    let free = inner.height.saturating_sub(written.saturating_add(1));
    let size = Size::DESCENDING
        .into_iter()
        .find(|size| size.rows() <= free && size.columns(word) <= inner.width);
    if let Some(size) = size {
        let foot = inset(inner, 0, inner.height - size.rows());
        big_digits::draw(buffer, foot, word, size, style);
    }
    let rest = inset(area, 2, block.height);
    sensors::draw(buffer, rest, status, palette);
}

/// Draws camera and state in large letters, or as text on small screens; returns the rows used.
fn draw_heading(buffer: &mut Buffer, area: Rect, camera: &CameraStatus, palette: Palette) -> u16 {
    let (word, since) = state_and_extent(&camera.state);
    let text = format!("{} {word}", camera.role.name());
    let size = Size::DESCENDING
        .into_iter()
        .find(|size| size.columns(&text) <= area.width && size.rows() + 7 <= area.height);
    let heading = format!("{}   {word} {since}", camera_name(camera.role));
    let line = Line::styled(clipped(&heading, usize::from(area.width)), palette.fault());
    match size {
        Some(size) => {
            big_digits::draw(buffer, area, &text, size, palette.fault());
            write(buffer, row(area, size.rows() + 1), &line);
            size.rows() + 2
        }
        None => {
            write(buffer, area, &line);
            1
        }
    }
}

/// Draws the fault in one highlighted line.
pub(super) fn draw_line(buffer: &mut Buffer, area: Rect, status: &EngineStatus, palette: Palette) {
    if let Some(first) = faults(status).next() {
        fill(buffer, row(area, 0), palette.fault());
        let text = format!(" {}", summary(first, status));
        let text = clipped(&text, usize::from(area.width));
        write(buffer, area, &Line::styled(text, palette.fault()));
    }
}
