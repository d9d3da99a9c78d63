//! The stability gauge: probability, verdict and bar, readable from two metres.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Style;
use ratatui::text::{Line, Span};

use super::big_digits::{self, Size};
use super::palette::Palette;
use super::text::{
    clipped, columns, duration_ms, inset, row, trimmed, without_last, write, write_right,
};
use crate::daemon::{EngineStatus, LiftStatus, PredictionStatus, unsure_words, verdict_of};
use gripcast_dataset::{AdaptedPrediction, GraspId, Outcome, PredictionRecord};
use gripcast_nn::predict::PredictedLabel;
use gripcast_session::{LastGrasp, SessionView, Step};

/// Frame age above which a prediction is shown as old, ms.
const STALE_MS: f64 = 500.0;
/// Start of the adaptation's words where there is room.
const ADAPTED_TO: &str = "adapted to ";
/// Width from which there is, columns.
const WIDE: u16 = 100;
/// Minimum columns between probability and verdict.
const GAP: u16 = 4;

/// Displayed texts and style of the gauge.
struct Reading<'a> {
    /// Prediction and probability; `None` without a finite probability.
    prediction: Option<&'a PredictionRecord>,
    number: String,
    /// Verdict, empty without a prediction.
    verdict: &'static str,
    /// Reason for the missing prediction.
    no_prediction: String,
    style: Style,
    /// Adaptation to the rig's labels, in words; empty without.
    adaptation: String,
    /// What was predicted.
    of: Predicted<'a>,
}

/// What a prediction is about.
#[derive(Clone, Copy)]
enum Predicted<'a> {
    /// The newest images.
    Live(Option<&'a PredictionStatus>),
    /// The grasp that waits for its label, and the verdict in its lift.
    Grasp(&'a GraspId, Option<&'a LiftStatus>),
}

impl Reading<'_> {
    /// Probability and threshold of the bar.
    fn bar(&self) -> Option<(f64, f64)> {
        self.prediction
            .map(|record| (record.shown_p_stable(), record.threshold))
    }
}

/// Returns the displayed name of a verdict.
pub(super) fn word(verdict: PredictedLabel) -> &'static str {
    match verdict {
        PredictedLabel::Stable => "STABLE",
        PredictedLabel::Slip => "SLIP",
        PredictedLabel::Unsure => "UNSURE",
    }
}

fn is_stale(prediction: &PredictionStatus) -> bool {
    prediction.frame_age_ms > STALE_MS || prediction.frame_age_ms.is_nan()
}

fn verdict_style(verdict: &str, palette: Palette) -> Style {
    match verdict {
        "STABLE" => palette.stable(),
        "SLIP" => palette.slip(),
        "UNSURE" => palette.warning(),
        _ => palette.faint(),
    }
}

fn lift_style(lift: &LiftStatus, palette: Palette) -> Style {
    match (lift.is_slipping, lift.is_stable) {
        (true, _) => palette.slip(),
        (false, true) => palette.stable(),
        (false, false) => palette.warning(),
    }
}

/// Returns the grasp that waits for its label. Until then its own prediction is shown, not the live
/// one: the gripper is about to open.
fn grasp_to_label(session: &SessionView) -> Option<&LastGrasp> {
    let last = session
        .last
        .as_ref()
        .filter(|_| session.step == Step::Label)?;
    (last.outcome == Outcome::Unlabelled).then_some(last)
}

