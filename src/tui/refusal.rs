//! Reasons of a refused trigger, and whether it can be overridden.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Paragraph, Widget, Wrap};

use super::palette::Palette;
use super::text::{fill, trimmed};
use gripcast_session::Refusal;

pub(super) fn draw(buffer: &mut Buffer, area: Rect, refusal: &Refusal, palette: Palette) {
    let panel = palette.panel();
    fill(buffer, area, panel);
    let mut lines = vec![Line::styled(
        format!(" {} NOT TAKEN ", refusal.stage.to_uppercase()),
        palette.refusal(),
    )];
    lines.extend(refusal.reasons.iter().map(|reason| {
        Line::from(vec![
            Span::styled("✗ ", panel.patch(palette.warning())),
            Span::styled(reason.as_str(), panel),
        ])
    }));
    lines.push(Line::default());
    lines.push(if refusal.can_override {
        Line::from(vec![
            Span::styled("!", panel.patch(palette.key())),
            Span::styled(" override (recorded with the grasp)", panel),
        ])
    } else {
        Line::styled("cannot be overridden: fix this and trigger again", panel)
    });
    Paragraph::new(lines)
        .style(panel)
        .wrap(Wrap { trim: false })
        .render(trimmed(area), buffer);
}
