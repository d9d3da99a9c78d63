//! Excluded grasps, cost, and definitions.

use super::Page;
use super::text::force_name;
use gripcast_report::page::{Table, definitions, text};
use gripcast_report::{duration, engine_name, trimmed};
use maud::{Markup, Render, html};

pub(super) fn left_out(page: &Page<'_>) -> Markup {
    let columns = ["Grasp", "Object", "Reason"].map(text);
    let mut table = Table::new("Left out", columns).class("data text");
    for left in &page.report.left_out {
        table.row([&left.grasp as &dyn Render, &left.object, &left.reason]);
    }
    let body = html! {
        @if page.report.left_out.is_empty() {
            p { "None: every grasp of the dataset was replayed." }
        } @else {
            p { "Grasps and cases that are not in the scores." }
            (table)
        }
    };
    page.section("left-out", "Left out", body)
}

pub(super) fn cost(page: &Page<'_>) -> Markup {
    let cost = &page.report.cost;
    let columns = [
        "Engine",
        "total CPU time",
        "CPU time per grasp, all settings",
        "frictions",
        "forces, N",
    ];
    let mut table = Table::new("Cost", columns.map(text));
    let grasps = page.report.grasps.len().max(1) as f64;
    let list = |values: &[f64]| -> String {
        let values: Vec<String> = values.iter().map(|v| trimmed(*v, 3)).collect();
        values.join(", ")
    };
    for engine in &page.report.engines {
        let cpu = cost.cpu_s.get(&engine.name).copied().unwrap_or(f64::NAN);
        table.row([
            &engine_name(&engine.name) as &dyn Render,
            &duration(cpu),
            &duration(cpu / grasps),
            &list(&engine.frictions),
            &list(&engine.forces_n),
        ]);
    }
    let body = html! {
        p {
            (cost.cases) " cases: " (cost.simulated_now) " simulated in this run ("
            (cost.jobs) " in parallel, wall time " (duration(cost.wall_s)) "), "
            (cost.cases.saturating_sub(cost.simulated_now)) " already finished. Processor: "
            (cost.processor) "."
        }
        (table)
        @for engine in &page.report.engines {
            @let parameters = serde_json::to_string_pretty(&engine.parameters);
            details {
                summary { (engine_name(&engine.name)) ": all other parameters" }
                pre { (parameters.unwrap_or_default()) }
            }
        }
    };
    page.section("cost", "Cost", body)
}

pub(super) fn notes(page: &Page<'_>) -> Markup {
    let reality = match page.simulated() {
        Some(text) => format!("Simulated, not measured: {}", with_full_stop(text)),
        None => "The recorded outcome of the grasp.".to_owned(),
    };
    let forces = html! {
        @for engine in &page.report.engines {
            (engine_name(&engine.name)) ": " (force_name(&engine.name)) ", "
            @if engine.name == "fem" {
                "the normal force per finger at which closure ends. "
            } @else {
                "the closing force of the fingers. "
            }
        }
    };
    let agreement = html! {
        "A simulated grasp is stable if its outcome is " i { "stable" } ", and a slip if the object \
         slipped, was ejected or missed, or the gels met. Cases without an outcome (not converged, \
         or in collision at the start) are not counted and are listed separately."
    };
    let choice = html! {
        "Friction and force are unknown, so all settings are simulated. " i { "The paper’s choice" }
        " is the friction with the highest agreement if each object has its best force, and then \
         that force. It is chosen on the scored grasps and therefore biased; "
        i { "leave one grasp out" } " and " i { "leave one object out" } " are not."
    };
    let notes = definitions(
        "notes",
        &[
            ("Reality", &reality),
            ("Agreement", &agreement),
            ("Choice of the setting", &choice),
            (
                "Intervals",
                &"Wilson’s score interval at 95\u{a0}% for a fraction of independent grasps. The comparison \
                  is McNemar’s test with exact binomial probabilities, two-sided, on the grasps \
                  where just one engine is right.",
            ),
            ("Force", &forces),
            (
                "Disagreement",
                &"Fraction of the settings with an outcome that disagree with the dataset. If all \
                  disagree, the cause is geometry, pose or model rather than friction or force.",
            ),
            (
                "Drawn poses",
                &"The grasp is replayed at the chosen setting with poses drawn from the covariance of \
                  its annotation. If at least half of them agree with the dataset, the pose error \
                  explains a disagreement.",
            ),
        ],
    );
    let body = html! {
        p { "Command that repeats the replay:" }
        pre.command { (page.report.command) }
        (notes)
    };
    page.section("notes", "Command and definitions", body)
}

fn with_full_stop(text: &str) -> String {
    let text = text.trim_end();
    if text.ends_with(['.', '!', '?']) {
        text.to_owned()
    } else {
        format!("{text}.")
    }
}
