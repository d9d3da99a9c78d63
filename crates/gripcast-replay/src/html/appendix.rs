//! What was left out, what it cost, how the numbers are defined and how to repeat them.

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
            p { "Nothing: every grasp of the dataset was replayed." }
        } @else {
            p { "Not in the scores, and why." }
            (table)
        }
    };
    page.section("left-out", "Left out", body)
}

pub(super) fn cost(page: &Page<'_>) -> Markup {
    let cost = &page.report.cost;
    let columns = [
        "Engine",
        "CPU time, all cases",
        "a grasp, all settings",
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
            (cost.cases) " cases, " (cost.simulated_now) " of them simulated in this run ("
            (cost.jobs) " at a time, " (duration(cost.wall_s)) " by the clock) and "
            (cost.cases.saturating_sub(cost.simulated_now)) " found finished. Processor: "
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
        Some(how) => format!("Simulated, not measured: {}", with_stop(how)),
        None => "The outcome that was recorded with the grasp.".to_owned(),
    };
    let forces = html! {
        @for engine in &page.report.engines {
            (engine_name(&engine.name)) ": " (force_name(&engine.name)) ", "
            @if engine.name == "fem" {
                "the normal force on the gels at which the fingers stop closing. "
            } @else {
                "the force with which the fingers are driven. "
            }
        }
    };
    let agreement = html! {
        "A simulated grasp counts as held if its outcome is " i { "held" } ", and as lost if the \
         object slipped, was squeezed out or missed, or the fingers met. A case without outcome \
         (it did not converge or could not begin) is not counted, and said apart."
    };
    let choice = html! {
        "Friction and force are unknown, so all are tried. " i { "The paper’s way" } " takes the \
         friction with most agreement when each object has its best force, and then that force. It \
         is chosen on the same grasps that it is scored on, and so too favourable; "
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
                &"Of all settings with an outcome, the fraction whose outcome is not that of the \
                  dataset. One that disagrees everywhere points at geometry, pose or model rather \
                  than at friction or force.",
            ),
            (
                "Drawn poses",
                &"The grasp replayed at the chosen setting with poses drawn from the covariance of \
                  its annotation. Where half of them end as the dataset says, the pose error \
                  explains a disagreement.",
            ),
        ],
    );
    let body = html! {
        p { "The command that repeats it:" }
        pre.command { (page.report.command) }
        (notes)
    };
    page.section("notes", "How to repeat it, and what the numbers mean", body)
}

fn with_stop(text: &str) -> String {
    let text = text.trim_end();
    if text.ends_with(['.', '!', '?']) {
        text.to_owned()
    } else {
        format!("{text}.")
    }
}
