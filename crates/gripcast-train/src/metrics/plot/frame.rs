//! The area of a figure in which data are drawn, and its axes.

use std::fmt::Write as _;

use super::text::{Anchor, NORMAL, SMALL, count, fitted, label, small, upright, width};
use gripcast_report::{fixed, put};

/// Room between numbers of the ordinate and the frame, px.
const GAP: f64 = 7.0;
/// Room at the left edge of the figure that the label of the ordinate takes, px.
const UPRIGHT: f64 = 22.0;
/// Room below the frame that numbers and label of the abscissa take, px.
pub(super) const ABSCISSA: f64 = 42.0;

/// A number at an axis.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Tick {
    pub(super) value: f64,
    pub text: String,
}

/// An axis: what it shows.
pub(super) struct Axis<'a> {
    pub(super) label: &'a str,
    pub(super) range: [f64; 2],
    pub(super) ticks: Vec<Tick>,
}

impl<'a> Axis<'a> {
    /// From 0 to 1.
    pub(super) fn of_shares(label: &'a str) -> Self {
        Self::new(label, [0.0, 1.0])
    }

    /// With about five numbers; a range that is none becomes 0..1.
    pub(super) fn new(label: &'a str, [low, high]: [f64; 2]) -> Self {
        let span = high - low;
        let range = if span.is_finite() && span > 1e-9 * low.abs().max(high.abs()) {
            [low, high]
        } else {
            [0.0, 1.0]
        };
        Self {
            label,
            range,
            ticks: ticks(range, step((range[1] - range[0]) / 5.0)),
        }
    }

    /// Of counts from 0 up to at least `highest`, with about three whole numbers.
    pub(super) fn of_counts(label: &'a str, highest: usize) -> Self {
        let highest = highest.max(1) as f64;
        let step = step(highest / 2.0).max(1.0);
        let range = [0.0, (highest / step).ceil() * step];
        Self {
            label,
            range,
            ticks: ticks(range, step)
                .into_iter()
                .map(|tick| Tick {
                    text: count(tick.value as usize),
                    ..tick
                })
                .collect(),
        }
    }

    /// Room that the numbers and the label of an ordinate take beside the frame, px.
    pub(super) fn room(&self) -> f64 {
        let widths = self.ticks.iter().map(|tick| width(&tick.text, SMALL));
        UPRIGHT + GAP + widths.fold(0.0, f64::max)
    }
}

/// The smallest of 1, 2 and 5 times a power of ten that is at least `rough`.
fn step(rough: f64) -> f64 {
    let power = 10_f64.powf(rough.log10().floor());
    let factors = [1.0, 2.0, 5.0].into_iter();
    // Slack for quotients that are not exact.
    let factor = factors.into_iter().find(|f| f * power >= 0.999 * rough);
    power * factor.unwrap_or(10.0)
}

/// Multiples of `step` in a range.
fn ticks([low, high]: [f64; 2], step: f64) -> Vec<Tick> {
    const SLACK: f64 = 1e-6;
    let decimals = (-(step.log10() + SLACK).floor()).clamp(0.0, 9.0) as usize;
    let first = (low / step - SLACK).ceil() as i64;
    let last = (high / step + SLACK).floor() as i64;
    let tick = |i: i64| {
        let value = i as f64 * step;
        Tick {
            value,
            text: fixed(value, decimals),
        }
    };
    (first..=last).map(tick).collect()
}

/// The area in which data are drawn, px.
pub(super) struct Frame<'a> {
    pub(super) left: f64,
    pub(super) right: f64,
    pub(super) top: f64,
    pub(super) bottom: f64,
    pub(super) abscissa: Axis<'a>,
    pub(super) ordinate: Axis<'a>,
}

