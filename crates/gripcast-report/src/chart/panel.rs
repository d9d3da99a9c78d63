//! The plotting area of a chart.

use std::fmt::Write as _;

use maud::{Markup, html};

use super::text::{Anchor, NORMAL, SMALL, text, truncated, upright};
use super::{Axis, colour, px};
use crate::polyline;

/// Gap between the tick labels of the ordinate and the panel, px.
pub(super) const GAP: f64 = 7.0;
/// Width of the label of the ordinate at the left edge of the chart, px.
pub(super) const UPRIGHT: f64 = 22.0;
/// Maximum deviation of a simplified line, px.
const TOLERANCE: f64 = 0.12;

/// A rectangle, px, with its axes. Data outside of it are drawn at its edge.
pub struct Panel {
    /// Left edge.
    pub left: f64,
    /// Right edge.
    pub right: f64,
    /// Upper edge.
    pub top: f64,
    /// Lower edge.
    pub bottom: f64,
    /// The abscissa.
    pub x: Axis,
    /// The ordinate.
    pub y: Axis,
}

impl Panel {
    /// Height of tick labels and label of the abscissa below a panel, px.
    pub const ABSCISSA: f64 = 42.0;

    /// Converts data coordinates to px.
    pub fn to_px(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [
            self.left + (self.right - self.left) * self.x.fraction(x),
            self.bottom - (self.bottom - self.top) * self.y.fraction(y),
        ]
    }

    /// Draws grid lines, tick labels and label of the ordinate; goes below the data.
    pub fn grid(&self) -> Markup {
        let mut lines = String::new();
        let [left, right, top, bottom] = [self.left, self.right, self.top, self.bottom].map(px);
        for tick in &self.y.ticks {
            let [_, y] = self.to_px([0.0, tick.value]);
            lines.push_str(&format!("M{left} {}H{right}", px(y)));
        }
        for tick in &self.x.ticks {
            let [x, _] = self.to_px([tick.value, 0.0]);
            lines.push_str(&format!("M{} {top}V{bottom}", px(x)));
        }
        let middle = 0.5 * (self.top + self.bottom);
        let label = truncated(&self.y.label, NORMAL, self.bottom - self.top);
        html! {
            path.grid d=(lines) {}
            @for tick in &self.y.ticks {
                @let [_, y] = self.to_px([0.0, tick.value]);
                (text("small", [self.left - GAP, y + 0.36 * SMALL], Anchor::End, &tick.text))
            }
            (upright("", [UPRIGHT - 8.0, middle], Anchor::Middle, &label))
        }
    }

    /// Draws both axes with ticks, tick labels and label of the abscissa; goes above the data.
    pub fn edges(&self) -> Markup {
        let [left, right, top, bottom] = [self.left, self.right, self.top, self.bottom].map(px);
        let mut lines = format!("M{left} {top}V{bottom}H{right}");
        for tick in &self.x.ticks {
            let [x, _] = self.to_px([tick.value, 0.0]);
            lines.push_str(&format!("M{} {bottom}v4", px(x)));
        }
        for tick in &self.y.ticks {
            let [_, y] = self.to_px([0.0, tick.value]);
            lines.push_str(&format!("M{left} {}h-4", px(y)));
        }
        let middle = 0.5 * (self.left + self.right);
        let label = truncated(&self.x.label, NORMAL, self.right - self.left);
        html! {
            path.axis d=(lines) {}
            @for tick in &self.x.ticks {
                @let [x, _] = self.to_px([tick.value, 0.0]);
                (text("small", [x, self.bottom + 17.0], Anchor::Middle, &tick.text))
            }
            (text("", [middle, self.bottom + 36.0], Anchor::Middle, &label))
        }
    }

    /// Draws a simplified line, interrupted at values that are not finite.
    pub fn line(&self, class: &str, points: impl Iterator<Item = [f64; 2]>) -> Markup {
        let (mut data, mut run) = (String::new(), Vec::new());
        for point in points {
            if are_finite(&[point]) {
                run.push(self.to_px(point));
            } else {
                append_run(&mut data, &mut run);
            }
        }
        append_run(&mut data, &mut run);
        html! {
            @if !data.is_empty() {
                path class=(class) d=(data) {}
            }
        }
    }