/// Returns the displayed prediction: that of the grasp that waits for its label, else the live one.
fn reading(status: &EngineStatus, palette: Palette) -> Reading<'_> {
    let live = status.prediction.as_ref();
    let (of, record, verdict, no_prediction) = match grasp_to_label(&status.session) {
        Some(grasp) => (
            Predicted::Grasp(&grasp.id, status.lift.as_ref()),
            grasp.predicted.as_ref(),
            grasp
                .predicted
                .as_ref()
                .map_or("", |record| word(verdict_of(record))),
            format!("none was saved with grasp {}", grasp.id.short()),
        ),
        None => (
            Predicted::Live(live),
            live.map(|live| &live.record),
            live.map_or("", |live| match is_stale(live) {
                true => "OLD",
                false => word(live.verdict),
            }),
            status
                .no_prediction_reason
                .clone()
                .unwrap_or_else(|| "waiting for the first prediction".to_owned()),
        ),
    };
    let prediction = record.filter(|record| record.p_stable.is_finite());
    let verdict = prediction.map_or("", |_| verdict);
    Reading {
        number: prediction.map_or_else(
            || "-.--".to_owned(),
            |record| format!("{:.2}", record.shown_p_stable().clamp(0.0, 1.0)),
        ),
        adaptation: adaptation_words(status, prediction),
        prediction,
        verdict,
        no_prediction,
        style: verdict_style(verdict, palette),
        of,
    }
}

/// Returns `7 labels: base rate 0.62, model 0.48`: base rate and the model's own probability; empty
/// without adaptation.
fn adaptation_words(status: &EngineStatus, prediction: Option<&PredictionRecord>) -> String {
    let adapted = prediction.and_then(|record| Some((record.adapted?, record.p_stable)));
    match (adapted, &status.adaptation) {
        (Some((adapted, p_stable)), _) => {
            let AdaptedPrediction {
                labels, base_rate, ..
            } = adapted;
            let label = if labels == 1 { "label" } else { "labels" };
            format!("{labels} {label}: base rate {base_rate:.2}, model {p_stable:.2}")
        }
        (None, Some(adaptation)) => adaptation.words().replacen(ADAPTED_TO, "", 1),
        (None, None) => String::new(),
    }
}

/// Returns `0.81 STABLE `, or nothing without a prediction.
pub(super) fn brief(status: &EngineStatus, palette: Palette) -> Option<Span<'static>> {
    let reading = reading(status, palette);
    reading.prediction?;
    let text = format!("{} {} ", reading.number, reading.verdict);
    Some(Span::styled(text, reading.style))
}

/// Returns the rows to use of `available`: title, number, bar, scale, and a thicker bar under large
/// numbers.
pub(super) fn rows(width: u16, available: u16) -> u16 {
    match size(width, available.saturating_sub(3)) {
        Some(Size::Large) => (Size::Large.rows() + 4).min(available),
        Some(size) => size.rows() + 3,
        None => available.min(3),
    }
}

/// Returns the largest font size that fits.
fn size(width: u16, height: u16) -> Option<Size> {
    Size::DESCENDING.into_iter().find(|size| {
        let word_size = match size {
            Size::Large => Size::Large,
            Size::Medium | Size::Small => Size::Small,
        };
        let words = word_size.columns(word(PredictedLabel::Unsure));
        size.rows() <= height && size.columns("0.00") + GAP + words + 2 <= width
    })
}

pub(super) fn draw(buffer: &mut Buffer, area: Rect, status: &EngineStatus, palette: Palette) {
    if area.is_empty() {
        return;
    }
    let reading = reading(status, palette);
    write_title(buffer, row(area, 0), &reading, palette);
    let body = inset(area, 0, 1);
    let used = match size(area.width, body.height.saturating_sub(1)) {
        Some(size) => draw_big(buffer, body, &reading, size, palette),
        None => draw_line(buffer, body, &reading, palette),
    };
    let below = inset(body, 0, used);
    let thick = u16::from(below.height >= 3);
    draw_bar(buffer, row(below, 0), ["▄", "▖"], &reading, palette);
    if thick == 1 {
        draw_bar(buffer, row(below, 1), ["█", "▌"], &reading, palette);
    }
    draw_scale(buffer, row(below, 1 + thick), &reading, palette);
}

