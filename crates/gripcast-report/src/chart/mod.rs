//! Charts as SVG: panels with axes, marks in them, legends.
//!
//! A chart stands in a page, which has its style, or in a file of its own. Colours are the page's
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
pub use text::{Anchor, NORMAL, SMALL, count, fitted, text, upright, width, wrapped};

/// Style of every chart.
pub(crate) const STYLE: &str = include_str!("style.css");

/// Colours that tell series apart.
const COLOURS: usize = 6;
/// Dashes that tell lines apart where colours do not.
const DASHES: usize = 4;

/// A chart that is drawn.
pub struct Chart {
    /// Width and height, px.
    pub size: [f64; 2],
    /// Its accessible name.
    pub title: String,
    /// What it shows, in words.
    pub description: String,
    /// The drawing.
    pub body: Markup,
}

impl Chart {
    /// The chart as a part of a page.
    pub fn inline(&self) -> Markup {
        self.svg(None, html! {})
    }

    /// The chart as a file of its own.
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

/// Class of the colour of a series.
pub fn colour(series: usize) -> String {
    format!("series-{}", series % COLOURS)
}

/// Classes of the line of a series.
pub fn line(series: usize) -> String {
    // Colours that come again get another dash.
    let dash = (series + series / COLOURS) % DASHES;
    format!("curve {} dash-{dash}", colour(series))
}

/// A length or place in px, short.
fn px(value: f64) -> String {
    // Adding 0 makes -0 to 0.
    format!("{}", (10.0 * value).round() / 10.0 + 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_cannot_break_out_of_a_file() {
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
    fn many_lines_differ() {
        let mut looks: Vec<String> = (0..COLOURS * DASHES).map(line).collect();
        looks.sort();
        looks.dedup();
        assert_eq!(looks.len(), COLOURS * DASHES);
        assert!((0..COLOURS).all(|i| STYLE.contains(&format!(".{}{{", colour(i)))));
        // The first is solid.
        assert!((1..DASHES).all(|i| STYLE.contains(&format!(".dash-{i}{{"))));
    }
}