    /// Draws the rectangle between two abscissas and two ordinates; nothing if it has no width or a
    /// value is not finite.
    pub fn area(&self, class: &str, [x1, x2]: [f64; 2], [y1, y2]: [f64; 2]) -> Markup {
        let ([left, bottom], [right, top]) = (self.to_px([x1, y1]), self.to_px([x2, y2]));
        html! {
            @if right > left && bottom.is_finite() && top.is_finite() {
                rect class=(class) x=(px(left)) y=(px(top.min(bottom))) width=(px(right - left))
                    height=(px((bottom - top).abs())) {}
            }
        }
    }

    /// Draws a straight line between two points.
    pub fn segment(&self, class: &str, from: [f64; 2], to: [f64; 2]) -> Markup {
        let ([x1, y1], [x2, y2]) = (self.to_px(from).map(px), self.to_px(to).map(px));
        html! {
            @if are_finite(&[from, to]) {
                path class=(class) d={ "M" (x1) " " (y1) "L" (x2) " " (y2) } {}
            }
        }
    }

    /// Draws a dashed reference line.
    pub fn guide(&self, from: [f64; 2], to: [f64; 2]) -> Markup {
        self.segment("guide", from, to)
    }

    /// Draws a dot.
    pub fn dot(&self, class: &str, at: [f64; 2], radius: f64) -> Markup {
        let [x, y] = self.to_px(at).map(px);
        html! {
            @if are_finite(&[at]) {
                circle class=(class) cx=(x) cy=(y) r=(radius) {}
            }
        }
    }

    /// Draws the marker of a series; shapes distinguish series without colours.
    pub fn marker(&self, series: usize, at: [f64; 2]) -> Markup {
        let class = format!("marker {}", colour(series));
        if series.is_multiple_of(2) {
            return self.dot(&class, at, 4.0);
        }
        let [x, y] = self.to_px(at).map(|v| px(v - 3.5));
        html! {
            @if are_finite(&[at]) {
                rect class=(class) x=(x) y=(y) width="7" height="7" {}
            }
        }
    }

    /// Draws an interval along an axis, with a cap at each end inside the panel.
    pub fn whisker(&self, class: &str, ends: [[f64; 2]; 2]) -> Markup {
        let [[x1, y1], [x2, y2]] = ends.map(|end| self.to_px(end).map(px));
        let is_upright = ends[0][0] == ends[1][0];
        let mut data = format!("M{x1} {y1}L{x2} {y2}");
        for end in ends {
            let ([x, y], inside) = (
                self.to_px(end),
                self.x.contains(end[0]) && self.y.contains(end[1]),
            );
            match (inside, is_upright) {
                (false, _) => {}
                (true, true) => data.push_str(&format!("M{} {}h8", px(x - 4.0), px(y))),
                (true, false) => data.push_str(&format!("M{} {}v8", px(x), px(y - 4.0))),
            }
        }
        html! {
            @if are_finite(&ends) {
                path class=(class) d=(data) {}
            }
        }
    }
}

fn are_finite(points: &[[f64; 2]]) -> bool {
    points.iter().flatten().all(|v| v.is_finite())
}

/// Appends a run of points, px, to the data of a path.
fn append_run(data: &mut String, run: &mut Vec<[f64; 2]>) {
    let kept = polyline::simplify(run, TOLERANCE, usize::MAX);
    for (i, &index) in kept.iter().enumerate() {
        let separator = match i {
            0 => "M",
            1 => "L",
            _ => " ",
        };
        let [x, y] = run[index].map(px);
        // Writing to a string cannot fail.
        let _ = write!(data, "{separator}{x} {y}");
    }
    if kept.len() == 1 {
        data.push_str("h0");
    }
    run.clear();
}

#[cfg(test)]
mod tests {
    use super::*;

