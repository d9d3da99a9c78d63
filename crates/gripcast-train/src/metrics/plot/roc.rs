//! ROC curves.

use super::super::{Interval, Ranking, RocPoint, Scored};
use super::figure::{figure, line, polyline};
use super::figure_text;
use super::frame::{ABSCISSA, Axis, Frame};
use super::legend::{self, Entry, Key};

/// Side of the area in which curves are drawn, px.
pub(super) const SIDE: f64 = 330.0;
/// Room above and beside the frame for halves of numbers, px.
pub(super) const MARGIN: f64 = 14.0;

/// The ROC curve of a model.
#[derive(Clone, Debug, PartialEq)]
pub struct RocCurve {
    /// What the legend calls it.
    pub name: String,
    /// Its points.
    pub points: Vec<RocPoint>,
    /// Area under it.
    pub auroc: Option<f64>,
    /// 95 % interval of the area.
    pub interval: Option<[f64; 2]>,
}

impl RocCurve {
    /// Curve and area of samples, without an interval.
    pub fn new(name: &str, samples: &[Scored]) -> Self {
        let ranking = Ranking::new(samples);
        Self {
            name: name.to_owned(),
            points: ranking.roc_curve(),
            auroc: ranking.auroc(),
            interval: None,
        }
    }

    /// With the interval of its area.
    #[must_use]
    pub fn with_interval(mut self, interval: Option<Interval>) -> Self {
        self.interval = interval.map(|interval| [interval.low, interval.high]);
        self
    }
}

/// ROC curves of one or more models as SVG, with the areas in the legend.
pub fn roc(title: &str, curves: &[RocCurve]) -> String {
    let frame = square(
        "False positive rate (unstable predicted stable)",
        "True positive rate (stable predicted stable)",
    );
    let mut body = String::new();
    frame.draw_ordinate(&mut body);
    frame.draw_verticals(&mut body);
    frame.draw_abscissa(&mut body);
    frame.draw_edges(&mut body);
    frame.draw_guide(&mut body, [0.0, 0.0], [1.0, 1.0]);
    let mut entries = Vec::new();
    for (series, curve) in curves.iter().enumerate() {
        let places = curve
            .points
            .iter()
            .map(|p| frame.place([p.false_stable_rate, p.true_stable_rate]));
        polyline(&mut body, &line(series), places);
        entries.push(Entry {
            key: Key::Line(series),
            name: curve.name.clone(),
            figures: figure_text("AUROC", curve.auroc, curve.interval),
        });
    }
    let description = described("ROC curves of the stability prediction.", &entries);
    entries.push(Entry {
        key: Key::Guide,
        name: "Chance".to_owned(),
        figures: "AUROC 0.500".to_owned(),
    });
    finished(&frame, title, &description, body, &entries)
}

/// A square frame of shares.
pub(super) fn square<'a>(abscissa: &'a str, ordinate: &'a str) -> Frame<'a> {
    let ordinate = Axis::of_shares(ordinate);
    let left = ordinate.room();
    Frame {
        left,
        right: left + SIDE,
        top: MARGIN,
        bottom: MARGIN + SIDE,
        abscissa: Axis::of_shares(abscissa),
        ordinate,
    }
}

/// What a figure shows, followed by the names and figures of its legend.
pub(super) fn described(what: &str, entries: &[Entry]) -> String {
    entries.iter().fold(what.to_owned(), |text, entry| {
        format!("{text} {}: {}.", entry.name, entry.figures)
    })
}

/// The figure with its legend below the frame.
pub(super) fn finished(
    frame: &Frame<'_>,
    title: &str,
    description: &str,
    mut body: String,
    entries: &[Entry],
) -> String {
    let top = frame.bottom + ABSCISSA + 4.0;
    let left = 8.0;
    let height = legend::draw(&mut body, [left, top], frame.right - left, entries);
    let size = [frame.right + MARGIN, top + height + 4.0];
    figure(size, title, description, &body)
}
