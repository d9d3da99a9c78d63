//! CPU time, and simulations without a label.

use crate::report::facts::{CostFacts, EstimateFacts, Quantiles, SettingCost, SynthReport};
use gripcast_report::page::{self, Table, number, placeholder, stacked_bar, text};
use gripcast_report::{duration, engine_name, fixed, optional, outcome_name, trimmed};
use maud::{Markup, Render, html};

/// Stages: name in the report, name on the page, CSS class of its colour.
const STAGES: [(&str, &str, &str); 4] = [
    ("prepare", "mesh", "part-0"),
    ("simulate", "simulation", "part-1"),
    ("tactile", "tactile images", "part-2"),
    ("visual", "colour images", "part-3"),
];

pub(super) fn section(report: &SynthReport) -> Markup {
    let costs = &report.costs;
    let body = html! {
        @if costs.simulations == 0 {
            (placeholder("No simulation has finished yet."))
        } @else {
            p {
                b { (optional(costs.per_core_hour, 0)) " simulations per core hour" } ", "
                (optional(costs.labelled_per_core_hour, 0)) " of them with a label and all images. \
                 CPU time of " (costs.simulations) " simulations, without failed ones."
            }
            (by_stage(costs))
            (settings(&costs.settings))
            @if let Some(found) = &costs.estimate { (estimate(found)) }
        }
    };
    page::section("cost", "Cost", body)
}

fn by_stage(costs: &CostFacts) -> Markup {
    let total = costs.total_s;
    let seconds = [total.prepare, total.simulate, total.tactile, total.visual];
    let all = total.total();
    let columns = [
        text("Stage"),
        number("total CPU time"),
        number("fraction"),
        number("median"),
        number("95\u{a0}%"),
        number("maximum"),
    ];
    let cells = |key: &str, seconds: f64| {
        let each = costs.each_s.get(key).copied().unwrap_or_default();
        let fraction = format!("{}\u{a0}%", fixed(100.0 * seconds / all, 1));
        let each = [each.median, each.p95, each.max].map(duration);
        (duration(seconds), fraction, each)
    };
    let mut table = Table::new("CPU time by stage", columns);
    for ((key, name, class), seconds) in STAGES.into_iter().zip(seconds) {
        let title = html! { span.key { i class=(class) {} } " " (name) };
        let (all, fraction, [median, p95, max]) = cells(key, seconds);
        table.row([&title as &dyn Render, &all, &fraction, &median, &p95, &max]);
    }
    let (sum, fraction, [median, p95, max]) = cells("all", all);
    table.total([&"all" as &dyn Render, &sum, &fraction, &median, &p95, &max]);
    let stages = STAGES.into_iter().zip(seconds);
    html! {
        div.wide-bar { (stacked_bar(stages.map(|((_, _, class), s)| (class, s / all)))) }
        (table)
    }
}

fn settings(settings: &[SettingCost]) -> Table {
    let columns = [
        text("Simulator"),
        number("force, N"),
        number("simulations"),
        number("total CPU time"),
        number("per simulation: median, 95\u{a0}%, maximum"),
        number("of that simulator"),
        number("Newton iterations"),
        number("unconverged steps"),
    ];
    let mut table = Table::new("Cost by simulator and force", columns);
    for one in settings {
        table.row([
            &engine_name(&one.engine) as &dyn Render,
            &trimmed(one.stop_force_n, 3),
            &one.simulations,
            &duration(one.total_s),
            &quantiles(&one.all_s, duration),
            &quantiles(&one.simulate_s, duration),
            &quantiles(&one.newton_iterations, |count| fixed(count, 0)),
            &format!(
                "{} of {} in {} simulations",
                one.unconverged_steps, one.steps, one.unconverged_simulations
            ),
        ]);
    }
    table
}

fn quantiles(of: &Quantiles, show: fn(f64) -> String) -> String {
    [of.median, of.p95, of.max].map(show).join(", ")
}

fn estimate(found: &EstimateFacts) -> Markup {
    let ratio = &found.ratio;
    html! {
        p {
            "Estimated: " (duration(found.estimated_s)) ". Measured: " (duration(found.measured_s))
            ", " (fixed(found.measured_s / found.estimated_s, 2)) " times the estimate (per \
             simulation: median " (fixed(ratio.median, 2)) ", 5 to 95\u{a0}% "
            (fixed(ratio.p05, 2)) " to " (fixed(ratio.p95, 2)) "); "
            @match found.correlation {
                Some(correlation) => { "correlation " (fixed(correlation, 2)) },
                None => "no correlation, since one of both is constant",
            }
            "."
        }
    }
}

pub(super) fn unlabelled(report: &SynthReport) -> Markup {
    const TITLE: &str = "Simulations without a label";
    let columns = [
        text("Outcome"),
        text("Reason"),
        number("simulations"),
        text("example"),
    ];
    let mut table = Table::new(TITLE, columns).class("data text");
    for group in &report.unlabelled {
        // The reason with its numbers, if it has any.
        let example = if group.reason == group.example_reason {
            group.example.clone()
        } else {
            format!("{}: {}", group.example, group.example_reason)
        };
        table.row([
            &outcome_name(&group.outcome) as &dyn Render,
            &group.reason,
            &group.count,
            &example,
        ]);
    }
    let body = html! {
        @if report.unlabelled.is_empty() {
            p { "None: every finished simulation has a label." }
        } @else {
            (table)
        }
    };
    page::section("unlabelled", TITLE, body)
}
