//! Labels so far: bars, which label is short, and the present object.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Style;
use ratatui::text::{Line, Span};

use super::palette::Palette;
use super::text::{clipped, write_all};
use gripcast_dataset::Outcome;
use gripcast_session::{Counts, SessionView};

/// Difference between the labels from which a hint is given: a tenth of all, at least this.
const HINT_AT_LEAST: usize = 5;

/// Puts the counts of the object under its name.
const OBJECT_INDENT: &str = "       ";

/// Rows with everything in them.
pub(super) const ROWS: u16 = 5;

pub(super) fn draw(buffer: &mut Buffer, area: Rect, session: &SessionView, palette: Palette) {
    let counts = &session.counts;
    let width = usize::from(area.width);
    let object = if session.object.is_empty() {
        Span::styled("no object: press o", palette.warning())
    } else {
        let room = width.saturating_sub(OBJECT_INDENT.len());
        Span::styled(clipped(&session.object, room), palette.strong())
    };
    let object = Line::from(vec![Span::styled("object ", palette.faint()), object]);
    let most = counts.stable.max(counts.slip);
    let bar = |name, count, style| count_bar(name, count, most, width, style);
    let hint = balance(counts, width, palette);
    let lines = if area.height < ROWS {
        let all = both("", counts.stable, counts.slip, palette);
        vec![object, all, hint]
    } else {
        let this = both(
            OBJECT_INDENT,
            counts.object_stable,
            counts.object_slip,
            palette,
        );
        let stable = bar("stable", counts.stable, palette.stable());
        let slip = bar("slip", counts.slip, palette.slip());
        vec![object, this, stable, slip, hint]
    };
    write_all(buffer, area, &lines);
}

/// `88 stable  71 slip`.
fn both(heading: &'static str, stable: usize, slip: usize, palette: Palette) -> Line<'static> {
    Line::from(vec![
        Span::styled(heading, palette.faint()),
        Span::styled(format!("{stable} stable"), palette.stable()),
        Span::styled(format!("  {slip} slip"), palette.slip()),
    ])
}

fn count_bar(name: &str, count: usize, most: usize, width: usize, style: Style) -> Line<'static> {
    let text = format!("{name:<6} {count:>4} ");
    let room = width.saturating_sub(text.len());
    let length = (count * room).checked_div(most).unwrap_or(0);
    let length = length.max(usize::from(count > 0 && room > 0));
    Line::from(vec![
        Span::styled(text, style),
        Span::styled("█".repeat(length), style),
    ])
}

fn balance(counts: &Counts, width: usize, palette: Palette) -> Line<'static> {
    let total = counts.stable + counts.slip;
    let difference = counts.stable.abs_diff(counts.slip);
    let hint = if difference >= HINT_AT_LEAST.max(total / 10) {
        let wanted = match counts.stable > counts.slip {
            true => Outcome::Slip,
            false => Outcome::Stable,
        };
        Span::styled(format!("{difference} {wanted} short "), palette.warning())
    } else {
        Span::styled("balanced ", palette.faint())
    };
    let room = width.saturating_sub(hint.width());
    let open = match counts.unlabelled {
        0 => String::new(),
        n => Some(format!("· {n} unlabelled"))
            .filter(|long| long.chars().count() <= room)
            .unwrap_or_else(|| format!("· {n} open")),
    };
    Line::from(vec![hint, Span::styled(open, palette.faint())])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tui::palette::ColourDepth;

    const PALETTE: Palette = Palette {
        depth: ColourDepth::Mono,
    };

    fn hint(stable: usize, slip: usize) -> String {
        let counts = Counts {
            stable,
            slip,
            ..Counts::default()
        };
        balance(&counts, 30, PALETTE).to_string()
    }

    #[test]
    fn the_hint_names_the_label_that_is_short() {
        assert_eq!(hint(88, 71), "17 slip short ");
        assert_eq!(hint(10, 30), "20 stable short ");
        assert_eq!(hint(4, 0), "balanced ");
        assert_eq!(hint(88, 80), "balanced ");
        assert_eq!(hint(0, 0), "balanced ");
    }

    #[test]
    fn bars_are_in_proportion_and_never_vanish() {
        let length = |count, most| {
            count_bar("slip", count, most, 32, Style::new())
                .to_string()
                .matches('█')
                .count()
        };
        assert_eq!(length(100, 100), 20);
        assert_eq!(length(50, 100), 10);
        assert_eq!(length(1, 1000), 1);
        assert_eq!(length(0, 0), 0);
    }
}
