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
/// Number of remaining grasps below which it is a warning.
const FEW_GRASPS: u64 = 100;
/// Minimum width for free space and number of grasps.
const WIDE_COLUMNS: u16 = 100;

pub(super) fn draw(buffer: &mut Buffer, area: Rect, status: &EngineStatus, palette: Palette) {
    let right = right(status, area.width, palette);
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

fn right(status: &EngineStatus, width: u16, palette: Palette) -> Line<'_> {
    let mut spans = Vec::new();
    if let Some(black_box) = &status.black_box {
        let (text, style) = recording(black_box, palette);
        spans.push(Span::styled(text, style));
    }
    spans.push(Span::raw(clipped(&status.clock, 12)));
    spans.extend(disk(status, width, palette));
    Line::from(spans)
}

/// Returns the free space, and the number of grasps that fit where there is room or few do.
fn disk(status: &EngineStatus, width: u16, palette: Palette) -> Option<Span<'static>> {
    let free = status.disk_free_bytes?;
    let left = status.grasps_left.unwrap_or(u64::MAX);
    let style = match free {
        _ if free < FULL_DISK_BYTES || left == 0 => palette.slip(),
        _ if free < LOW_DISK_BYTES || left < FEW_GRASPS => palette.warning(),
        _ => Style::new(),
    };
    let grasps = status.grasps_left.map(|left| match left {
        1 => "1 grasp left".to_owned(),
        _ => format!("{left} grasps left"),
    });
    let words = match grasps {
        Some(grasps) if width >= WIDE_COLUMNS => format!("disk {} · {grasps}", bytes(free)),
        Some(grasps) if left < FEW_GRASPS => format!("disk: {grasps}"),
        _ => format!("disk {}", bytes(free)),
    };
    Some(Span::styled(format!("   {words} "), style))
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
    use super::*;
    use crate::tui::palette::ColourDepth;
    use gripcast_session::Labels;

    #[test]
    fn remaining_grasps_are_shown_where_they_matter() {
        let palette = Palette {
            depth: ColourDepth::True,
        };
        let shown = |grasps_left, width| {
            let status = EngineStatus {
                disk_free_bytes: Some(212_000_000_000),
                grasps_left,
                ..EngineStatus::starting("d", "r", Labels::default())
            };
            let span = disk(&status, width, palette).unwrap();
            (span.content.trim().to_owned(), span.style)
        };
        let plain = |text: &str| (text.to_owned(), Style::new());
        assert_eq!(
            shown(Some(12_400), 120),
            plain("disk 212 GB · 12400 grasps left")
        );
        assert_eq!(shown(Some(12_400), 80), plain("disk 212 GB"));
        assert_eq!(shown(None, 120), plain("disk 212 GB"));
        assert_eq!(
            shown(Some(85), 80),
            ("disk: 85 grasps left".to_owned(), palette.warning())
        );
        assert_eq!(
            shown(Some(0), 80),
            ("disk: 0 grasps left".to_owned(), palette.slip())
        );
    }

    #[test]
    fn byte_counts_use_decimal_units() {
        assert_eq!(bytes(212_000_000_000), "212 GB");
        assert_eq!(bytes(4_230_000_000), "4.2 GB");
        assert_eq!(bytes(640_000_000), "640 MB");
        assert_eq!(bytes(12_000_000_000_000), "12 TB");
    }
}
