//! Precision–recall curves of the stable class.

use super::super::{Interval, PrecisionRecallPoint, Ranking, Scored};
use super::figure::{line, polyline};
use super::figure_text;
use super::legend::{Entry, Key};
use super::roc::{described, finished, square};
use gripcast_report::fixed;

/// The precision–recall curve of a model.
#[derive(Clone, Debug, PartialEq)]
pub struct PrecisionRecallCurve {
    /// What the legend calls it.
    pub name: String,
    /// Its points.
    pub points: Vec<PrecisionRecallPoint>,
    /// Average precision.
    pub average_precision: Option<f64>,
    /// 95 % interval of the average precision.
    pub interval: Option<[f64; 2]>,
}

impl PrecisionRecallCurve {
    /// Curve and average precision of samples, without an interval.
    pub fn new(name: &str, samples: &[Scored]) -> Self {
        let ranking = Ranking::new(samples);
        Self {
            name: name.to_owned(),
            points: ranking.precision_recall_curve(),
            average_precision: ranking.average_precision(),
            interval: None,
        }
    }

    /// With the interval of its average precision.
    #[must_use]
    pub fn with_interval(mut self, interval: Option<Interval>) -> Self {
        self.interval = interval.map(|interval| [interval.low, interval.high]);
        self
    }
}

/// Precision–recall curves of one or more models on the same samples as SVG, with average
/// precisions (AP) in the legend. `stable_share` is the share of stable samples, the precision of
/// chance.
pub fn precision_recall(
    title: &str,
    curves: &[PrecisionRecallCurve],
    stable_share: Option<f64>,
) -> String {
    let frame = square(
        "Recall of the stable class",
        "Precision of the stable class",
    );
    let mut body = String::new();
    frame.draw_ordinate(&mut body);
    frame.draw_verticals(&mut body);
    frame.draw_abscissa(&mut body);
    frame.draw_edges(&mut body);
    let chance = stable_share.filter(|share| share.is_finite());
    if let Some(share) = chance {
        frame.draw_guide(&mut body, [0.0, share], [1.0, share]);
    }
    let mut entries = Vec::new();
    for (series, curve) in curves.iter().enumerate() {
        let points = curve.points.iter();
        let places = points.map(|p| frame.place([p.recall, p.precision]));
        polyline(&mut body, &line(series), places);
        entries.push(Entry {
            key: Key::Line(series),
            name: curve.name.clone(),
            figures: figure_text("AP", curve.average_precision, curve.interval),
        });
    }
    let what = "Precision–recall curves of the stability prediction.";
    let description = described(what, &entries);
    if let Some(share) = chance {
        entries.push(Entry {
            key: Key::Guide,
            name: "Chance".to_owned(),
            figures: format!("AP {}", fixed(share, 3)),
        });
    }
    finished(&frame, title, &description, body, &entries)
}
