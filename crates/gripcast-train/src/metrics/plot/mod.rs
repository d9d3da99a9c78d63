//! Figures as SVG: ROC, precision–recall and reliability diagrams, bar charts.
//!
//! Names are shortened where the room ends, and complete in tooltips.

mod bars;
mod curves;
#[cfg(test)]
mod figures_test;
mod reliability;

pub use bars::{Bar, BarChart, BarGroup, Reference, bars};
pub use curves::{ModelCurve, precision_recall, roc};
pub use reliability::reliability;

use gripcast_report::chart::{Axis, Chart, Entry, Legend, Panel};
use gripcast_report::fixed;
use maud::{Markup, html};

/// Side of the panel in which curves are drawn, px.
const SIDE: f64 = 330.0;
/// Room above and beside a panel for halves of numbers, px.
const MARGIN: f64 = 14.0;

/// A square panel of fractions.
fn square(abscissa: &str, ordinate: &str) -> Panel {
    let y = Axis::fractions(ordinate);
    let left = y.width_px();
    Panel {
        left,
        right: left + SIDE,
        top: MARGIN,
        bottom: MARGIN + SIDE,
        x: Axis::fractions(abscissa),
        y,
    }
}

/// The chart of a drawing with its legend below it, which begins at `top`.
fn with_legend(
    title: &str,
    description: String,
    [right, top]: [f64; 2],
    body: Markup,
    entries: &[Entry],
) -> Chart {
    const LEFT: f64 = 8.0;
    let legend = Legend::new([LEFT, top], right - LEFT, entries);
    Chart {
        size: [right + MARGIN, top + legend.height + 4.0],
        title: title.to_owned(),
        description,
        body: html! { (body) (legend.body) },
    }
}

/// `AUROC 0.912`, with its interval if there is one, or that it is undefined.
fn figure_text(name: &str, value: Option<f64>, interval: Option<[f64; 2]>) -> String {
    match (value, interval) {
        (None, _) => format!("{name} undefined"),
        (Some(value), None) => format!("{name} {}", fixed(value, 3)),
        (Some(value), Some([low, high])) => format!(
            "{name} {} [{}, {}]",
            fixed(value, 3),
            fixed(low, 3),
            fixed(high, 3)
        ),
    }
}
