//! Reasons of a refused trigger, the first one large, and the keys that go on.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Paragraph, Widget, Wrap};

use super::big_digits::{self, Size};
use super::palette::Palette;
use super::text::{fill, inset, row, trimmed, write};
use gripcast_session::Refusal;

/// Rows of the sentences and keys below the heading.
const TEXT_ROWS: u16 = 4;

pub(super) fn draw(buffer: &mut Buffer, area: Rect, refusal: &Refusal, palette: Palette) {
    let panel = palette.panel();
    fill(buffer, area, panel);
    let area = trimmed(area);
    let mut reasons = refusal.reasons.iter();
    let first = reasons.next().map_or("", String::as_str);
    let used = draw_heading(buffer, area, heading(first), palette);
    let warning = panel.patch(palette.warning());
    let mut lines = vec![Line::styled(format!("✗ {first}"), warning)];
    lines.extend(reasons.map(|reason| Line::styled(format!("✗ {reason}"), panel)));
    // The keys stay visible however many reasons there are.
    let mut sentences = inset(area, 0, used);
    sentences.height = sentences.height.saturating_sub(1);
    Paragraph::new(lines)
        .style(panel)
        .wrap(Wrap { trim: false })
        .render(sentences, buffer);
    let last = row(area, area.height.saturating_sub(1));
    write(buffer, last, &keys(refusal, palette));
}

/// Returns the subject of a reason: `no contact` of `no contact: at most …`.
fn heading(reason: &str) -> &str {
    let ends = [":", " is ", ",", " ("].map(|end| reason.find(end));
    let end = ends.into_iter().flatten().min().unwrap_or(reason.len());
    reason.get(..end).unwrap_or_default().trim()
}

/// Draws a heading in the largest letters that fit; returns the rows used.
fn draw_heading(buffer: &mut Buffer, area: Rect, heading: &str, palette: Palette) -> u16 {
    let room = area.height.saturating_sub(TEXT_ROWS + 1);
    let is_drawable = |c: char| c.is_ascii_alphanumeric() || " .-".contains(c);
    let size = Size::DESCENDING
        .into_iter()
        .filter(|_| !heading.is_empty() && heading.chars().all(is_drawable))
        .find(|size| size.rows() <= room && size.columns(heading) <= area.width);
    let Some(size) = size else { return 0 };
    let style = palette.panel().patch(palette.warning());
    big_digits::draw(buffer, area, heading, size, style);
    size.rows() + 1
}

/// Returns the keys, in the words of the footer.
fn keys(refusal: &Refusal, palette: Palette) -> Line<'static> {
    let panel = palette.panel();
    let key = |name: &'static str| Span::styled(name, panel.patch(palette.key()));
    let words = |text: &'static str| Span::styled(text, panel);
    match refusal.can_override {
        true => Line::from(vec![
            key("space/pedal"),
            words(" again   "),
            key("!"),
            words(" override (recorded with the grasp)"),
        ]),
        false => Line::from(vec![key("space/pedal"), words(" again; no override")]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tui::palette::ColourDepth;

    fn drawn(width: u16, height: u16, reasons: &[&str], can_override: bool) -> String {
        let area = Rect::new(0, 0, width, height);
        let mut buffer = Buffer::empty(area);
        let refusal = Refusal {
            stage: "grasp".into(),
            reasons: reasons.iter().map(|reason| (*reason).to_owned()).collect(),
            can_override,
        };
        let palette = Palette {
            depth: ColourDepth::Mono,
        };
        draw(&mut buffer, area, &refusal, palette);
        let rows = buffer.content.chunks(usize::from(width));
        rows.map(|row| row.iter().map(|cell| cell.symbol()).collect::<String>() + "\n")
            .collect()
    }

    #[test]
    fn subject_of_the_first_reason_is_large() {
        let reasons = [
            "no contact: at most 0.1 % of a gel changed",
            "skew is 80 ms",
        ];
        let shown = drawn(80, 9, &reasons, true);
        assert!(shown.contains('█'), "{shown}");
        let [first, second] = reasons.map(|reason| shown.find(reason).unwrap());
        assert!(first < second, "{shown}");
        assert!(shown.contains("! override"), "{shown}");
        let low = drawn(40, 5, &reasons, false);
        assert!(!low.contains('█'), "{low}");
        assert!(low.starts_with(" ✗ no contact: at most"), "{low}");
        assert!(low.contains("no override"), "{low}");
    }

    #[test]
    fn heading_is_the_subject() {
        for (reason, expected) in [
            ("left: no frames arrive", "left"),
            (
                "skew of the frames is 140 ms, limit 40 ms",
                "skew of the frames",
            ),
            ("640 MB free, limit 1000 MB", "640 MB free"),
            ("", ""),
        ] {
            assert_eq!(heading(reason), expected);
        }
    }
}
