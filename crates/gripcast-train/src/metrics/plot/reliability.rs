//! Reliability diagrams (Niculescu-Mizil & Caruana 2005).

use super::super::{ReliabilityBin, ReliabilityTable};
use super::{metric_text, square, with_legend};
use gripcast_report::chart::{Axis, Chart, Entry, Key, Panel, count};
use gripcast_report::{fixed, optional};
use maud::{Markup, html};

/// Height of the histogram, px.
const HISTOGRAM: f64 = 76.0;
/// Room between diagram and histogram, px.
const GAP: f64 = 20.0;

/// Fraction of stable grasps against predicted probability: a bar and a point for each bin, the
/// diagonal, below them how many grasps there are, and the expected calibration error.
pub fn reliability(title: &str, table: &ReliabilityTable) -> Chart {
    let (diagram, histogram) = panels(table);
    let body = html! {
        (diagram.grid())
        (histogram.grid())
        @for bin in table.bins.iter().filter(|bin| bin.n > 0) {
            g {
                title { (tooltip(bin)) }
                (bar(&diagram, bin, bin.stable_fraction.unwrap_or(0.0)))
                (bar(&histogram, bin, bin.n as f64))
            }
        }
        (diagram.edges())
        (histogram.edges())
        (diagram.guide([0.0, 0.0], [1.0, 1.0]))
        @for bin in &table.bins {
            @if let (Some(mean_p), Some(stable)) = (bin.mean_p, bin.stable_fraction) {
                g {
                    title { (tooltip(bin)) }
                    (diagram.dot("point series-0", [mean_p, stable], 4.0))
                }
            }
        }
    };
    let verdict = match table.n() {
        0 => "No grasps".to_owned(),
        n => {
            let ece = metric_text("ECE", table.expected_calibration_error(), None);
            format!("{ece} over {} grasps", count(n))
        }
    };
    let entries = [
        Entry::new(Key::PointedBar("series-0".to_owned()), "Grasps of a bin"),
        Entry::new(Key::Line("guide".to_owned()), "Perfect calibration"),
        Entry::new(Key::None, verdict.as_str()),
    ];
    let description = format!("Reliability diagram of the stability prediction. {verdict}.");
    let corner = [histogram.right, histogram.bottom + Panel::ABSCISSA + 4.0];
    with_legend(title, description, corner, body, &entries)
}

/// The diagram and the histogram below it.
fn panels(table: &ReliabilityTable) -> (Panel, Panel) {
    let highest = table.bins.iter().map(|bin| bin.n).max().unwrap_or(0);
    let counts = Axis::counts("Grasps", highest);
    let mut diagram = square(
        "Predicted probability of stable",
        "Fraction of grasps that are stable",
    );
    let shift = (counts.width_px() - diagram.left).max(0.0);
    diagram.left += shift;
    diagram.right += shift;
    let histogram = Panel {
        top: diagram.bottom + GAP,
        bottom: diagram.bottom + GAP + HISTOGRAM,
        x: diagram.x.clone(),
        y: counts,
        ..diagram
    };
    diagram.x = diagram.x.without_labels();
    (diagram, histogram)
}

fn bar(panel: &Panel, bin: &ReliabilityBin, value: f64) -> Markup {
    // A little room between bars.
    let gap = 0.06 * (bin.high - bin.low);
    panel.area(
        "pale series-0",
        [bin.low + gap, bin.high - gap],
        [0.0, value],
    )
}

fn tooltip(bin: &ReliabilityBin) -> String {
    format!(
        "{}–{}: {} grasps, mean probability {}, fraction stable {}",
        fixed(bin.low, 3),
        fixed(bin.high, 3),
        bin.n,
        optional(bin.mean_p, 3),
        optional(bin.stable_fraction, 3)
    )
}
