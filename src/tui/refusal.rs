//! Why a trigger was refused, and whether `!` helps.

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
            Span::styled(" take it anyway; the grasp records that you did", panel),
        ])
    } else {
        Line::styled(
            "this cannot be overridden: fix it, then trigger again",
            panel,
        )
    });
    Paragraph::new(lines)
        .style(panel)
        .wrap(Wrap { trim: false })
        .render(trimmed(area), buffer);
}
