//! What every figure has: size, name, description, style, and the looks of its series.

use std::fmt::Write as _;

use gripcast_report::{Esc, put};

/// A complete SVG of a size in px. `title` is its accessible name, `description` says in words what
/// it shows.
pub(super) fn figure(
    [width, height]: [f64; 2],
    title: &str,
    description: &str,
    body: &str,
) -> String {
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" class=\"metric-plot\" role=\"img\" \
         width=\"{width:.0}\" height=\"{height:.0}\" viewBox=\"0 0 {width:.0} {height:.0}\">\
         <title>{}</title><desc>{}</desc><style>{}</style>{body}</svg>",
        Esc(title),
        Esc(description),
        include_str!("style.css").replace('\n', "")
    )
}

/// Colours that tell series apart.
const COLOURS: usize = 6;
/// Dashes that tell lines apart where colours do not.
const DASHES: usize = 4;

/// Classes of the colour of a series.
pub(super) fn colour(series: usize) -> String {
    format!("series-{}", series % COLOURS)
}

/// Classes of the line of a series.
pub(super) fn line(series: usize) -> String {
    // Colours that come again get another dash.
    let dash = (series + series / COLOURS) % DASHES;
    format!("curve {} dash-{dash}", colour(series))
}

/// A line through points in px; those that are no numbers are left out.
pub(super) fn polyline(out: &mut String, class: &str, points: impl Iterator<Item = [f64; 2]>) {
    let mut data = String::new();
    for [x, y] in points.filter(|point| point.iter().all(|v| v.is_finite())) {
        let command = if data.is_empty() { 'M' } else { 'L' };
        put!(data, "{command}{x:.1} {y:.1}");
    }
    if !data.is_empty() {
        put!(out, "<path class=\"{class}\" d=\"{data}\"/>");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_cannot_break_out() {
        let svg = figure([10.0, 20.0], "<a & b>", "\"c\"", "");
        assert!(svg.contains("<title>&lt;a &amp; b&gt;</title>"));
        assert!(svg.contains("<desc>&quot;c&quot;</desc>"));
        assert!(svg.contains("viewBox=\"0 0 10 20\""));
    }

    #[test]
    fn many_lines_differ() {
        let mut looks: Vec<String> = (0..COLOURS * DASHES).map(line).collect();
        looks.sort();
        looks.dedup();
        assert_eq!(looks.len(), COLOURS * DASHES);
        let style = include_str!("style.css");
        assert!((0..COLOURS).all(|i| style.contains(&format!(".{}{{", colour(i)))));
        // The first is drawn through.
        assert!((1..DASHES).all(|i| style.contains(&format!(".dash-{i}{{"))));
    }

    #[test]
    fn points_that_are_no_numbers_are_left_out() {
        let mut out = String::new();
        let points = [
            [f64::NAN, 1.0],
            [1.0, 2.0],
            [3.0, f64::INFINITY],
            [5.0, 6.0],
        ];
        polyline(&mut out, "c", points.into_iter());
        assert_eq!(out, "<path class=\"c\" d=\"M1.0 2.0L5.0 6.0\"/>");
        polyline(&mut out, "c", [].into_iter());
        assert_eq!(out.matches("<path").count(), 1);
    }
}