impl Frame<'_> {
    /// Place of an abscissa; kept inside the frame.
    pub(super) fn x(&self, value: f64) -> f64 {
        self.left + (self.right - self.left) * share(self.abscissa.range, value)
    }

    /// Place of an ordinate; kept inside the frame.
    pub(super) fn y(&self, value: f64) -> f64 {
        self.bottom - (self.bottom - self.top) * share(self.ordinate.range, value)
    }

    /// Place of a point.
    pub(super) fn place(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [self.x(x), self.y(y)]
    }

    /// Grid lines, numbers and label of the ordinate.
    pub(super) fn draw_ordinate(&self, out: &mut String) {
        let mut lines = String::new();
        for tick in &self.ordinate.ticks {
            let y = self.y(tick.value);
            put!(lines, "M{:.1} {y:.1}H{:.1}", self.left, self.right);
            let at = [self.left - GAP, y + 0.36 * SMALL];
            small(out, at, Anchor::End, &tick.text);
        }
        put!(out, "<path class=\"grid\" d=\"{lines}\"/>");
        let text = fitted(self.ordinate.label, NORMAL, self.bottom - self.top);
        let middle = 0.5 * (self.top + self.bottom);
        upright(out, [UPRIGHT - 8.0, middle], &text);
    }

    /// Grid lines of the abscissa.
    pub(super) fn draw_verticals(&self, out: &mut String) {
        let mut lines = String::new();
        for tick in &self.abscissa.ticks {
            let x = self.x(tick.value);
            put!(lines, "M{x:.1} {:.1}V{:.1}", self.top, self.bottom);
        }
        put!(out, "<path class=\"grid\" d=\"{lines}\"/>");
    }

    /// Numbers and label of the abscissa.
    pub(super) fn draw_abscissa(&self, out: &mut String) {
        for tick in &self.abscissa.ticks {
            let at = [self.x(tick.value), self.bottom + 17.0];
            small(out, at, Anchor::Middle, &tick.text);
        }
        let text = fitted(self.abscissa.label, NORMAL, self.right - self.left);
        let middle = 0.5 * (self.left + self.right);
        label(out, [middle, self.bottom + 36.0], Anchor::Middle, &text);
    }

    /// Left and lower edge with marks.
    pub(super) fn draw_edges(&self, out: &mut String) {
        let mut lines = format!(
            "M{:.1} {:.1}V{:.1}H{:.1}",
            self.left, self.top, self.bottom, self.right
        );
        for tick in &self.abscissa.ticks {
            put!(lines, "M{:.1} {:.1}v4", self.x(tick.value), self.bottom);
        }
        for tick in &self.ordinate.ticks {
            put!(lines, "M{:.1} {:.1}h-4", self.left, self.y(tick.value));
        }
        put!(out, "<path class=\"axis\" d=\"{lines}\"/>");
    }

    /// A dashed line between two points of the data.
    pub(super) fn draw_guide(&self, out: &mut String, from: [f64; 2], to: [f64; 2]) {
        let ([x1, y1], [x2, y2]) = (self.place(from), self.place(to));
        put!(
            out,
            "<path class=\"guide\" d=\"M{x1:.1} {y1:.1}L{x2:.1} {y2:.1}\"/>"
        );
    }
}

/// Where a value lies in a range, 0..1.
fn share([low, high]: [f64; 2], value: f64) -> f64 {
    ((value - low) / (high - low)).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texts(axis: &Axis<'_>) -> Vec<String> {
        axis.ticks.iter().map(|tick| tick.text.clone()).collect()
    }

    #[test]
    fn numbers_at_axes_are_round_and_reach_the_ends() {
        let axis = Axis::of_shares("");
        assert_eq!(texts(&axis), ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"]);
        // 0.7 / 0.05 is less than 14.
        let axis = Axis::new("", [0.5, 0.7]);
        assert_eq!(texts(&axis), ["0.50", "0.55", "0.60", "0.65", "0.70"]);
        let axis = Axis::new("", [-0.3, 0.3]);
        assert_eq!(texts(&axis), ["−0.2", "0.0", "0.2"]);
    }

    #[test]
    fn counts_are_whole() {
        assert_eq!(texts(&Axis::of_counts("", 0)), ["0", "1"]);
        assert_eq!(texts(&Axis::of_counts("", 3)), ["0", "2", "4"]);
        assert_eq!(texts(&Axis::of_counts("", 230)), ["0", "200", "400"]);
        let axis = Axis::of_counts("", 17_000);
        assert_eq!(texts(&axis), ["0", "10,000", "20,000"]);
        for highest in 1..500 {
            let axis = Axis::of_counts("", highest);
            assert!(axis.range[1] >= highest as f64);
            assert!((2..=4).contains(&axis.ticks.len()), "{highest}");
        }
    }

    #[test]
    fn a_range_that_is_none_becomes_that_of_shares() {
        for range in [
            [1.0, 1.0],
            [2.0, 1.0],
            [f64::NAN, 1.0],
            [0.0, f64::INFINITY],
        ] {
            assert_eq!(Axis::new("", range).range, [0.0, 1.0]);
        }
        let tiny = Axis::new("", [1e12, 1e12 + 1e-4]);
        assert!(tiny.ticks.len() < 10);
    }

    fn small_frame() -> Frame<'static> {
        Frame {
            left: 10.0,
            right: 110.0,
            top: 20.0,
            bottom: 70.0,
            abscissa: Axis::of_shares(""),
            ordinate: Axis::of_shares(""),
        }
    }

    #[test]
    fn numbers_stand_beside_their_marks() {
        let (frame, mut out) = (small_frame(), String::new());
        frame.draw_ordinate(&mut out);
        frame.draw_abscissa(&mut out);
        frame.draw_edges(&mut out);
        assert!(out.contains("M10.0 60.0h-4") && out.contains("M30.0 70.0v4"));
        let left = "x=\"3.0\" y=\"64.0\" text-anchor=\"end\">0.2<";
        let below = "x=\"30.0\" y=\"87.0\" text-anchor=\"middle\">0.2<";
        assert!(out.contains(left) && out.contains(below), "{out}");
    }

    #[test]
    fn data_stay_inside_the_frame() {
        let frame = small_frame();
        assert_eq!(frame.place([0.5, 0.5]), [60.0, 45.0]);
        assert_eq!(frame.place([-3.0, 9.0]), [10.0, 20.0]);
    }
}
