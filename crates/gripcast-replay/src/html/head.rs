//! Summary: agreement in one sentence, intervals as a chart, and facts about the replay.

use super::Page;
use super::text::{fraction, interval, p_value};
use crate::report::{EngineFacts, Proportion, Scores};
use gripcast_report::chart::{Anchor, Axis, Chart, Panel, colour, text};
use gripcast_report::page::definitions;
use gripcast_report::{MISSING, duration, engine_name};
use maud::{Markup, html};

/// A method to choose the setting.
pub(super) struct Method {
    pub(super) name: &'static str,
    pub(super) description: &'static str,
    pub(super) score: fn(&Scores) -> &crate::report::Score,
}

/// All methods, the paper's first.
pub(super) const METHODS: [Method; 4] = [
    Method {
        name: "The paper’s choice",
        description: "best shared friction, best force for each object, chosen on the scored grasps",
        score: |scores| &scores.paper,
    },
    Method {
        name: "Leave one grasp out",
        description: "the same choice without the scored grasp",
        score: |scores| &scores.leave_one_out,
    },
    Method {
        name: "One setting",
        description: "best friction and force for all objects together, chosen on the scored grasps",
        score: |scores| &scores.one_setting,
    },
    Method {
        name: "Leave one object out",
        description: "one setting, chosen without the scored object",
        score: |scores| &scores.leave_object_out,
    },
];

pub(super) fn verdict(page: &Page<'_>) -> Markup {
    let report = page.report;
    html! {
        section id="verdict" {
            h1 {
                "Replay of " (report.dataset.name) ": does simulation agree with "
                (page.reality()) ", grasp by grasp?"
            }
            (page.banner())
            @if report.engines.is_empty() {
                p.verdict { "No engine was run." }
            } @else {
                (sentence(page))
                (without_bias(page))
                figure { (forest(&report.engines).inline()) }
            }
            (facts(page))
        }
    }
}

fn sentence(page: &Page<'_>) -> Markup {
    html! {
        p.verdict {
            @for (i, engine) in page.report.engines.iter().enumerate() {
                @let all = &engine.scores.paper.all;
                @if i > 0 { "; " }
                b { (engine_name(&engine.name)) }
                " agree with " (page.reality()) " on " b { (all.agree) " of " (all.n) }
                " grasps (" (fraction(all)) ", 95\u{a0}% interval " (interval(all)) ")"
            }
            @if let Some(comparison) = &page.report.comparison {
                "; only finite elements agree on " (comparison.only_fem)
                " grasps, only rigid bodies on " (comparison.only_rigid)
                " (exact McNemar " (p_value(comparison.mcnemar_p)) ")"
            }
            "."
        }
    }
}

fn without_bias(page: &Page<'_>) -> Markup {
    let without: usize = page.report.engines.iter().map(|e| e.without_outcome).sum();
    html! {
        p {
            "With the setting chosen without the scored grasp: "
            @for (i, engine) in page.report.engines.iter().enumerate() {
                @let all = &engine.scores.leave_one_out.all;
                @if i > 0 { ", " }
                (engine_name(&engine.name).to_lowercase()) " " (all.agree) " of " (all.n)
                " (" (fraction(all)) ", " (interval(all)) ")"
            }
            @if let Some(comparison) = &page.report.comparison { "; " (p_value(comparison.leave_one_out_p)) }
            "."
            @if without > 0 {
                " " (without) " "
                @if without == 1 { "case at a chosen setting is" }
                @else { "cases at a chosen setting are" }
                " without an outcome and not counted."
            }
        }
    }
}

/// Chart of the fraction and interval of each method, by engine.
fn forest(engines: &[EngineFacts]) -> Chart {
    const ROW: f64 = 16.0;
    const GAP: f64 = 8.0;
    const TOP: f64 = 4.0;
    let group = ROW * engines.len() as f64 + GAP;
    let height = group * METHODS.len() as f64;
    let panel = Panel {
        left: 250.0,
        right: 620.0,
        top: TOP,
        bottom: TOP + height,
        x: Axis::new("fraction of grasps that agree", [0.0, 1.0], 5.0),
        // In px, downwards.
        y: Axis::pixels(height),
    };
    let row = |method: usize, engine: usize| {
        height - group * method as f64 - 0.5 * GAP - ROW * (engine as f64 + 0.5)
    };
    let label = |x: f64, y: f64, anchor: Anchor, words: &str| {
        text("small", [x, panel.bottom - y + 4.0], anchor, words)
    };
    let body = html! {
        (panel.grid())
        @for (k, method) in METHODS.iter().enumerate() {
            (label(0.0, row(k, 0), Anchor::Start, method.name))
            @for (i, engine) in engines.iter().enumerate() {
                @let (y, p) = (row(k, i), &(method.score)(&engine.scores).all);
                (label(panel.left - 10.0, y, Anchor::End, engine_name(&engine.name)))
                @if is_defined(p) {
                    @let class = format!("interval {}", colour(i));
                    (panel.whisker(&class, [[p.low, y], [p.high, y]]))
                    (panel.marker(i, [p.fraction, y]))
                    @let words = format!("{}  [{}]", fraction(p), interval(p));
                    (label(panel.right + 10.0, y, Anchor::Start, &words))
                } @else {
                    (label(panel.right + 10.0, y, Anchor::Start, MISSING))
                }
            }
        }
        (panel.edges())
    };
    Chart {
        size: [750.0, panel.bottom + Panel::ABSCISSA],
        title: "Fraction of grasps that agree, with 95 % intervals".to_owned(),
        description: "The numbers are in the last column of Table 1.".to_owned(),
        body,
    }
}

fn is_defined(p: &Proportion) -> bool {
    p.n > 0 && [p.low, p.high, p.fraction].iter().all(|v| v.is_finite())
}

fn facts(page: &Page<'_>) -> Markup {
    let (report, dataset) = (page.report, &page.report.dataset);
    let cpu: f64 = report.cost.cpu_s.values().sum();
    definitions(
        "facts",
        &[
            ("Dataset", &dataset.name),
            ("Path", &html! { code { (dataset.path) } }),
            (
                "SHA-256 of the records",
                &html! { code { (dataset.sha256) } },
            ),
            (
                "Grasps",
                &format!(
                    "{} in the dataset, {} replayed, {} left out",
                    dataset.grasps,
                    report.grasps.len(),
                    // Grasps that were not replayed at all.
                    dataset.grasps.saturating_sub(report.grasps.len())
                ),
            ),
            ("Seed", &report.seed),
            ("Software", &report.software),
            ("Written", &report.written_at),
            ("Processor", &report.cost.processor),
            (
                "Cases",
                &format!("{}, {} of CPU time", report.cost.cases, duration(cpu)),
            ),
        ],
    )
}