/// Draws probability and verdict in large letters; returns the rows used.
fn draw_big(
    buffer: &mut Buffer,
    area: Rect,
    reading: &Reading<'_>,
    size: Size,
    palette: Palette,
) -> u16 {
    let (at, style) = (inset(area, 1, 0), reading.style);
    big_digits::draw(buffer, at, &reading.number, size, style);
    let x = 1 + size.columns("0.00") + GAP;
    if reading.verdict.is_empty() {
        let reason = inset(area, x, size.rows() / 2);
        write_no_prediction(buffer, reason, reading, palette);
        return size.rows();
    }
    let room = area.width.saturating_sub(x + 1);
    let word = Size::DESCENDING
        .into_iter()
        .find(|s| s.rows() <= size.rows() && s.columns(reading.verdict) <= room)
        .unwrap_or(Size::Small);
    let x = x + room.saturating_sub(word.columns(reading.verdict));
    let at = inset(area, x, (size.rows() - word.rows()) / 2);
    big_digits::draw(buffer, at, reading.verdict, word, style);
    size.rows()
}

/// Draws probability and verdict as one line of text; returns the rows used.
fn draw_line(buffer: &mut Buffer, area: Rect, reading: &Reading<'_>, palette: Palette) -> u16 {
    let text = format!(" {}  {}  ", reading.number, reading.verdict);
    let after = columns(&text).min(area.width);
    write(buffer, area, &Line::styled(text, reading.style));
    if reading.verdict.is_empty() {
        write_no_prediction(buffer, inset(area, after, 0), reading, palette);
    }
    1
}

fn write_no_prediction(buffer: &mut Buffer, area: Rect, reading: &Reading<'_>, palette: Palette) {
    let mut rest = reading.no_prediction.as_str();
    for index in 0..area.height.min(2) {
        let (now, later) = wrap_line(rest, usize::from(area.width));
        let now = match index {
            0 => format!("no prediction: {now}"),
            _ => now.to_owned(),
        };
        let now = Line::styled(now, palette.faint());
        write(buffer, row(area, index), &now);
        rest = later;
    }
}

/// Splits `text` at the last space that fits into the first line.
fn wrap_line(text: &str, columns_wide: usize) -> (&str, &str) {
    let room = columns_wide.saturating_sub("no prediction: ".len());
    if usize::from(columns(text)) <= room {
        return (text, "");
    }
    let cut = text
        .char_indices()
        .take(room)
        .filter(|(_, c)| *c == ' ')
        .last();
    match cut {
        Some((index, _)) => text.split_at(index + 1),
        None => (text, ""),
    }
}

fn write_title(buffer: &mut Buffer, area: Rect, reading: &Reading<'_>, palette: Palette) {
    let mut left = vec![Span::styled(" STABILITY ", palette.strong())];
    let adaptation = match reading.adaptation.as_str() {
        "" => String::new(),
        words if area.width >= WIDE || reading.prediction.is_none() => {
            format!("{ADAPTED_TO}{words} ")
        }
        words => format!("{words} "),
    };
    let adaptation = Span::styled(adaptation, palette.faint());
    let Some(record) = reading.prediction else {
        left.push(adaptation);
        write(buffer, area, &Line::from(left));
        return;
    };
    let name = clipped(&record.model, 28);
    let is_heuristic = matches!(reading.of, Predicted::Live(Some(live)) if live.heuristic);
    let heuristic = u16::from(is_heuristic) * columns(" HEURISTIC ");
    let is_unsure = reading.verdict == word(PredictedLabel::Unsure);
    let reason = match is_unsure {
        true => format!("{} ", unsure_words(record)),
        false => String::new(),
    };
    let needed = [" STABILITY ", &name, &adaptation.content, &reason]
        .map(columns)
        .iter()
        .sum::<u16>()
        + heuristic
        + 2;
    let mut details = details(reading, record, palette);
    let long = details.remove(0);
    let taken = match area.width.checked_sub(needed) {
        Some(room) if long.width() <= usize::from(room) => write_right(buffer, area, &long),
        _ => write_right(buffer, area, details.first().unwrap_or(&long)),
    };
    let rest = without_last(area, taken + 1);
    if is_heuristic {
        left.push(Span::styled("HEURISTIC ", palette.warning()));
    }
    if is_unsure {
        left.push(Span::styled(reason, palette.warning()));
    }
    if !reading.adaptation.is_empty() {
        left.push(adaptation);
    }
    let room = usize::from(rest.width).saturating_sub(Line::from(left.clone()).width());
    left.push(Span::styled(clipped(&name, room), palette.faint()));
    write(buffer, rest, &Line::from(left));
}

