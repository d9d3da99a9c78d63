//! Tables of the evaluation report.

use super::display_name;
use crate::evaluate::{EvalReport, ModelEvaluation};
use crate::metrics::{BaseRateCalibration, GroupSummary, Interval, Spread, Summary};
use gripcast_report::page::{Table, number, text};
use gripcast_report::{MISSING, fixed, optional};
use maud::{Markup, Render, html};

/// Maximum number of objects in a page.
const MAX_OBJECTS: usize = 60;

pub(super) fn summary(report: &EvalReport) -> Markup {
    html! {
        (models(report))
        @if let Some(model) = report.models.first() { (confusion(model)) }
        @if report.models.iter().any(|model| model.conformal.is_some()) { (sets(report)) }
        @if !report.differences.is_empty() { (differences(report)) }
    }
}

fn models(report: &EvalReport) -> Table {
    let numbers = [
        "n",
        "Accuracy",
        "Balanced accuracy",
        "AUROC",
        "Average precision",
        "Brier",
        "ECE",
        "Threshold",
    ];
    let columns = std::iter::once(text("Model")).chain(numbers.map(number));
    let mut table = Table::new("Metrics of the models", columns);
    for model in &report.models {
        let intervals = [model.balanced_accuracy, model.auroc];
        let (name, calibration) = (display_name(model), calibration(model));
        model_row(&mut table, &name, &model.summary, intervals, &calibration);
        let none = html! {};
        model_row(
            &mut table,
            "in contact",
            &model.in_contact,
            [None; 2],
            &none,
        );
    }
    for result in &report.over_models {
        let over = &result.summary;
        if over.seeds < 2 {
            continue;
        }
        let name = format!("{}: mean ± sd of {} seeds", result.modality, over.seeds);
        table.total([
            &name as &dyn Render,
            &"",
            &spread(over.accuracy),
            &spread(over.balanced_accuracy),
            &spread(over.auroc),
            &spread(over.average_precision),
            &spread(over.brier),
            &spread(over.ece),
            &"",
        ]);
    }
    table
}

fn model_row(
    table: &mut Table,
    name: &str,
    summary: &Summary,
    [balanced, auroc]: [Option<Interval>; 2],
    calibration: &Markup,
) {
    table.row([
        &name as &dyn Render,
        &summary.n,
        &optional(summary.accuracy, 3),
        &with_interval(summary.balanced_accuracy, balanced),
        &with_interval(summary.auroc, auroc),
        &optional(summary.average_precision, 3),
        &optional(summary.brier, 3),
        &html! { (optional(summary.ece, 3)) (calibration) },
        &fixed(summary.threshold, 2),
    ]);
}

/// Renders reference values of the calibration error.
fn calibration(model: &ModelEvaluation) -> Markup {
    html! {
        @if let Some(chance) = model.ece_by_chance {
            small { "by chance < " (fixed(chance.high, 3)) }
        }
        @if let Some(corrected) = model.at_base_rate.filter(BaseRateCalibration::is_uneven) {
            small { "at base rate " (fixed(corrected.base_rate, 2)) ": " (fixed(corrected.ece, 3)) }
        }
    }
}

fn confusion(model: &ModelEvaluation) -> Table {
    let matrix = &model.summary.confusion;
    let caption = format!("Confusion of {} at its threshold", display_name(model));
    let numbers = ["predicted stable", "predicted slip", "recall"];
    let columns = std::iter::once(text("")).chain(numbers.map(number));
    let mut table = Table::new("Confusion matrix", columns).caption(caption);
    table.row([
        &"stable" as &dyn Render,
        &matrix.true_stable,
        &matrix.false_slip,
        &percent(matrix.true_stable, matrix.n_stable()),
    ]);
    table.row([
        &"slip" as &dyn Render,
        &matrix.false_stable,
        &matrix.true_slip,
        &percent(matrix.true_slip, matrix.n_slip()),
    ]);
    table
}

/// Prediction sets of the models that have conformal scores.
fn sets(report: &EvalReport) -> Table {
    let columns = [
        text("Model"),
        text("Outcome"),
        number("Error rate"),
        number("n"),
        number("Coverage"),
        number("Can't tell"),
    ];
    let mut table = Table::new("Prediction sets", columns)
        .caption("Prediction sets: stable, slip or can't tell");
    for model in &report.models {
        let Some(conformal) = &model.conformal else {
            continue;
        };
        for (outcome, label) in [
            ("all", &conformal.all),
            ("stable", &conformal.stable),
            ("slip", &conformal.slip),
        ] {
            table.row([
                &display_name(model) as &dyn Render,
                &outcome,
                &fixed(conformal.limits.error_rate, 2),
                &label.n,
                &with_interval(label.coverage, label.coverage_interval),
                &with_interval(label.cant_tell, label.cant_tell_interval),
            ]);
        }
    }
    table
}

fn differences(report: &EvalReport) -> Table {
    let columns = [
        text("First"),
        text("Minus"),
        number("Balanced accuracy"),
        number("AUROC"),
    ];
    let mut table = Table::new("Differences", columns).caption("Differences on the same samples");
    for difference in &report.differences {
        let interval = |i: Option<Interval>| with_interval(i.map(|i| i.estimate), i);
        table.row([
            &difference.first as &dyn Render,
            &difference.second,
            &interval(difference.balanced_accuracy),
            &interval(difference.auroc),
        ]);
    }
    table
}

fn percent(count: usize, total: usize) -> String {
    if total == 0 {
        return MISSING.to_owned();
    }
    format!("{}\u{a0}%", fixed(100.0 * count as f64 / total as f64, 1))
}

fn spread(spread: Option<Spread>) -> String {
    spread.map_or_else(
        || MISSING.to_owned(),
        |s| {
            let deviation = s.standard_deviation.unwrap_or(0.0);
            format!("{} ± {}", fixed(s.mean, 3), fixed(deviation, 3))
        },
    )
}

fn with_interval(value: Option<f64>, interval: Option<Interval>) -> Markup {
    html! {
        (optional(value, 3))
        @if let Some(interval) = interval {
            small { (fixed(interval.low, 3)) " – " (fixed(interval.high, 3)) }
        }
    }
}

pub(super) fn groups(model: &ModelEvaluation) -> Markup {
    // Sorted by accuracy, worst first.
    let mut objects = model.per_object.clone();
    objects.sort_by(|a, b| {
        let accuracy = |group: &GroupSummary| group.accuracy.unwrap_or(1.0);
        accuracy(a)
            .total_cmp(&accuracy(b))
            .then(a.name.cmp(&b.name))
    });
    html! {
        div.tables {
            (table("Category", &model.categories))
            (table("Stopping force", &model.forces))
            (table("Object, worst first", &objects[..objects.len().min(MAX_OBJECTS)]))
            @if objects.len() > MAX_OBJECTS {
                p { (objects.len() - MAX_OBJECTS) " more are in eval.json." }
            }
        }
    }
}

fn table(name: &str, groups: &[GroupSummary]) -> Table {
    let numbers = ["n", "stable", "Accuracy", "AUROC"];
    let columns = std::iter::once(text(name)).chain(numbers.map(number));
    let mut table = Table::new(name, columns);
    for group in groups {
        table.row([
            &group.name.trim() as &dyn Render,
            &group.n,
            &group.stable,
            &optional(group.accuracy, 2),
            &optional(group.auroc, 2),
        ]);
    }
    table
}
