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
use crate::daemon::{EngineStatus, PredictionStatus};
use gripcast_nn::predict::PredictedLabel;

/// Frame age above which a prediction is shown as old, ms.
const STALE_MS: f64 = 500.0;
/// Minimum columns between probability and verdict.
const GAP: u16 = 4;

/// Displayed texts and style of the gauge.
struct Reading {
    number: String,
    verdict: &'static str,
    style: Style,
    /// Probability and threshold; `None` for an empty bar.
    bar: Option<(f64, f64)>,
}

/// Returns the displayed name of a verdict.
pub(super) fn word(verdict: PredictedLabel) -> &'static str {
    match verdict {
        PredictedLabel::Stable => "STABLE",
        PredictedLabel::Slip => "SLIP",
        PredictedLabel::Unsure => "UNSURE",
    }
}

/// Returns the displayed verdict: that of the prediction, or `OLD`.
pub(super) fn shown_verdict(prediction: &PredictionStatus) -> &'static str {
    if is_stale(prediction) || !prediction.record.p_stable.is_finite() {
        "OLD"
    } else {
        word(prediction.verdict)
    }
}

fn is_stale(prediction: &PredictionStatus) -> bool {
    prediction.frame_age_ms > STALE_MS || prediction.frame_age_ms.is_nan()
}

pub(super) fn verdict_style(verdict: &str, palette: Palette) -> Style {
    match verdict {
        "STABLE" => palette.stable(),
        "SLIP" => palette.slip(),
        "UNSURE" => palette.warning(),
        _ => palette.faint(),
    }
}

