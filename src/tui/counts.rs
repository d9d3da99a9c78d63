//! Label counts: bars, balance hint and current object.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Style;
use ratatui::text::{Line, Span};

use super::palette::Palette;
use super::text::{clipped, write_all};
use crate::daemon::EngineStatus;
use gripcast_dataset::Outcome;
use gripcast_session::{Counts, SessionView};

/// Minimum difference of the label counts for a hint; otherwise a tenth of all labels.
const MIN_IMBALANCE: usize = 5;

/// Indentation of the object's counts.
const OBJECT_INDENT: &str = "       ";

/// Rows needed for all lines.
pub(super) const ROWS: u16 = 5;

pub(super) fn draw(buffer: &mut Buffer, area: Rect, status: &EngineStatus, palette: Palette) {
    let counts = &status.session.counts;
    let width = usize::from(area.width);
    let object = object(status, width, palette);
    let max = counts.stable.max(counts.slip);
    let bar = |name, count, style| count_bar(name, count, max, width, style);
    let hint = balance(counts, width, palette);
    let lines = if area.height < ROWS {
        let all = label_counts("", counts.stable, counts.slip, palette);
        vec![object, all, hint]
    } else {
        let this = label_counts(
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

/// Name of the object, and its labelled grasps of the wanted ones: `object mug-blue 6 of 20`.
fn object(status: &EngineStatus, width: usize, palette: Palette) -> Line<'static> {
    let SessionView { object, counts, .. } = &status.session;
    let heading = Span::styled("object ", palette.faint());
    if object.is_empty() {
        let words = Span::styled("no object: press o", palette.warning());
        return Line::from(vec![heading, words]);
    }
    let labelled = counts.object_stable.saturating_add(counts.object_slip);
    let target = match status.target_per_object as usize {
        0 => Span::raw(""),
        target if labelled < target => {
            Span::styled(format!(" {labelled} of {target}"), palette.faint())
        }
        target => Span::styled(format!(" {labelled} of {target} ✓"), palette.stable()),
    };
    let room = width.saturating_sub(OBJECT_INDENT.len() + target.width());
    let name = Span::styled(clipped(object, room), palette.strong());
    Line::from(vec![heading, name, target])
}

/// `88 stable  71 slip`.
fn label_counts(
    heading: &'static str,
    stable: usize,
    slip: usize,
    palette: Palette,
) -> Line<'static> {
    Line::from(vec![
        Span::styled(heading, palette.faint()),
        Span::styled(format!("{stable} stable"), palette.stable()),
        Span::styled(format!("  {slip} slip"), palette.slip()),
    ])
}

fn count_bar(name: &str, count: usize, max: usize, width: usize, style: Style) -> Line<'static> {
    let text = format!("{name:<6} {count:>4} ");
    let room = width.saturating_sub(text.len());
    let length = (count * room).checked_div(max).unwrap_or(0);
    let length = length.max(usize::from(count > 0 && room > 0));
    Line::from(vec![
        Span::styled(text, style),
        Span::styled("█".repeat(length), style),
    ])
}

fn balance(counts: &Counts, width: usize, palette: Palette) -> Line<'static> {
    let total = counts.stable + counts.slip;
    let difference = counts.stable.abs_diff(counts.slip);
    let hint = if difference >= MIN_IMBALANCE.max(total / 10) {
        let wanted = match counts.stable > counts.slip {
            true => Outcome::Slip,
            false => Outcome::Stable,
        };
        Span::styled(format!("need {difference} {wanted} "), palette.warning())
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
    fn hint_names_the_missing_label() {
        assert_eq!(hint(88, 71), "need 17 slip ");
        assert_eq!(hint(10, 30), "need 20 stable ");
        assert_eq!(hint(4, 0), "balanced ");
        assert_eq!(hint(88, 80), "balanced ");
        assert_eq!(hint(0, 0), "balanced ");
    }

    #[test]
    fn target_of_the_object_is_shown() {
        let mut status = EngineStatus::starting("d", "r", gripcast_session::Labels::default());
        status.session.object = "a-very-long-object-name".parse().unwrap();
        status.session.counts.object_stable = 4;
        status.session.counts.object_slip = 2;
        let shown = |target_per_object| {
            let status = EngineStatus {
                target_per_object,
                ..status.clone()
            };
            object(&status, 24, PALETTE).to_string()
        };
        assert_eq!(shown(0), "object a-very-long-obje…");
        assert_eq!(shown(20), "object a-very-l… 6 of 20");
        assert_eq!(shown(6), "object a-very-… 6 of 6 ✓");
    }

    #[test]
    fn bars_are_proportional_and_never_empty() {
        let length = |count, max| {
            count_bar("slip", count, max, 32, Style::new())
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
