//! Figures in tables.

use std::fmt::Write as _;

use super::called;
use crate::evaluate::{EvalReport, ModelEvaluation};
use crate::metrics::{BaseRateCalibration, GroupSummary, Interval, Spread, Summary};
use gripcast_report::{Esc, MISSING, fixed, open_wide, optional, put};

/// Objects that a page names.
const MOST_OBJECTS: usize = 60;

pub(super) fn summary(report: &EvalReport, out: &mut String) {
    open_wide(out, "Figures of the models");
    out.push_str(
        "<table class=\"data\"><thead><tr><th>Model<th class=\"n\">n<th class=\"n\">Accuracy\
         <th class=\"n\">Balanced accuracy<th class=\"n\">AUROC<th class=\"n\">Average precision\
         <th class=\"n\">Brier<th class=\"n\">ECE<th class=\"n\">Threshold</tr></thead><tbody>\n",
    );
    for model in &report.models {
        row(
            out,
            &called(model),
            &model.summary,
            [model.balanced_accuracy, model.auroc],
            &calibration(model),
        );
        row(out, "in contact", &model.in_contact, [None, None], "");
    }
    if let Some(over) = &report.over_models {
        put!(
            out,
            "<tr class=\"over\"><th>mean ± sd of {}<td><td class=\"n\">{}<td class=\"n\">{}\
             <td class=\"n\">{}<td class=\"n\">{}<td class=\"n\">{}<td class=\"n\">{}<td></tr>\n",
            over.seeds,
            spread(over.accuracy),
            spread(over.balanced_accuracy),
            spread(over.auroc),
            spread(over.average_precision),
            spread(over.brier),
            spread(over.ece)
        );
    }
    out.push_str("</tbody></table></div>\n");
    if let Some(model) = report.models.first() {
        confusion(model, out);
    }
    if !report.differences.is_empty() {
        open_wide(out, "Differences");
        out.push_str(
            "<table class=\"data\"><caption>Differences on the same samples</caption><thead><tr>\
             <th>First<th>Minus<th class=\"n\">Balanced accuracy<th class=\"n\">AUROC</tr></thead>\
             <tbody>\n",
        );
        for difference in &report.differences {
            put!(
                out,
                "<tr><td>{}<td>{}<td class=\"n\">{}<td class=\"n\">{}</tr>\n",
                Esc(&difference.first),
                Esc(&difference.second),
                interval(difference.balanced_accuracy),
                interval(difference.auroc)
            );
        }
        out.push_str("</tbody></table></div>\n");
    }
}

fn row(
    out: &mut String,
    name: &str,
    summary: &Summary,
    [balanced, auroc]: [Option<Interval>; 2],
    calibration: &str,
) {
    let small = |interval: Option<Interval>| {
        interval.map_or_else(String::new, |i| {
            format!("<small>{} – {}</small>", fixed(i.low, 3), fixed(i.high, 3))
        })
    };
    put!(
        out,
        "<tr><th>{}<td class=\"n\">{}<td class=\"n\">{}<td class=\"n\">{}{}<td class=\"n\">{}{}\
         <td class=\"n\">{}<td class=\"n\">{}<td class=\"n\">{}{}<td class=\"n\">{}</tr>\n",
        Esc(name),
        summary.n,
        optional(summary.accuracy, 3),
        optional(summary.balanced_accuracy, 3),
        small(balanced),
        optional(summary.auroc, 3),
        small(auroc),
        optional(summary.average_precision, 3),
        optional(summary.brier, 3),
        optional(summary.ece, 3),
        calibration,
        fixed(summary.threshold, 2)
    );
}

/// What the calibration error is to be compared with.
fn calibration(model: &ModelEvaluation) -> String {
    let mut out = String::new();
    if let Some(chance) = model.ece_by_chance {
        put!(
            out,
            "<small>by chance &lt; {}</small>",
            fixed(chance.high, 3)
        );
    }
    if let Some(found) = model.at_base_rate.filter(BaseRateCalibration::is_uneven) {
        put!(
            out,
            "<small>at base rate {}: {}</small>",
            fixed(found.base_rate, 2),
            fixed(found.ece, 3)
        );
    }
    out
}

fn confusion(model: &ModelEvaluation, out: &mut String) {
    let found = &model.summary.confusion;
    open_wide(out, "Confusion");
    put!(
        out,
        "<table class=\"data\"><caption>Confusion of {} at its threshold</caption><thead><tr><th>\
         <th class=\"n\">predicted stable<th class=\"n\">predicted lost<th class=\"n\">right</tr>\
         </thead><tbody>\n\
         <tr><th>held<td class=\"n\">{}<td class=\"n\">{}<td class=\"n\">{}</tr>\n\
         <tr><th>lost<td class=\"n\">{}<td class=\"n\">{}<td class=\"n\">{}</tr>\n\
         </tbody></table></div>\n",
        Esc(&called(model)),
        found.true_stable,
        found.false_unstable,
        percent(found.true_stable, found.n_stable()),
        found.false_stable,
        found.true_unstable,
        percent(found.true_unstable, found.n_unstable())
    );
}

fn percent(part: usize, all: usize) -> String {
    if all == 0 {
        return MISSING.to_owned();
    }
    format!("{}&nbsp;%", fixed(100.0 * part as f64 / all as f64, 1))
}

fn spread(found: Option<Spread>) -> String {
    found.map_or_else(
        || MISSING.to_owned(),
        |s| {
            let deviation = s.standard_deviation.unwrap_or(0.0);
            format!("{} ± {}", fixed(s.mean, 3), fixed(deviation, 3))
        },
    )
}

fn interval(found: Option<Interval>) -> String {
    found.map_or_else(
        || MISSING.to_owned(),
        |i| {
            format!(
                "{}<small>{} – {}</small>",
                fixed(i.estimate, 3),
                fixed(i.low, 3),
                fixed(i.high, 3)
            )
        },
    )
}

pub(super) fn groups(model: &ModelEvaluation, out: &mut String) {
    out.push_str("<div class=\"tables\">\n");
    table(out, "Category", &model.categories, model.categories.len());
    table(out, "Stopping force", &model.forces, model.forces.len());
    // The worst ones first.
    let mut objects = model.per_object.clone();
    objects.sort_by(|a, b| {
        let accuracy = |group: &GroupSummary| group.accuracy.unwrap_or(1.0);
        accuracy(a)
            .total_cmp(&accuracy(b))
            .then(a.name.cmp(&b.name))
    });
    table(out, "Object, the worst first", &objects, MOST_OBJECTS);
    out.push_str("</div>\n");
}

fn table(out: &mut String, name: &str, groups: &[GroupSummary], most: usize) {
    put!(
        out,
        "<table class=\"data\"><thead><tr><th>{name}<th class=\"n\">n<th class=\"n\">held\
         <th class=\"n\">Accuracy<th class=\"n\">AUROC</tr></thead><tbody>\n"
    );
    for group in groups.iter().take(most) {
        put!(
            out,
            "<tr><th>{}<td class=\"n\">{}<td class=\"n\">{}<td class=\"n\">{}<td class=\"n\">{}</tr>\n",
            Esc(group.name.trim()),
            group.n,
            group.stable,
            optional(group.accuracy, 2),
            optional(group.auroc, 2)
        );
    }
    out.push_str("</tbody></table>\n");
    if groups.len() > most {
        put!(
            out,
            "<p>{} more are in eval.json.</p>\n",
            groups.len() - most
        );
    }
}
