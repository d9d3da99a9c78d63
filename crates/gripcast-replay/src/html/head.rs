//! The verdict: one sentence with numbers, the intervals as a picture, and what was replayed.

use std::fmt::Write as _;

use super::plot::Panel;
use super::text::{Esc, MISSING, duration, engine_name, fixed, interval, p_value, share};
use super::{Page, put};
use crate::report::{EngineFacts, Proportion, Scores};

/// A way to choose the setting.
pub(super) struct Way {
    pub(super) name: &'static str,
    pub(super) how: &'static str,
    pub(super) score: fn(&Scores) -> &crate::report::Score,
}

/// All ways, the paper's first.
pub(super) const WAYS: [Way; 4] = [
    Way {
        name: "The paper’s way",
        how: "best shared friction, best force for each object, chosen on the grasps that are \
              scored",
        score: |scores| &scores.paper,
    },
    Way {
        name: "Leave one grasp out",
        how: "the same choice without the grasp that is scored",
        score: |scores| &scores.leave_one_out,
    },
    Way {
        name: "One setting",
        how: "best friction and force for all objects together, chosen on the grasps that are \
              scored",
        score: |scores| &scores.one_setting,
    },
    Way {
        name: "Leave one object out",
        how: "one setting, chosen without the object that is scored",
        score: |scores| &scores.leave_object_out,
    },
];

pub(super) fn verdict(page: &Page<'_>, out: &mut String) {
    let report = page.report;
    put!(
        out,
        "<section id=\"verdict\">\n<h1>Replay of {}: does simulation agree with {}, grasp by \
         grasp?</h1>\n",
        Esc(&report.dataset.name),
        page.reality()
    );
    page.banner(out);
    sentence(page, out);
    without_bias(page, out);
    if !report.engines.is_empty() {
        forest(page, out);
    }
    facts(page, out);
    out.push_str("</section>\n");
}

fn sentence(page: &Page<'_>, out: &mut String) {
    let report = page.report;
    out.push_str("<p class=\"verdict\">");
    if report.engines.is_empty() {
        out.push_str("No engine was run.</p>\n");
        return;
    }
    for (i, engine) in report.engines.iter().enumerate() {
        let all = &engine.scores.paper.all;
        let separator = if i == 0 { "" } else { "; " };
        put!(
            out,
            "{separator}<b>{}</b> agree with {} on <b>{} of {}</b> grasps ({}, 95&nbsp;% \
             interval {})",
            Esc(engine_name(&engine.name)),
            page.reality(),
            all.agree,
            all.n,
            share(all),
            interval(all)
        );
    }
    if let Some(duel) = &report.duel {
        put!(
            out,
            "; of the grasps where only one is right, {} go to finite elements and {} to rigid \
             bodies (exact McNemar {})",
            duel.only_fem,
            duel.only_rigid,
            p_value(duel.mcnemar_p)
        );
    }
    out.push_str(".</p>\n");
}

fn without_bias(page: &Page<'_>, out: &mut String) {
    let report = page.report;
    if report.engines.is_empty() {
        return;
    }
    out.push_str("<p>With the setting chosen without the grasp that is scored: ");
    for (i, engine) in report.engines.iter().enumerate() {
        let all = &engine.scores.leave_one_out.all;
        put!(
            out,
            "{}{} {} of {} ({}, {})",
            if i == 0 { "" } else { ", " },
            Esc(&engine_name(&engine.name).to_lowercase()),
            all.agree,
            all.n,
            share(all),
            interval(all)
        );
    }
    if let Some(duel) = &report.duel {
        put!(out, "; {}", p_value(duel.leave_one_out_p));
    }
    out.push('.');
    let without: usize = report.engines.iter().map(|e| e.without_outcome).sum();
    if without > 0 {
        put!(
            out,
            " {without} {} without outcome and not counted.",
            if without == 1 {
                "case at a chosen setting is"
            } else {
                "cases at a chosen setting are"
            }
        );
    }
    out.push_str("</p>\n");
}