fn reading(prediction: Option<&PredictionStatus>, palette: Palette) -> Reading {
    let Some(prediction) = prediction.filter(|p| p.record.p_stable.is_finite()) else {
        return Reading {
            number: "-.--".to_owned(),
            verdict: "",
            style: palette.faint(),
            bar: None,
        };
    };
    let p = prediction.record.p_stable;
    let verdict = shown_verdict(prediction);
    let style = verdict_style(verdict, palette);
    Reading {
        number: format!("{:.2}", p.clamp(0.0, 1.0)),
        verdict,
        style,
        bar: Some((p, prediction.record.threshold)),
    }
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
    let reading = reading(status.prediction.as_ref(), palette);
    write_title(buffer, row(area, 0), status.prediction.as_ref(), palette);
    let body = inset(area, 0, 1);
    let used = match size(area.width, body.height.saturating_sub(1)) {
        Some(size) => draw_big(buffer, body, &reading, size, status, palette),
        None => draw_line(buffer, body, &reading, status, palette),
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
    reading: &Reading,
    size: Size,
    status: &EngineStatus,
    palette: Palette,
) -> u16 {
    let (at, style) = (inset(area, 1, 0), reading.style);
    big_digits::draw(buffer, at, &reading.number, size, style);
    let x = 1 + size.columns("0.00") + GAP;
    if reading.verdict.is_empty() {
        let reason = inset(area, x, size.rows() / 2);
        write_no_prediction(buffer, reason, status, palette);
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
fn draw_line(
    buffer: &mut Buffer,
    area: Rect,
    reading: &Reading,
    status: &EngineStatus,
    palette: Palette,
) -> u16 {
    let text = format!(" {}  {}  ", reading.number, reading.verdict);
    let after = columns(&text).min(area.width);
    write(buffer, area, &Line::styled(text, reading.style));
    if reading.verdict.is_empty() {
        write_no_prediction(buffer, inset(area, after, 0), status, palette);
    }
    1
}

fn write_no_prediction(buffer: &mut Buffer, area: Rect, status: &EngineStatus, palette: Palette) {
    let reason = status
        .no_prediction_reason
        .as_deref()
        .unwrap_or("waiting for the first prediction");
    let mut rest = reason;
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

fn write_title(
    buffer: &mut Buffer,
    area: Rect,
    prediction: Option<&PredictionStatus>,
    palette: Palette,
) {
    let mut left = vec![Span::styled(" STABILITY ", palette.strong())];
    let Some(prediction) = prediction else {
        write(buffer, area, &Line::from(left));
        return;
    };
    let age = format!("frame {} old", duration_ms(prediction.frame_age_ms));
    let age_style = palette.warning_if(is_stale(prediction), palette.faint());
    let timing = |words: String| {
        Line::from(vec![
            Span::styled(age.clone(), age_style),
            Span::styled(words, palette.faint()),
        ])
    };
    let latency = duration_ms(prediction.record.latency_ms);
    let long = timing(format!(
        " · result in {latency} · model {:.1} ms ",
        prediction.record.engine_ms
    ));
    let name = clipped(&prediction.record.model, 28);
    let heuristic = u16::from(prediction.heuristic) * columns(" HEURISTIC ");
    let needed = columns(" STABILITY ") + columns(&name) + heuristic + 2;
    let taken = match area.width.checked_sub(needed) {
        Some(room) if long.width() <= usize::from(room) => write_right(buffer, area, &long),
        _ => write_right(buffer, area, &timing(format!(" · {latency} "))),
    };
    let rest = without_last(area, taken + 1);
    if prediction.heuristic {
        left.push(Span::styled("HEURISTIC ", palette.warning()));
    }
    if prediction.verdict == PredictedLabel::Unsure {
        let reason = prediction.record.unsure_reason.as_deref();
        let words = format!("{} ", reason.unwrap_or("unlike the training images"));
        left.push(Span::styled(words, palette.warning()));
    }
    let room = usize::from(rest.width).saturating_sub(Line::from(left.clone()).width());
    left.push(Span::styled(clipped(&name, room), palette.faint()));
    write(buffer, rest, &Line::from(left));
}

/// Draws a bar from 0 to 1 with a `whole` and a `half` symbol and a mark at the threshold.
fn draw_bar(
    buffer: &mut Buffer,
    area: Rect,
    [whole, half]: [&'static str; 2],
    reading: &Reading,
    palette: Palette,
) {
    let area = trimmed(area);
    let (p, threshold) = reading.bar.unwrap_or((0.0, f64::NAN));
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
fn draw_scale(buffer: &mut Buffer, area: Rect, reading: &Reading, palette: Palette) {
    let area = trimmed(area);
    write(buffer, area, &Line::styled("◄ slip", palette.faint()));
    write_right(buffer, area, &Line::styled("stable ►", palette.faint()));
    let Some((_, threshold)) = reading.bar else {
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
    use gripcast_dataset::PredictionRecord;

    const PALETTE: Palette = Palette {
        depth: ColourDepth::True,
    };

    fn prediction_on(p_stable: f64, ood_score: Option<f64>, frame_age_ms: f64) -> PredictionStatus {
        let record = PredictionRecord {
            p_stable,
            ood_score,
            unsure_reason: None,
            threshold: 0.5,
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

    fn prediction(p_stable: f64, frame_age_ms: f64) -> PredictionStatus {
        prediction_on(p_stable, None, frame_age_ms)
    }

    #[test]
    fn style_and_verdict_follow_the_threshold() {
        let stable = reading(Some(&prediction(0.5, 18.0)), PALETTE);
        assert_eq!((stable.number.as_str(), stable.verdict), ("0.50", "STABLE"));
        assert_eq!(stable.style, PALETTE.stable());
        let slip = reading(Some(&prediction(0.49, 18.0)), PALETTE);
        assert_eq!((slip.number.as_str(), slip.verdict), ("0.49", "SLIP"));
        assert_eq!(slip.style, PALETTE.slip());
    }

    #[test]
    fn old_frame_gives_no_verdict() {
        for age in [501.0, f64::NAN, f64::INFINITY] {
            let old = reading(Some(&prediction(0.9, age)), PALETTE);
            assert_eq!(old.verdict, "OLD");
            assert_eq!(old.style, PALETTE.faint());
        }
    }

    #[test]
    fn out_of_distribution_images_are_unsure() {
        let read = |ood_score, age_ms| {
            reading(Some(&prediction_on(0.97, Some(ood_score), age_ms)), PALETTE)
        };
        let unsure = read(1.01, 18.0);
        assert_eq!(
            (unsure.verdict, unsure.style),
            ("UNSURE", PALETTE.warning())
        );
        assert_eq!(read(0.99, 18.0).verdict, "STABLE");
        assert_eq!(read(7.0, 900.0).verdict, "OLD");
    }

    #[test]
    fn missing_probability_gives_no_verdict() {
        for absent in [None, Some(prediction(f64::NAN, 1.0))] {
            let reading = reading(absent.as_ref(), PALETTE);
            assert_eq!((reading.number.as_str(), reading.verdict), ("-.--", ""));
            assert_eq!(reading.bar, None);
        }
    }

    #[test]
    fn bar_length_is_proportional() {
        let area = Rect::new(0, 0, 12, 1);
        for (p, full) in [(0.0, 0), (0.3, 3), (1.0, 10), (7.0, 10), (-1.0, 0)] {
            let mut buffer = Buffer::empty(area);
            let reading = Reading {
                bar: Some((p, f64::NAN)),
                ..reading(Some(&prediction(p, 1.0)), PALETTE)
            };
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
        let reading = reading(Some(&prediction(0.9, 1.0)), PALETTE);
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
