//! Charts as SVG: panels with axes, marks in them, legends.
//!
//! A chart is part of a page, which has its style, or a separate file. Colours are the page's
//! variables `--ink`, `--line`, `--paper` and `--series-0` to `--series-5`; without them a chart
//! follows the `color-scheme` of its reader.

mod axis;
mod heat;
#[cfg(any(test, feature = "testing"))]
#[path = "layout_test.rs"]
pub mod layout;
mod legend;
mod panel;
mod text;

use maud::{Markup, PreEscaped, html};

pub use axis::{Axis, extent};
pub use heat::{HeatCell, HeatMap, heat_scale};
pub use legend::{Entry, Key, Legend};
pub use panel::Panel;
pub use text::{Anchor, NORMAL, SMALL, count, text, truncated, upright, width, wrapped};

/// CSS of every chart.
pub(crate) const STYLE: &str = include_str!("style.css");

/// Number of series colours.
const COLOURS: usize = 6;
/// Number of dash patterns.
const DASHES: usize = 4;

/// A rendered chart.
pub struct Chart {
    /// Width and height, px.
    pub size: [f64; 2],
    /// Accessible name.
    pub title: String,
    /// Accessible description.
    pub description: String,
    /// SVG content.
    pub body: Markup,
}

impl Chart {
    /// Renders the chart for a page.
    pub fn inline(&self) -> Markup {
        self.svg(None, html! {})
    }

    /// Renders the chart as a separate SVG file.
    pub fn to_svg(&self) -> String {
        let background = html! {
            style { (PreEscaped(STYLE.replace('\n', ""))) }
            rect.paper width="100%" height="100%" {}
        };
        let svg = self.svg(Some("http://www.w3.org/2000/svg"), background);
        crate::text::printable(svg.into_string())
    }

    fn svg(&self, namespace: Option<&str>, background: Markup) -> Markup {
        let [width, height] = self.size.map(|side| format!("{side:.0}"));
        html! {
            svg.chart xmlns=[namespace] role="img" width=(width) height=(height)
                viewBox={ "0 0 " (width) " " (height) } {
                title { (self.title) }
                desc { (self.description) }
                (background)
                (self.body)
            }
        }
    }
}

/// CSS class of the colour of a series.
pub fn colour(series: usize) -> String {
    format!("series-{}", series % COLOURS)
}

/// CSS classes of the line of a series.
pub fn line(series: usize) -> String {
    // Repeated colours get another dash pattern.
    let dash = (series + series / COLOURS) % DASHES;
    format!("curve {} dash-{dash}", colour(series))
}

/// Formats a length or coordinate in px.
fn px(value: f64) -> String {
    // Adding 0 turns -0 into 0.
    format!("{}", (10.0 * value).round() / 10.0 + 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_escaped_in_files() {
        let chart = Chart {
            size: [10.0, 20.0],
            title: "<a & b>\u{1}\u{202e}".to_owned(),
            description: "\"c\"".to_owned(),
            body: text("small", [0.0, 1.0], Anchor::Start, "</text><script>"),
        };
        let svg = chart.to_svg();
        assert!(svg.contains("<title>&lt;a &amp; b&gt;  </title>"), "{svg}");
        assert!(svg.contains("<desc>&quot;c&quot;</desc>") && !svg.contains("<script"));
        assert!(svg.contains("viewBox=\"0 0 10 20\"") && svg.contains("xmlns"));
        assert!(!chart.inline().into_string().contains("xmlns"));
    }

    #[test]
    fn line_styles_are_distinct() {
        let mut styles: Vec<String> = (0..COLOURS * DASHES).map(line).collect();
        styles.sort();
        styles.dedup();
        assert_eq!(styles.len(), COLOURS * DASHES);
        assert!((0..COLOURS).all(|i| STYLE.contains(&format!(".{}{{", colour(i)))));
        // The first is solid.
        assert!((1..DASHES).all(|i| STYLE.contains(&format!(".dash-{i}{{"))));
    }
}
