//! ROC and precision–recall curves.

use super::super::{Interval, Ranking, Scored};
use super::{metric_text, square, with_legend};
use gripcast_report::chart::{Chart, Entry, Key, Panel, line};
use maud::html;

/// Curves of a model.
pub struct ModelCurve {
    /// Name in the legend.
    name: String,
    ranking: Ranking,
    /// 95 % interval of its AUROC.
    auroc: Option<Interval>,
}

impl ModelCurve {
    /// Creates the curves of a model; `auroc` is the interval of its AUROC, if known.
    pub fn new(name: &str, samples: &[Scored], auroc: Option<Interval>) -> Self {
        Self {
            name: name.to_owned(),
            ranking: Ranking::new(samples),
            auroc,
        }
    }
}

/// Draws the ROC curves of one or more models, with AUROCs in the legend.
pub fn roc(curves: &[ModelCurve]) -> Chart {
    let series = curves.iter().map(|curve| {
        let points = curve.ranking.roc_curve().into_iter();
        let interval = curve.auroc.map(|interval| [interval.low, interval.high]);
        Series {
            name: &curve.name,
            points: points
                .map(|p| [p.false_stable_rate, p.true_stable_rate])
                .collect(),
            figures: metric_text("AUROC", curve.ranking.auroc(), interval),
        }
    });
    let panel = square(
        "False positive rate (slip predicted stable)",
        "True positive rate (stable predicted stable)",
    );
    let chance = Chance {
        ends: [[0.0, 0.0], [1.0, 1.0]],
        figures: metric_text("AUROC", Some(0.5), None),
    };
    let title = "Receiver operating characteristic";
    let what = "ROC curves of the stability prediction.";
    chart(
        title,
        what,
        &panel,
        &series.collect::<Vec<_>>(),
        Some(chance),
    )
}

/// Draws the precision–recall curves of one or more models on the same samples, with average
/// precisions (AP) in the legend. `stable` is the fraction of stable samples (chance level).
pub fn precision_recall(curves: &[ModelCurve], stable: Option<f64>) -> Chart {
    let series = curves.iter().map(|curve| {
        let points = curve.ranking.precision_recall_curve().into_iter();
        Series {
            name: &curve.name,
            points: points.map(|p| [p.recall, p.precision]).collect(),
            figures: metric_text("AP", curve.ranking.average_precision(), None),
        }
    });
    let panel = square(
        "Recall of the stable class",
        "Precision of the stable class",
    );
    let stable = stable.filter(|fraction| fraction.is_finite());
    let chance = stable.map(|fraction| Chance {
        ends: [[0.0, fraction], [1.0, fraction]],
        figures: metric_text("AP", stable, None),
    });
    let what = "Precision–recall curves of the stability prediction.";
    let series: Vec<Series<'_>> = series.collect();
    chart("Precision and recall", what, &panel, &series, chance)
}

/// A curve and its legend text.
struct Series<'a> {
    name: &'a str,
    points: Vec<[f64; 2]>,
    figures: String,
}

/// The line of a model that guesses.
struct Chance {
    ends: [[f64; 2]; 2],
    figures: String,
}

fn chart(
    title: &str,
    what: &str,
    panel: &Panel,
    series: &[Series<'_>],
    chance: Option<Chance>,
) -> Chart {
    let body = html! {
        (panel.grid())
        (panel.edges())
        @if let Some(Chance { ends: [from, to], .. }) = &chance {
            (panel.guide(*from, *to))
        }
        @for (i, one) in series.iter().enumerate() {
            (panel.line(&line(i), one.points.iter().copied()))
        }
    };
    let mut description = what.to_owned();
    let mut entries = Vec::new();
    for (i, one) in series.iter().enumerate() {
        description.push_str(&format!(" {}: {}.", one.name, one.figures));
        entries.push(Entry {
            key: Key::Line(line(i)),
            name: one.name.to_owned(),
            figures: one.figures.clone(),
        });
    }
    entries.extend(chance.map(|chance| Entry {
        key: Key::Line("guide".to_owned()),
        name: "Chance".to_owned(),
        figures: chance.figures,
    }));
    let corner = [panel.right, panel.bottom + Panel::ABSCISSA + 4.0];
    with_legend(title, description, corner, body, &entries)
}
