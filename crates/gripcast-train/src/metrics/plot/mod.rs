//! Figures as SVG: ROC, precision–recall and reliability diagrams, bar charts.
//!
//! Long names are shortened; tooltips show the full names.

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

/// Side of the curve panel, px.
const SIDE: f64 = 330.0;
/// Margin for overhanging axis numbers, px.
const MARGIN: f64 = 14.0;

/// Returns a square panel of fractions.
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

/// Returns a chart with a legend below the drawing, starting at `top`.
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

/// Formats `AUROC 0.912` with its interval, if any.
fn metric_text(name: &str, value: Option<f64>, interval: Option<[f64; 2]>) -> String {
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
