//! Clipping and drawing of text, and formatting of durations.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Style;
use ratatui::text::{Line, Span};

/// Clips `text` to `columns` columns, with `…` at the end if clipped.
pub(super) fn clipped(text: &str, columns: usize) -> String {
    let span = Span::raw(text);
    if span.width() <= columns {
        return text.to_owned();
    }
    let mut kept = String::new();
    let mut used = 1;
    for grapheme in span.styled_graphemes(Style::new()) {
        used += Span::raw(grapheme.symbol).width();
        if used > columns {
            break;
        }
        kept.push_str(grapheme.symbol);
    }
    if columns > 0 {
        kept.push('…');
    }
    kept
}

/// Returns the width of `text`, columns.
pub(super) fn columns(text: &str) -> u16 {
    Span::raw(text).width().try_into().unwrap_or(u16::MAX)
}

/// Formats a duration in a readable unit: `18 ms`, `1.4 s`, `6 min`, `3 h`.
pub(super) fn duration_ms(ms: f64) -> String {
    match ms {
        _ if !ms.is_finite() => "? ms".to_owned(),
        _ if ms < 999.5 => format!("{ms:.0} ms"),
        _ if ms < 9_950.0 => format!("{:.1} s", ms / 1e3),
        _ if ms < 89_500.0 => format!("{:.0} s", ms / 1e3),
        _ if ms < 5_400_000.0 => format!("{:.0} min", ms / 60e3),
        _ => format!("{:.0} h", ms / 3600e3),
    }
}

/// Returns row `index` of `area`, or an empty area.
pub(super) fn row(area: Rect, index: u16) -> Rect {
    if index >= area.height {
        return Rect::new(area.x, area.bottom(), 0, 0);
    }
    Rect::new(area.x, area.y + index, area.width, 1)
}

/// Returns `area` without its first columns and rows.
pub(super) fn inset(area: Rect, left: u16, top: u16) -> Rect {
    let (left, top) = (left.min(area.width), top.min(area.height));
    let (width, height) = (area.width - left, area.height - top);
    Rect::new(area.x + left, area.y + top, width, height)
}

/// Returns `area` without one column at each side.
pub(super) fn trimmed(area: Rect) -> Rect {
    Rect {
        width: area.width.saturating_sub(2),
        ..inset(area, 1, 0)
    }
}

/// Returns `area` without its last columns.
pub(super) fn without_last(area: Rect, columns: u16) -> Rect {
    Rect {
        width: area.width.saturating_sub(columns),
        ..area
    }
}

/// Writes lines below each other, as many as fit.
pub(super) fn write_all(buffer: &mut Buffer, area: Rect, lines: &[Line<'_>]) {
    for (line, at) in lines.iter().zip(area.rows()) {
        write(buffer, at, line);
    }
}

/// Writes `line` into the first row of `area`, clipped.
pub(super) fn write(buffer: &mut Buffer, area: Rect, line: &Line<'_>) {
    if !area.is_empty() {
        buffer.set_line(area.x, area.y, line, area.width);
    }
}

/// Writes `line` right-aligned into the first row of `area` if it fits; returns its width.
pub(super) fn write_right(buffer: &mut Buffer, area: Rect, line: &Line<'_>) -> u16 {
    let width = line.width().try_into().unwrap_or(u16::MAX);
    if area.is_empty() || width > area.width {
        return 0;
    }
    buffer.set_line(area.right() - width, area.y, line, width);
    width
}

/// Clears `area` and sets its style.
pub(super) fn fill(buffer: &mut Buffer, area: Rect, style: Style) {
    for position in area.intersection(buffer.area).positions() {
        if let Some(cell) = buffer.cell_mut(position) {
            cell.reset();
            cell.set_style(style);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clipping_counts_columns_and_keeps_graphemes() {
        assert_eq!(clipped("mug-blue", 8), "mug-blue");
        assert_eq!(clipped("mug-blue", 5), "mug-…");
        assert_eq!(clipped("杯子蓝", 4), "杯…");
        assert_eq!(clipped("cafe\u{301}s", 5), "cafe\u{301}s");
        assert_eq!(clipped("cafe\u{301}ss", 5), "cafe\u{301}…");
        assert_eq!(clipped("abc", 1), "…");
        assert_eq!(clipped("abc", 0), "");
    }

    #[test]
    fn durations_use_a_readable_unit() {
        for (ms, text) in [
            (17.6, "18 ms"),
            (999.4, "999 ms"),
            (1_400.0, "1.4 s"),
            (12_000.0, "12 s"),
            (360_000.0, "6 min"),
            (7_200_000.0, "2 h"),
            (f64::NAN, "? ms"),
        ] {
            assert_eq!(duration_ms(ms), text);
        }
    }
}