    fn panel() -> Panel {
        Panel {
            left: 10.0,
            right: 110.0,
            top: 20.0,
            bottom: 70.0,
            x: Axis::fractions("x"),
            y: Axis::fractions("y"),
        }
    }

    fn line(points: &[[f64; 2]]) -> String {
        panel().line("c", points.iter().copied()).into_string()
    }

    #[test]
    fn tick_labels_align_with_ticks() {
        let (grid, edges) = (panel().grid().into_string(), panel().edges().into_string());
        assert!(
            grid.contains("M10 60H110") && grid.contains("M30 20V70"),
            "{grid}"
        );
        assert!(
            grid.contains("x=\"3\" y=\"64\" text-anchor=\"end\">0.2<"),
            "{grid}"
        );
        assert!(
            edges.contains("M10 60h-4") && edges.contains("M30 70v4"),
            "{edges}"
        );
        assert!(
            edges.contains("x=\"30\" y=\"87\" text-anchor=\"middle\">0.2<"),
            "{edges}"
        );
        let mut panel = panel();
        panel.x = panel.x.without_labels();
        let edges = panel.edges().into_string();
        assert!(
            edges.contains("M30 70v4") && !edges.contains("<text"),
            "{edges}"
        );
    }

    #[test]
    fn data_are_clamped_to_the_panel() {
        assert_eq!(panel().to_px([0.5, 0.5]), [60.0, 45.0]);
        assert_eq!(panel().to_px([-3.0, 9.0]), [10.0, 20.0]);
    }

    #[test]
    fn line_keeps_only_its_corners() {
        let corner: Vec<[f64; 2]> = (0..=10)
            .map(|i| [0.1 * f64::from(i), 0.2 * f64::from(i.min(5))])
            .collect();
        assert_eq!(
            line(&corner),
            "<path class=\"c\" d=\"M10 70L60 20 110 20\"></path>"
        );
    }

    #[test]
    fn gaps_interrupt_a_line_and_single_points_stay() {
        let (nan, infinite) = (f64::NAN, f64::INFINITY);
        let drawn = line(&[
            [0.0, 0.0],
            [0.1, nan],
            [0.5, 0.5],
            [infinite, 0.5],
            [1.0, 1.0],
        ]);
        assert!(drawn.contains("d=\"M10 70h0M60 45h0M110 20h0\""), "{drawn}");
        assert_eq!(line(&[]), "");
        assert_eq!(line(&[[nan, 1.0]]), "");
    }

    #[test]
    fn whiskers_have_caps_only_inside_the_panel() {
        let upright = panel().whisker("w", [[0.5, 0.5], [0.5, 2.0]]).into_string();
        assert!(upright.contains("d=\"M60 45L60 20M56 45h8\""), "{upright}");
        let across = panel().whisker("w", [[0.0, 0.0], [1.0, 0.0]]).into_string();
        assert!(across.contains("M10 66v8M110 66v8"), "{across}");
    }

    #[test]
    fn areas_without_width_are_omitted() {
        assert_eq!(panel().area("a", [0.5, 0.5], [0.0, 1.0]).into_string(), "");
        assert_eq!(
            panel().area("a", [0.0, 0.5], [f64::NAN, 1.0]).into_string(),
            ""
        );
        let bar = panel().area("a", [0.0, 0.5], [0.5, 0.0]).into_string();
        assert!(
            bar.contains("x=\"10\" y=\"45\" width=\"50\" height=\"25\""),
            "{bar}"
        );
    }

    #[test]
    fn non_finite_marks_are_omitted() {
        let (panel, nowhere) = (panel(), [0.5, f64::NAN]);
        let marks = [
            panel.dot("d", nowhere, 2.0),
            panel.marker(0, nowhere),
            panel.marker(1, nowhere),
            panel.guide([0.0, 0.0], nowhere),
            panel.whisker("w", [[0.5, 0.0], nowhere]),
        ];
        assert!(marks.iter().all(|mark| mark.0.is_empty()));
        assert_ne!(panel.marker(0, [0.5; 2]).0, panel.marker(1, [0.5; 2]).0);
    }
}