/// Returns what was predicted when, long and short.
fn details(
    reading: &Reading<'_>,
    record: &PredictionRecord,
    palette: Palette,
) -> Vec<Line<'static>> {
    let prediction = match reading.of {
        Predicted::Grasp(id, lift) => {
            let id = id.short();
            let with_lift = |words: String, lead: &str| {
                let mut line = Line::styled(words, palette.strong());
                if let Some(lift) = lift {
                    let words = format!("{lead}{:.2} {} ", lift.p_stable, lift.word());
                    line.push_span(Span::styled(words, lift_style(lift, palette)));
                }
                line
            };
            return vec![
                with_lift(format!("grasp {id}, before the lift "), "· in the lift "),
                with_lift(format!("grasp {id} "), "lift "),
            ];
        }
        Predicted::Live(prediction) => prediction,
    };
    let Some(prediction) = prediction else {
        return vec![Line::default()];
    };
    let age = format!("frame {} old", duration_ms(prediction.frame_age_ms));
    let age_style = palette.warning_if(is_stale(prediction), palette.faint());
    let latency = duration_ms(record.latency_ms);
    let timings = [
        format!(" · result in {latency} · model {:.1} ms ", record.engine_ms),
        format!(" · {latency} "),
    ];
    let line = |words| {
        Line::from(vec![
            Span::styled(age.clone(), age_style),
            Span::styled(words, palette.faint()),
        ])
    };
    timings.into_iter().map(line).collect()
}

