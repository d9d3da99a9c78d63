//! Figures as SVG strings: ROC, precision–recall and reliability diagrams, bar charts.
//!
//! A figure stands in a page or alone. Its colours are the page's variables `--ink`, `--line`,
//! `--paper` and `--series-0` to `--series-5`; without them it follows the page's `color-scheme`.
//! Names are escaped, shortened where the room ends, and complete in tooltips.

mod bars;
mod figure;
#[cfg(test)]
mod figures_test;
mod frame;
#[cfg(test)]
mod layout_test;
mod legend;
mod precision_recall;
mod reliability;
mod roc;
mod text;

pub use bars::{Bar, BarChart, BarGroup, Reference, bars};
pub use precision_recall::{PrecisionRecallCurve, precision_recall};
pub use reliability::reliability;
pub use roc::{RocCurve, roc};

use gripcast_report::fixed;

/// `0.912`, with its interval if there is one, or that it is undefined.
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
