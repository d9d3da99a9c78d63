//! Sensor details: identity, state and counters of every camera.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};

use super::palette::Palette;
use super::sensors::state;
use super::text::{clipped, duration_ms, fill, inset, write, write_all};
use crate::daemon::CameraStatus;

pub(super) fn draw(buffer: &mut Buffer, area: Rect, cameras: &[CameraStatus], palette: Palette) {
    let style = palette.panel();
    fill(buffer, area, style);
    let title = " Sensors — h closes ";
    write(buffer, area, &Line::styled(title, palette.entry()));
    let per_camera = 3 + u16::from(usize::from(area.height) > cameras.len() * 4);
    for (index, camera) in (0..).zip(cameras) {
        let lines = lines(camera, usize::from(area.width), palette);
        write_all(buffer, inset(area, 0, 1 + index * per_camera), &lines);
    }
}

fn lines(camera: &CameraStatus, width: usize, palette: Palette) -> [Line<'static>; 3] {
    let (words, style) = state(&camera.state, palette);
    let reason = match camera.state.reason() {
        Some(reason) => format!(": {reason}"),
        None => String::new(),
    };
    let identity = [
        ("", &camera.product),
        ("serial ", &camera.serial),
        ("usb ", &camera.port),
    ];
    let identity = identity.into_iter().filter(|(_, value)| !value.is_empty());
    let identity: Vec<_> = identity
        .map(|(name, value)| format!("{name}{value}"))
        .collect();
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
        Line::raw(format!("{:10}{}", "", clipped(&identity.join("   "), room))),
        Line::from(vec![
            Span::styled(
                format!("{:10}{} received", "", camera.counters.received),
                palette.faint(),
            ),
            counter(camera.counters.sequence_gaps, "lost", palette),
            counter(camera.counters.damaged, "damaged", palette),
            counter(camera.counters.late, "late", palette),
            counter(camera.counters.reconnects, "reopened", palette),
        ]),
    ]
}

fn counter(count: u64, word: &str, palette: Palette) -> Span<'static> {
    let style = palette.warning_if(count > 0, palette.faint());
    Span::styled(format!("  {count} {word}"), style)
}
