//! Diagrams as inline SVG: axes, curves thinned to what can be seen, and the keys they share.

use std::fmt::Write as _;

use super::put;
use gripcast_report::polyline;
use gripcast_report::{tick_step, ticks};

/// Deviation that a left-out point of a curve may have, tenths of a px.
const TOLERANCE: f64 = 1.5;

/// Definitions that every diagram refers to, so that none repeats them.
pub(super) fn shared_keys(out: &mut String) {
    out.push_str(
        "<svg class=\"defs\" width=\"0\" height=\"0\" aria-hidden=\"true\"><defs>\
         <g id=\"key-force\"><path class=\"cl\" d=\"M0-3h16\"/><text x=\"20\">left</text>\
         <path class=\"cr\" d=\"M44-3h16\"/><text x=\"64\">right</text></g>\
         <g id=\"key-height\"><path class=\"co\" d=\"M0-3h16\"/>\
         <text x=\"20\">lowest point</text><path class=\"cg\" d=\"M94-3h16\"/>\
         <text x=\"114\">gripper</text></g>\
         <pattern id=\"hatch\" width=\"5\" height=\"5\" patternUnits=\"userSpaceOnUse\" \
         patternTransform=\"rotate(45)\"><path class=\"hatch\" d=\"M0 0v5\"/></pattern>\
         </defs></svg>\n",
    );
}

/// No force, height or time of a grasp comes near; beyond it axes would overflow.
const LARGEST: f64 = 1e12;

/// Lowest and highest finite number, up to [`LARGEST`].
pub(super) fn extent(values: impl Iterator<Item = f64>) -> Option<[f64; 2]> {
    values
        .filter(|value| value.abs() <= LARGEST)
        .fold(None, |range, value| match range {
            None => Some([value, value]),
            Some([low, high]) => Some([low.min(value), high.max(value)]),
        })
}

/// Where the name of a line stands.
#[derive(Clone, Copy)]
pub(super) enum Label {
    RightBelow,
    LeftAbove,
}

/// A diagram's frame (px) and the ranges that it shows.
pub(super) struct Panel {
    left: f64,
    right: f64,
    top: f64,
    bottom: f64,
    x: [f64; 2],
    y: [f64; 2],
}

impl Panel {
    /// `frame` is left, right, top, bottom. A range without extent is widened.
    pub(super) fn new(frame: [f64; 4], x: [f64; 2], y: [f64; 2]) -> Self {
        let [left, right, top, bottom] = frame;
        let widened = |[low, high]: [f64; 2]| {
            if high - low > 1e-9 * (1.0 + low.abs().max(high.abs())) {
                [low, high]
            } else {
                [low, low + (1e-3 * low.abs()).max(1.0)]
            }
        };
        Self {
            left,
            right,
            top,
            bottom,
            x: widened(x),
            y: widened(y),
        }
    }

    /// Place of an abscissa, px; kept inside the frame.
    pub(super) fn x(&self, value: f64) -> f64 {
        let share = (value - self.x[0]) / (self.x[1] - self.x[0]);
        self.left + (self.right - self.left) * share.clamp(0.0, 1.0)
    }

    /// Place of an ordinate, px; kept inside the frame.
    pub(super) fn y(&self, value: f64) -> f64 {
        let share = (value - self.y[0]) / (self.y[1] - self.y[0]);
        self.bottom - (self.bottom - self.top) * share.clamp(0.0, 1.0)
    }

    /// The area from one abscissa to another.
    pub(super) fn band(&self, out: &mut String, from: f64, to: f64, class: &str) {
        let (x, end) = (self.x(from), self.x(to));
        if end > x {
            put!(
                out,
                "<rect class=\"{class}\" x=\"{x:.1}\" y=\"{:.0}\" width=\"{:.1}\" \
                 height=\"{:.0}\"/>",
                self.top,
                end - x,
                self.bottom - self.top
            );
        }
    }

    /// Grid lines and numbers of the ordinate, and the frame's left and lower edge.
    pub(super) fn ordinate(&self, out: &mut String, label: &str, count: f64) {
        let (step, digits) = tick_step(self.y[1] - self.y[0], count);
        let (mut lines, mut numbers) = (String::new(), String::new());
        for value in ticks(self.y[0], self.y[1], step) {
            let y = self.y(value);
            put!(lines, "M{:.0} {y:.1}H{:.0}", self.left, self.right);
            put!(
                numbers,
                "<text x=\"{:.0}\" y=\"{:.1}\">{value:.digits$}</text>",
                self.left - 4.0,
                y + 3.0
            );
        }
        let middle = 0.5 * (self.top + self.bottom);
        put!(
            out,
            "<path class=\"gr\" d=\"{lines}\"/><g class=\"ny\">{numbers}</g>\
             <text class=\"nm\" transform=\"translate(9 {middle:.0}) rotate(-90)\">{label}</text>\
             <path class=\"ax\" d=\"M{:.0} {:.0}V{:.0}H{:.0}\"/>",
            self.left,
            self.top,
            self.bottom,
            self.right
        );
    }

