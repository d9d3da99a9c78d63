//! The sensors in detail: identity, state and all counters of every camera.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};

use super::palette::Palette;
use super::sensors::state;
use super::text::{clipped, duration_ms, fill, row, write};
use crate::daemon::{CameraState, CameraStatus};

pub(super) fn draw(buffer: &mut Buffer, area: Rect, cameras: &[CameraStatus], palette: Palette) {
    let style = palette.panel();
    fill(buffer, area, style);
    let title = " Sensors — h closes ";
    write(buffer, area, &Line::styled(title, palette.entry()));
    let per_camera = if usize::from(area.height) > cameras.len() * 4 {
        4
    } else {
        3
    };
    for (index, camera) in (0..).zip(cameras) {
        let lines = lines(camera, usize::from(area.width), palette);
        for (offset, line) in (0..).zip(lines) {
            let at = row(area, 1 + index * per_camera + offset);
            write(buffer, at, &line);
        }
    }
}

fn lines(camera: &CameraStatus, width: usize, palette: Palette) -> [Line<'static>; 3] {
    let (words, style) = state(&camera.state, palette);
    let reason = match &camera.state {
        CameraState::Lost { reason } => format!(": {reason}"),
        _ => String::new(),
    };
    let identity = [
        camera.product.clone(),
        named("serial", &camera.serial),
        named("usb", &camera.port),
    ];
    let identity: Vec<_> = identity.into_iter().filter(|s| !s.is_empty()).collect();
    let age = camera
        .frame_age_ms
        .map_or_else(|| "–".to_owned(), duration_ms);
    let room = width.saturating_sub(10);
    [
        Line::from(vec![
            Span::styled(format!(" {:<9}", camera.role), palette.strong()),
            Span::styled(words, style),
            Span::styled(clipped(&reason, room.saturating_sub(14)), style),
            Span::raw(format!(
                "   {:.1} of {:.1} fps   frame {age} old",
                camera.measured_fps, camera.nominal_fps
            )),
        ]),
        Line::raw(format!(
            "          {}",
            clipped(&identity.join("   "), room)
        )),
        Line::from(vec![
            Span::styled(
                format!("          {} received", camera.received),
                palette.faint(),
            ),
            counter(camera.sequence_gaps, "lost", palette),
            counter(camera.damaged, "damaged", palette),
            counter(camera.late, "late", palette),
            counter(camera.reconnects, "reopened", palette),
        ]),
    ]
}

fn named(name: &str, value: &str) -> String {
    if value.is_empty() {
        String::new()
    } else {
        format!("{name} {value}")
    }
}

fn counter(count: u64, word: &str, palette: Palette) -> Span<'static> {
    let style = match count {
        0 => palette.faint(),
        _ => palette.warning(),
    };
    Span::styled(format!("  {count} {word}"), style)
}
