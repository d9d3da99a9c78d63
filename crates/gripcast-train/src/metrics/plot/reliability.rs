//! Reliability diagrams (Niculescu-Mizil & Caruana 2005).

use std::fmt::Write as _;

use super::super::{ReliabilityBin, ReliabilityTable};
use super::figure::{colour, figure};
use super::figure_text;
use super::frame::{ABSCISSA, Axis, Frame};
use super::legend::{self, Entry, Key};
use super::roc::{MARGIN, SIDE};
use super::text::count;
use gripcast_report::{fixed, put};

/// Height of the histogram, px.
const HISTOGRAM: f64 = 76.0;
/// Room between diagram and histogram, px.
const GAP: f64 = 20.0;

/// Share of stable grasps against predicted probability as SVG: a bar and a point for each bin,
/// the diagonal, below them how many grasps there are, and the expected calibration error.
pub fn reliability(title: &str, table: &ReliabilityTable) -> String {
    let [diagram, histogram] = frames(table);
    let mut body = String::new();
    for frame in [&diagram, &histogram] {
        frame.draw_ordinate(&mut body);
        frame.draw_verticals(&mut body);
    }
    put!(body, "<g class=\"{}\">", colour(0));
    for bin in &table.bins {
        draw_bar(&mut body, &diagram, bin, bin.stable_share.unwrap_or(0.0));
        draw_bar(&mut body, &histogram, bin, bin.n as f64);
    }
    diagram.draw_edges(&mut body);
    histogram.draw_edges(&mut body);
    diagram.draw_guide(&mut body, [0.0, 0.0], [1.0, 1.0]);
    for bin in &table.bins {
        draw_point(&mut body, &diagram, bin);
    }
    put!(body, "</g>");
    histogram.draw_abscissa(&mut body);
    let verdict = match table.n() {
        0 => "No grasps".to_owned(),
        n => {
            let ece = figure_text("ECE", table.expected_calibration_error(), None);
            format!("{ece} over {} grasps", count(n))
        }
    };
    let entries = [
        Entry::new(Key::PointedBar(0), "Grasps of a bin"),
        Entry::new(Key::Guide, "Perfect calibration"),
        Entry::new(Key::Nothing, verdict.as_str()),
    ];
    let description = format!("Reliability diagram of the stability prediction. {verdict}.");
    let top = histogram.bottom + ABSCISSA + 4.0;
    let room = histogram.right - 8.0;
    let height = legend::draw(&mut body, [8.0, top], room, &entries);
    let size = [histogram.right + MARGIN, top + height + 4.0];
    figure(size, title, &description, &body)
}

/// Frames of the diagram and the histogram, one above the other.
fn frames(table: &ReliabilityTable) -> [Frame<'static>; 2] {
    let highest = table.bins.iter().map(|bin| bin.n).max().unwrap_or(0);
    let shares = Axis::of_shares("Share of grasps that are stable");
    let counts = Axis::of_counts("Grasps", highest);
    let left = shares.room().max(counts.room());
    let frame = |top: f64, height: f64, ordinate| Frame {
        left,
        right: left + SIDE,
        top,
        bottom: top + height,
        abscissa: Axis::of_shares("Predicted probability of stable"),
        ordinate,
    };
    [
        frame(MARGIN, SIDE, shares),
        frame(MARGIN + SIDE + GAP, HISTOGRAM, counts),
    ]
}

fn draw_bar(out: &mut String, frame: &Frame<'_>, bin: &ReliabilityBin, value: f64) {
    let (left, right, top) = (frame.x(bin.low), frame.x(bin.high), frame.y(value));
    if bin.n == 0 || !(right > left && top < frame.bottom) {
        return;
    }
    put!(
        out,
        "<rect class=\"pale\" x=\"{:.1}\" y=\"{top:.1}\" width=\"{:.1}\" height=\"{:.1}\">{}</rect>",
        left + 1.0,
        (right - left - 2.0).max(0.5),
        frame.bottom - top,
        tooltip(bin)
    );
}

fn draw_point(out: &mut String, frame: &Frame<'_>, bin: &ReliabilityBin) {
    if let (Some(mean_p), Some(stable_share)) = (bin.mean_p, bin.stable_share) {
        let [x, y] = frame.place([mean_p, stable_share]);
        put!(
            out,
            "<circle class=\"point\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"4\">{}</circle>",
            tooltip(bin)
        );
    }
}

fn tooltip(bin: &ReliabilityBin) -> String {
    let number = |value: Option<f64>| gripcast_report::optional(value, 3);
    format!(
        "<title>{}–{}: {} grasps, mean probability {}, share stable {}</title>",
        fixed(bin.low, 3),
        fixed(bin.high, 3),
        bin.n,
        number(bin.mean_p),
        number(bin.stable_share)
    )
}