    /// Ticks and numbers of the abscissa.
    pub(super) fn abscissa(&self, out: &mut String, label: &str, count: f64) {
        let (step, digits) = tick_step(self.x[1] - self.x[0], count);
        let (mut lines, mut numbers) = (String::new(), String::new());
        for value in ticks(self.x[0], self.x[1], step) {
            let x = self.x(value);
            put!(lines, "M{x:.1} {:.0}v3", self.bottom);
            put!(
                numbers,
                "<text x=\"{x:.1}\" y=\"{:.0}\">{value:.digits$}</text>",
                self.bottom + 12.0
            );
        }
        put!(
            out,
            "<path class=\"ax\" d=\"{lines}\"/><g class=\"nx\">{numbers}</g>\
             <text class=\"nm\" x=\"{:.0}\" y=\"{:.0}\">{label}</text>",
            0.5 * (self.left + self.right),
            self.bottom + 23.0
        );
    }

    /// A horizontal line with its name (SVG), where curves seldom are.
    pub(super) fn threshold(&self, out: &mut String, value: f64, name: &str, label: Label) {
        if !value.is_finite() {
            return;
        }
        let y = self.y(value);
        let (class, x, base) = match label {
            Label::RightBelow => ("tn end", self.right - 3.0, y + 10.0),
            Label::LeftAbove => ("tn", self.left + 4.0, y - 3.0),
        };
        put!(
            out,
            "<path class=\"ct\" d=\"M{:.0} {y:.1}H{:.0}\"/>\
             <text class=\"{class}\" x=\"{x:.0}\" y=\"{base:.1}\">{name}</text>",
            self.left,
            self.right
        );
    }

    /// A curve; where a number is missing it is interrupted.
    pub(super) fn curve(&self, out: &mut String, xs: &[f64], ys: &[f64], class: &str) {
        let mut data = String::new();
        let mut run = Vec::new();
        for (&x, &y) in xs.iter().zip(ys) {
            if x.is_finite() && y.is_finite() {
                run.push([10.0 * self.x(x), 10.0 * self.y(y)]);
            } else {
                draw(&mut data, &mut run);
            }
        }
        draw(&mut data, &mut run);
        if !data.is_empty() {
            put!(
                out,
                "<path class=\"{class}\" transform=\"scale(.1)\" d=\"{data}\"/>"
            );
        }
    }
}

/// Appends a run of points in whole tenths of a px, each relative to the one before.
fn draw(data: &mut String, run: &mut Vec<[f64; 2]>) {
    let points: Vec<[i64; 2]> = polyline::thinned(run, TOLERANCE, usize::MAX)
        .into_iter()
        .map(|at| run[at].map(|v| v.round() as i64))
        .collect();
    run.clear();
    let Some(&[mut x, mut y]) = points.first() else {
        return;
    };
    put!(data, "M{x} {y}l");
    if points.len() == 1 {
        data.push_str("0 0");
    }
    for (i, &[next_x, next_y]) in points.iter().enumerate().skip(1) {
        let (dx, dy) = (next_x - x, next_y - y);
        let gap = |value: i64, is_first: bool| if value < 0 || is_first { "" } else { " " };
        put!(data, "{}{dx}{}{dy}", gap(dx, i == 1), gap(dy, false));
        (x, y) = (next_x, next_y);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn path(xs: &[f64], ys: &[f64]) -> String {
        let panel = Panel::new([0.0, 100.0, 0.0, 50.0], [0.0, 10.0], [0.0, 5.0]);
        let mut out = String::new();
        panel.curve(&mut out, xs, ys, "c");
        out
    }

    #[test]
    fn a_curve_keeps_its_corners_alone() {
        let xs: Vec<f64> = (0..=10).map(f64::from).collect();
        let ys: Vec<f64> = xs.iter().map(|x| x.min(5.0)).collect();
        assert!(path(&xs, &ys).contains("d=\"M0 500l500-500 500 0\""));
    }

    #[test]
    fn gaps_interrupt_and_single_points_stay() {
        let out = path(&[0.0, 1.0, 2.0, 3.0], &[0.0, f64::NAN, 1.0, 1.0]);
        assert!(out.contains("d=\"M0 500l0 0M200 400l100 0\""), "{out}");
        assert_eq!(path(&[], &[]), "");
        assert_eq!(path(&[f64::INFINITY], &[1.0]), "");
    }

    #[test]
    fn a_range_without_extent_is_widened() {
        let panel = Panel::new([0.0, 100.0, 0.0, 50.0], [3.0, 3.0], [1e12, 1e12]);
        assert!(panel.x(3.0).is_finite() && panel.y(1e12).is_finite());
        let mut out = String::new();
        panel.ordinate(&mut out, "a", 4.0);
        panel.abscissa(&mut out, "b", 4.0);
        assert!(!out.contains("NaN") && !out.contains("inf"), "{out}");
    }

    #[test]
    fn the_extent_skips_what_is_no_number() {
        assert_eq!(extent([f64::NAN, 2.0, -1.0].into_iter()), Some([-1.0, 2.0]));
        assert_eq!(extent(std::iter::empty()), None);
    }
}
