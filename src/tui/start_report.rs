//! Warnings of the start report, one line each, until they are dismissed.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};

use super::palette::Palette;
use super::text::{clipped, fill, inset, row, write};
use crate::daemon::{EngineStatus, StartFinding};
use gripcast_session::MessageLevel;

/// Maximum number of lines.
const MAX_ROWS: u16 = 3;

/// Returns the warnings that were not dismissed; a changed text is a new warning.
pub(super) fn open_warnings<'a>(
    status: &'a EngineStatus,
    dismissed: &'a [StartFinding],
) -> impl Iterator<Item = &'a StartFinding> {
    let findings = status.start_report.iter();
    findings.filter(|finding| finding.level != MessageLevel::Info && !dismissed.contains(*finding))
}

/// Returns the number of lines for a screen of `height` rows.
pub(super) fn rows(warnings: usize, height: u16) -> u16 {
    let room = if height >= 16 { MAX_ROWS } else { 1 };
    u16::try_from(warnings).unwrap_or(u16::MAX).min(room)
}

/// Draws the first warnings; the last line counts those without a line.
pub(super) fn draw(buffer: &mut Buffer, area: Rect, warnings: &[&StartFinding], palette: Palette) {
    let style = palette.warning();
    for (index, warning) in (0..area.height).zip(warnings) {
        let line = row(area, index);
        fill(buffer, line, style);
        let rest = warnings.len() - usize::from(index) - 1;
        let hint = match index + 1 == area.height {
            true if rest > 0 => format!(" (+{rest}; Esc closes)"),
            true => " (Esc closes)".to_owned(),
            false => String::new(),
        };
        let room = usize::from(area.width).saturating_sub(3 + hint.chars().count());
        let text = clipped(&warning.text, room);
        let warning_line = Line::from(vec![
            Span::styled(format!("⚠ {text}"), style),
            Span::styled(hint, palette.faint()),
        ]);
        write(buffer, inset(line, 1, 0), &warning_line);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::daemon::StartSubject;
    use crate::tui::{ColourDepth, Palette, ScreenState};
    use crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
    use gripcast_session::Labels;

    fn warning(subject: StartSubject, text: &str) -> StartFinding {
        StartFinding {
            subject,
            level: MessageLevel::Warning,
            text: text.to_owned(),
        }
    }

    #[test]
    fn warnings_are_listed_until_escape_and_come_back_changed() {
        let mut status = EngineStatus::starting("d", "r", Labels::default());
        status.start_report = vec![
            warning(StartSubject::Clock, "the clock is wrong"),
            warning(StartSubject::Object, "no object"),
            StartFinding {
                level: MessageLevel::Info,
                ..warning(StartSubject::FreeSpace, "9 fit")
            },
        ];
        let mut state = ScreenState::new(Palette {
            depth: ColourDepth::True,
        });
        let open = |state: &ScreenState, status: &EngineStatus| {
            open_warnings(status, &state.dismissed_warnings).count()
        };
        assert_eq!(open(&state, &status), 2);
        let escape = KeyEvent::new(KeyCode::Esc, KeyModifiers::NONE);
        state.press(&escape, &status);
        assert_eq!(open(&state, &status), 0);
        status.start_report[0].text = "the clock jumped".to_owned();
        assert_eq!(open(&state, &status), 1);
    }

    #[test]
    fn few_rows_are_used() {
        assert_eq!((rows(0, 40), rows(2, 40), rows(9, 40)), (0, 2, 3));
        assert_eq!(rows(2, 12), 1);
    }
}