/// Draws a bar from 0 to 1 with a `whole` and a `half` symbol and a mark at the threshold.
fn draw_bar(
    buffer: &mut Buffer,
    area: Rect,
    [whole, half]: [&'static str; 2],
    reading: &Reading<'_>,
    palette: Palette,
) {
    let area = trimmed(area);
    let (p, threshold) = reading.bar().unwrap_or((0.0, f64::NAN));
    let halves = (p.clamp(0.0, 1.0) * f64::from(area.width) * 2.0).round() as u32;
    let mark = mark_column(area, threshold);
    for x in 0..area.width {
        let (symbol, style) = match halves.saturating_sub(u32::from(x) * 2) {
            _ if mark == Some(x) => ("┃", palette.strong()),
            0 => (palette.empty(whole), palette.trough()),
            1 => (half, reading.style),
            _ => (whole, reading.style),
        };
        if let Some(cell) = buffer.cell_mut((area.x + x, area.y)) {
            cell.set_symbol(symbol).set_style(style);
        }
    }
}

fn mark_column(area: Rect, threshold: f64) -> Option<u16> {
    let last = area.width.checked_sub(1)?;
    ((0.0..=1.0).contains(&threshold)).then(|| (threshold * f64::from(last)).round() as u16)
}

/// Draws `◄ slip   ▲ 0.50   stable ►` under the bar.
fn draw_scale(buffer: &mut Buffer, area: Rect, reading: &Reading<'_>, palette: Palette) {
    let area = trimmed(area);
    write(buffer, area, &Line::styled("◄ slip", palette.faint()));
    write_right(buffer, area, &Line::styled("stable ►", palette.faint()));
    let Some((_, threshold)) = reading.bar() else {
        return;
    };
    if let Some(mark) = mark_column(area, threshold) {
        let label = format!("▲ {threshold:.2}");
        let room = area.width.saturating_sub(mark);
        if mark > 6 && columns(&label) + 9 <= room {
            let label = Line::styled(label, palette.strong());
            write(buffer, inset(area, mark, 0), &label);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tui::palette::ColourDepth;
    use gripcast_session::Labels;

    const PALETTE: Palette = Palette {
        depth: ColourDepth::True,
    };

    fn prediction_on(p_stable: f64, ood_score: Option<f64>, frame_age_ms: f64) -> PredictionStatus {
        let record = PredictionRecord {
            p_stable,
            ood_score,
            unsure_reason: None,
            adapted: None,
            set: None,
            threshold: 0.5,
            inputs: None,
            geometry: None,
            model: "m".to_owned(),
            model_sha256: String::new(),
            latency_ms: 12.0,
            engine_ms: 3.0,
        };
        PredictionStatus {
            frame_age_ms,
            ..PredictionStatus::new(record, false)
        }
    }

    fn live(prediction: Option<PredictionStatus>) -> EngineStatus {
        EngineStatus {
            prediction,
            ..EngineStatus::starting("d", "r", Labels::default())
        }
    }

    fn predicted(p_stable: f64, frame_age_ms: f64) -> EngineStatus {
        live(Some(prediction_on(p_stable, None, frame_age_ms)))
    }

    /// A saved grasp that waits for its label, while the live prediction sees something else.
    fn lifting(p_stable: Option<f64>) -> EngineStatus {
        let record = |p_stable| prediction_on(p_stable, None, 0.0).record;
        let mut status = predicted(0.02, 18.0);
        status.no_prediction_reason = Some("no initial frame".into());
        status.session.step = Step::Label;
        status.session.last = Some(LastGrasp {
            id: GraspId::parse("2026-11-20T10-15-03Z-7f3a").unwrap(),
            object: "mug".parse().unwrap(),
            outcome: Outcome::Unlabelled,
            predicted: p_stable.map(record),
        });
        status
    }

    fn drawn(status: &EngineStatus) -> String {
        let area = Rect::new(0, 0, 80, 9);
        let mut buffer = Buffer::empty(area);
        draw(&mut buffer, area, status, PALETTE);
        let cells = buffer.content.chunks(80);
        cells
            .map(|row| row.iter().map(|cell| cell.symbol()).collect::<String>() + "\n")
            .collect()
    }

    #[test]
    fn prediction_of_the_grasp_stays_until_its_label() {
        let mut status = lifting(Some(0.97));
        for live in [status.prediction.take(), None] {
            status.prediction = live;
            let shown = reading(&status, PALETTE);
            assert_eq!((shown.number.as_str(), shown.verdict), ("0.97", "STABLE"));
            let drawn = drawn(&status);
            assert!(drawn.contains("grasp 7f3a, before the lift"), "{drawn}");
            assert!(!drawn.contains("no prediction"), "{drawn}");
        }
        status.session.last.as_mut().unwrap().outcome = Outcome::Stable;
        status.session.step = Step::Initial;
        assert!(drawn(&status).contains("no prediction: no initial frame"));
    }

    #[test]
    fn grasp_without_prediction_says_so() {
        let drawn = drawn(&lifting(None));
        assert!(
            drawn.contains("no prediction: none was saved with grasp 7f3a"),
            "{drawn}"
        );
    }

    #[test]
    fn style_and_verdict_follow_the_threshold() {
        let [stable, slip] = [predicted(0.5, 18.0), predicted(0.49, 18.0)];
        let stable = reading(&stable, PALETTE);
        assert_eq!((stable.number.as_str(), stable.verdict), ("0.50", "STABLE"));
        assert_eq!(stable.style, PALETTE.stable());
        let slip = reading(&slip, PALETTE);
        assert_eq!((slip.number.as_str(), slip.verdict), ("0.49", "SLIP"));
        assert_eq!(slip.style, PALETTE.slip());
    }

    #[test]
    fn old_frame_gives_no_verdict() {
        for age in [501.0, f64::NAN, f64::INFINITY] {
            let old = predicted(0.9, age);
            let old = reading(&old, PALETTE);
            assert_eq!(old.verdict, "OLD");
            assert_eq!(old.style, PALETTE.faint());
        }
    }

    #[test]
    fn out_of_distribution_images_are_unsure() {
        let read = |ood_score, age_ms| {
            let status = live(Some(prediction_on(0.97, Some(ood_score), age_ms)));
            let reading = reading(&status, PALETTE);
            (reading.verdict, reading.style)
        };
        assert_eq!(read(1.01, 18.0), ("UNSURE", PALETTE.warning()));
        assert_eq!(read(0.99, 18.0).0, "STABLE");
        assert_eq!(read(7.0, 900.0).0, "OLD");
    }

    #[test]
    fn adapted_probability_is_shown_with_the_models_own() {
        let mut status = predicted(0.48, 18.0);
        if let Some(live) = &mut status.prediction {
            live.record.adapted = Some(AdaptedPrediction {
                p_stable: 0.63,
                base_rate: 0.65,
                labels: 7,
            });
            *live = PredictionStatus {
                frame_age_ms: 18.0,
                ..PredictionStatus::new(live.record.clone(), false)
            };
        }
        let shown = reading(&status, PALETTE);
        assert_eq!((shown.number.as_str(), shown.verdict), ("0.63", "STABLE"));
        let text = drawn(&status);
        assert!(
            text.contains("7 labels: base rate 0.65, model 0.48"),
            "{text}"
        );
        let waiting = EngineStatus {
            adaptation: Some(gripcast_nn::predict::Adaptation::new(0.5, 10.0, [1, 6])),
            ..live(None)
        };
        let text = drawn(&waiting);
        assert!(
            text.contains("adapted to 7 labels: base rate 0.65"),
            "{text}"
        );
    }

    #[test]
    fn open_outcomes_are_unsure_with_the_error_rate() {
        let mut status = predicted(0.9, 18.0);
        if let Some(live) = &mut status.prediction {
            live.record.set = Some(gripcast_dataset::OpenOutcomes {
                error_rate: 0.1,
                stable: true,
                slip: true,
            });
            *live = PredictionStatus {
                frame_age_ms: 18.0,
                ..PredictionStatus::new(live.record.clone(), false)
            };
        }
        assert_eq!(reading(&status, PALETTE).verdict, "UNSURE");
        let text = drawn(&status);
        assert!(
            text.contains("can't tell at an error rate of 0.1"),
            "{text}"
        );
    }

    #[test]
    fn missing_probability_gives_no_verdict() {
        for absent in [live(None), predicted(f64::NAN, 1.0)] {
            let reading = reading(&absent, PALETTE);
            assert_eq!((reading.number.as_str(), reading.verdict), ("-.--", ""));
            assert_eq!(reading.bar(), None);
        }
    }

    #[test]
    fn bar_length_is_proportional() {
        let area = Rect::new(0, 0, 12, 1);
        for (p, full) in [(0.0, 0), (0.3, 3), (1.0, 10), (7.0, 10), (-1.0, 0)] {
            let mut buffer = Buffer::empty(area);
            let mut status = predicted(p, 1.0);
            if let Some(prediction) = &mut status.prediction {
                prediction.record.threshold = f64::NAN;
            }
            let reading = reading(&status, PALETTE);
            draw_bar(&mut buffer, area, ["█", "▌"], &reading, PALETTE);
            let full_style = |x: &u16| buffer[(*x, 0)].style().fg == reading.style.fg;
            let blocks = (1..11).filter(full_style).count();
            assert_eq!(blocks, full, "{p}");
        }
    }

    #[test]
    fn threshold_is_marked() {
        let area = Rect::new(0, 0, 13, 1);
        let mut buffer = Buffer::empty(area);
        let status = predicted(0.9, 1.0);
        let reading = reading(&status, PALETTE);
        draw_bar(&mut buffer, area, ["█", "▌"], &reading, PALETTE);
        assert_eq!(buffer[(6, 0)].symbol(), "┃");
    }

    #[test]
    fn size_follows_the_space() {
        assert_eq!(size(200, 20), Some(Size::Large));
        assert_eq!(size(80, 5), Some(Size::Medium));
        assert_eq!(size(80, 4), Some(Size::Small));
        assert_eq!(size(30, 10), None);
    }
}