/// Every way's share with its interval, by engine.
fn forest(page: &Page<'_>, out: &mut String) {
    const ROW: f64 = 15.0;
    let engines = &page.report.engines;
    let rows = (WAYS.len() * engines.len()) as f64;
    let bottom = 6.0 + ROW * rows + 6.0 * (WAYS.len() as f64 - 1.0) + 4.0;
    let panel = Panel::new([220.0, 620.0, 2.0, bottom], [0.0, 1.0], [0.0, 1.0]);
    put!(
        out,
        "<figure><svg class=\"forest\" viewBox=\"0 0 740 {:.0}\" role=\"img\" \
         aria-label=\"Share of grasps that agree, with 95 % intervals; the numbers are in the \
         last column of Table 1\">",
        bottom + 26.0
    );
    panel.abscissa(out, "share of grasps that agree", 5.0);
    let mut y = 6.0 + 0.5 * ROW;
    for way in &WAYS {
        put!(
            out,
            "<text class=\"way\" x=\"0\" y=\"{:.1}\">{}</text>",
            y + 3.5,
            way.name
        );
        for (i, engine) in engines.iter().enumerate() {
            whisker(out, &panel, y, i, engine, &(way.score)(&engine.scores).all);
            y += ROW;
        }
        y += 6.0;
    }
    out.push_str("</svg></figure>\n");
}

fn whisker(
    out: &mut String,
    panel: &Panel,
    y: f64,
    i: usize,
    engine: &EngineFacts,
    p: &Proportion,
) {
    put!(
        out,
        "<text class=\"who\" x=\"212\" y=\"{:.1}\">{}</text>",
        y + 3.5,
        Esc(engine_name(&engine.name))
    );
    if p.n == 0 || !(p.low.is_finite() && p.high.is_finite() && p.share.is_finite()) {
        put!(
            out,
            "<text class=\"num\" x=\"628\" y=\"{:.1}\">{MISSING}</text>",
            y + 3.5
        );
        return;
    }
    let (low, high, x) = (panel.x(p.low), panel.x(p.high), panel.x(p.share));
    put!(
        out,
        "<path class=\"whisker e{}\" d=\"M{low:.1} {y:.1}H{high:.1}M{low:.1} {:.1}v6M{high:.1} \
         {:.1}v6\"/>",
        i % 3,
        y - 3.0,
        y - 3.0
    );
    // Shapes tell the engines apart where colours do not.
    match i % 2 {
        0 => put!(
            out,
            "<circle class=\"e{}\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"4\"/>",
            i % 3
        ),
        _ => put!(
            out,
            "<rect class=\"e{}\" x=\"{:.1}\" y=\"{:.1}\" width=\"7\" height=\"7\"/>",
            i % 3,
            x - 3.5,
            y - 3.5
        ),
    }
    put!(
        out,
        "<text class=\"num\" x=\"628\" y=\"{:.1}\">{}  [{}]</text>",
        y + 3.5,
        fixed(p.share, 2),
        interval(p)
    );
}

fn facts(page: &Page<'_>, out: &mut String) {
    let report = page.report;
    let dataset = &report.dataset;
    out.push_str("<dl class=\"facts\">\n");
    let mut fact = |name: &str, value: String| {
        put!(out, "<div><dt>{name}</dt><dd>{value}</dd></div>\n");
    };
    fact("Dataset", format!("{}", Esc(&dataset.name)));
    fact("at", format!("<code>{}</code>", Esc(&dataset.path)));
    fact(
        "SHA-256 of the records",
        format!("<code>{}</code>", Esc(&dataset.sha256)),
    );
    fact(
        "Grasps",
        format!(
            "{} in the dataset, {} replayed, {} left out",
            dataset.grasps,
            report.grasps.len(),
            left_out_grasps(page)
        ),
    );
    fact("Seed", report.seed.to_string());
    fact("Software", format!("{}", Esc(&report.software)));
    fact("Written", format!("{}", Esc(&report.written_at)));
    fact("Processor", format!("{}", Esc(&report.cost.processor)));
    let cpu: f64 = report.cost.cpu_s.values().sum();
    fact(
        "Cases",
        format!("{}, {} of CPU time", report.cost.cases, duration(cpu)),
    );
    out.push_str("</dl>\n");
}

/// Grasps of the dataset that were not replayed at all.
fn left_out_grasps(page: &Page<'_>) -> usize {
    let total = page.report.dataset.grasps;
    total.saturating_sub(page.report.grasps.len())
}
