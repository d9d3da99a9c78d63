//! The last three lines: newest grasp with undo, message, current keys.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Style;
use ratatui::text::{Line, Span};

use super::palette::Palette;
use super::text::{clipped, write_all};
use crate::daemon::verdict_of;
use gripcast_dataset::Outcome;
use gripcast_nn::predict::PredictedLabel;
use gripcast_session::{LastGrasp, MessageLevel, SessionView, Step};

/// Draws newest grasp, message and keys; low screens omit the upper lines.
pub(super) fn draw(
    buffer: &mut Buffer,
    area: Rect,
    session: &SessionView,
    notice: Option<&str>,
    palette: Palette,
) {
    let lines = [
        last(session, area.width, palette),
        message(session, notice, area.width, palette),
        keys(session, area.width, palette),
    ];
    let skipped = lines.len().saturating_sub(usize::from(area.height));
    write_all(buffer, area, &lines[skipped..]);
}

/// Returns the line of the newest grasp: label, prediction, undo and redo.
fn last(session: &SessionView, width: u16, palette: Palette) -> Line<'static> {
    let Some(last) = &session.last else {
        return Line::styled(" no grasp yet", palette.faint());
    };
    let mut spans = vec![
        Span::styled(" last ", palette.faint()),
        Span::raw(format!("{} {}", last.id.short(), clipped(&last.object, 20))),
        Span::raw(" → "),
        outcome(last.outcome, palette),
    ];
    spans.extend(predicted(last, palette));
    if let Some(undo) = &session.undo {
        spans.push(Span::styled("   u", palette.key()));
        spans.push(Span::styled(" undo ", palette.faint()));
        let used = Line::from(spans.clone()).width();
        let room = usize::from(width).saturating_sub(used);
        spans.push(Span::raw(clipped(undo, room)));
    }
    if let Some(redo) = &session.redo {
        spans.push(Span::styled("   r", palette.key()));
        spans.push(Span::styled(" redo ", palette.faint()));
        spans.push(Span::raw(clipped(redo, 24)));
    }
    Line::from(spans)
}

fn outcome(outcome: Outcome, palette: Palette) -> Span<'static> {
    match outcome {
        Outcome::Stable => Span::styled("STABLE", palette.stable()),
        Outcome::Slip => Span::styled("SLIP", palette.slip()),
        Outcome::Unlabelled => Span::styled("not labelled", palette.warning()),
    }
}

/// Formats `predicted 0.74 ✓`: a tick if the label agrees, a cross if not, a question mark for
/// out-of-distribution images.
fn predicted(last: &LastGrasp, palette: Palette) -> Vec<Span<'static>> {
    let Some(prediction) = &last.predicted else {
        return Vec::new();
    };
    let p = prediction.shown_p_stable();
    let (mark, style) = match (verdict_of(prediction), last.outcome) {
        (PredictedLabel::Unsure, _) => (" ?", palette.warning()),
        (_, Outcome::Unlabelled) => ("", Style::new()),
        (PredictedLabel::Stable, Outcome::Stable) | (PredictedLabel::Slip, Outcome::Slip) => {
            (" ✓", palette.stable())
        }
        _ => (" ✗", palette.warning()),
    };
    vec![
        Span::styled(format!("  predicted {p:.2}"), palette.faint()),
        Span::styled(mark, style),
    ]
}

fn message(
    session: &SessionView,
    notice: Option<&str>,
    width: u16,
    palette: Palette,
) -> Line<'static> {
    let fitted = |text: String| clipped(&text, usize::from(width));
    if let Some(notice) = notice {
        return Line::styled(fitted(format!(" {notice}")), palette.warning());
    }
    let Some(message) = &session.message else {
        return Line::default();
    };
    let (mark, style) = match message.level {
        MessageLevel::Info => ("", Style::new()),
        MessageLevel::Warning => ("warning: ", palette.warning()),
        MessageLevel::Error => ("ERROR: ", palette.slip()),
    };
    Line::styled(fitted(format!(" {mark}{}", message.text)), style)
}

/// Returns the current keys, most important first, as many as fit.
fn keys(session: &SessionView, width: u16, palette: Palette) -> Line<'static> {
    let now: &[(&str, &str)] = match (&session.refusal, session.step) {
        (Some(refusal), _) if refusal.can_override => &[
            ("!", "override"),
            ("space/pedal", "again"),
            ("i", "initial"),
        ],
        (_, Step::Initial) => &[("space/pedal", "initial"), ("o", "object")],
        (_, Step::Grasp) => &[("space/pedal", "grasp"), ("i", "initial again")],
        (_, Step::Label) => &[("s", "STABLE"), ("f", "SLIP")],
    };
    let always: &[(&str, &str)] = &[
        ("?", "help"),
        ("q", "quit"),
        ("u", "undo"),
        ("h", "sensors"),
        ("o", "object"),
        ("n", "scene"),
        ("p", "operator"),
    ];
    let rest = always.iter().filter(|key| !now.contains(key));
    let mut spans = Vec::new();
    let mut used = 1;
    for (key, meaning) in now.iter().chain(rest) {
        let columns = key.len() + meaning.len() + 3;
        if used + columns > usize::from(width) {
            break;
        }
        used += columns;
        spans.push(Span::styled(format!(" {key}"), palette.key()));
        spans.push(Span::raw(format!(" {meaning} ")));
    }
    Line::from(spans)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tui::palette::ColourDepth;
    use gripcast_dataset::{GraspId, PredictionRecord};

    #[test]
    fn agreement_of_label_and_prediction_is_marked() {
        let palette = Palette {
            depth: ColourDepth::Mono,
        };
        let marked_of = |outcome, p, ood_score| {
            let last = LastGrasp {
                id: GraspId::parse("2026-11-20T10-15-03Z-7f3a").unwrap(),
                object: "mug".parse().unwrap(),
                outcome,
                predicted: Some(PredictionRecord {
                    p_stable: p,
                    threshold: 0.5,
                    inputs: None,
                    geometry: None,
                    ood_score,
                    unsure_reason: None,
                    adapted: None,
                    set: None,
                    model: "m".to_owned(),
                    model_sha256: String::new(),
                    latency_ms: 12.0,
                    engine_ms: 3.0,
                }),
            };
            Line::from(predicted(&last, palette)).to_string()
        };
        let marked = |outcome, p| marked_of(outcome, p, Some(0.9));
        assert_eq!(marked(Outcome::Stable, 0.74), "  predicted 0.74 ✓");
        assert_eq!(marked(Outcome::Slip, 0.74), "  predicted 0.74 ✗");
        assert_eq!(marked(Outcome::Slip, 0.1), "  predicted 0.10 ✓");
        assert_eq!(marked(Outcome::Unlabelled, 0.1), "  predicted 0.10");
        let unknown = marked_of(Outcome::Stable, 0.74, Some(1.1));
        assert_eq!(unknown, "  predicted 0.74 ?");
    }
}
