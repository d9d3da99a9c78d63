//! The first line: dataset, rig, scene, operator, black box, clock, disk.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Style;
use ratatui::text::{Line, Span};

use super::palette::Palette;
use super::text::{clipped, without_last, write, write_right};
use crate::daemon::{BlackBoxStatus, CameraState, EngineStatus};

const LOW_DISK_BYTES: u64 = 5_000_000_000;
const FULL_DISK_BYTES: u64 = 1_000_000_000;

pub(super) fn draw(buffer: &mut Buffer, area: Rect, status: &EngineStatus, palette: Palette) {
    let right = right(status, palette);
    let taken = write_right(buffer, area, &right);
    let left = without_last(area, taken + 1);
    let all = |is: fn(&CameraState) -> bool| status.cameras.iter().all(|c| is(&c.state));
    let mark = if all(CameraState::is_live) {
        Span::styled("✓", palette.stable())
    } else if all(CameraState::delivers_frames) {
        Span::styled("!", palette.warning())
    } else {
        Span::styled("✗", palette.slip())
    };
    let session = &status.session;
    let mut spans = vec![
        Span::styled(" gripcast ", palette.strong()),
        Span::styled(clipped(&status.dataset, 24), palette.key()),
        Span::raw(format!("  rig {} ", clipped(&status.rig, 16))),
        mark,
    ];
    for (name, value) in [("scene", &session.scene), ("by", &session.operator)] {
        if !value.is_empty() {
            spans.push(Span::styled(format!("  {name} "), palette.faint()));
            spans.push(Span::raw(clipped(value, 18)));
        }
    }
    let mut line = Line::from(spans);
    while line.width() > usize::from(left.width) && line.spans.len() > 4 {
        line.spans.truncate(line.spans.len() - 2);
    }
    write(buffer, left, &line);
}

fn right(status: &EngineStatus, palette: Palette) -> Line<'_> {
    let mut spans = Vec::new();
    if let Some(black_box) = &status.black_box {
        let (text, style) = recording(black_box, palette);
        spans.push(Span::styled(text, style));
    }
    spans.push(Span::raw(clipped(&status.clock, 12)));
    if let Some(free) = status.disk_free_bytes {
        let style = match free {
            _ if free < FULL_DISK_BYTES => palette.slip(),
            _ if free < LOW_DISK_BYTES => palette.warning(),
            _ => Style::new(),
        };
        spans.push(Span::styled(format!("   disk {} ", bytes(free)), style));
    }
    Line::from(spans)
}

/// Returns the state of the black box: `REC 1.2 GB` while it logs everything.
fn recording(black_box: &BlackBoxStatus, palette: Palette) -> (String, Style) {
    if black_box.stopped.is_some() {
        return ("REC off   ".into(), palette.warning());
    }
    let size = bytes(black_box.bytes);
    if black_box.dropped > 0 {
        let text = format!("REC {size}, {} dropped   ", black_box.dropped);
        return (text, palette.warning());
    }
    (format!("REC {size}   "), palette.faint())
}

/// Formats a byte count in decimal units.
fn bytes(bytes: u64) -> String {
    let gb = bytes as f64 / 1e9;
    match gb {
        _ if gb >= 9_950.0 => format!("{:.0} TB", gb / 1e3),
        _ if gb >= 9.95 => format!("{gb:.0} GB"),
        _ if gb >= 1.0 => format!("{gb:.1} GB"),
        _ => format!("{:.0} MB", gb * 1e3),
    }
}

#[cfg(test)]
mod tests {
    use super::bytes;

    #[test]
    fn byte_counts_use_decimal_units() {
        assert_eq!(bytes(212_000_000_000), "212 GB");
        assert_eq!(bytes(4_230_000_000), "4.2 GB");
        assert_eq!(bytes(640_000_000), "640 MB");
        assert_eq!(bytes(12_000_000_000_000), "12 TB");
    }
}
