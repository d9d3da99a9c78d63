//! What changed against an earlier report.

use super::Page;
use super::text::Agreement;
use crate::report::{ChangedOutcome, Changes};
use gripcast_report::page::{Table, text};
use gripcast_report::{MISSING, engine_name, fixed, optional, outcome_name};
use maud::{Markup, Render, html};

pub(super) fn section(page: &Page<'_>, changes: &Changes) -> Markup {
    let body = html! {
        p {
            "Compared with " code { (changes.path) } ", written by " (changes.software) "."
        }
        (list("Conditions that differ", &changes.conditions))
        @if !changes.scores.is_empty() { (scores(changes)) }
        @if changes.outcomes.is_empty() {
            p { "No outcome changed." }
        } @else {
            (outcomes(page, &changes.outcomes))
        }
        (list("Grasps only in this report", &changes.added))
        (list("Grasps only in the earlier report", &changes.removed))
    };
    page.section("changes", "Changes against an earlier report", body)
}

fn list(title: &str, items: &[String]) -> Markup {
    html! {
        @if !items.is_empty() {
            h3 { (title) " (" (items.len()) ")" }
            ul {
                @for item in items { li { (item) } }
            }
        }
    }
}

fn scores(changes: &Changes) -> Table {
    let columns = ["Engine, the paper’s way", "then", "now", "difference"].map(text);
    let mut table = Table::new("Scores then and now", columns);
    for (engine, [then, now]) in &changes.scores {
        let difference = match (then, now) {
            (Some(then), Some(now)) if now > then => format!("+{}", fixed(now - then, 2)),
            (Some(then), Some(now)) => fixed(now - then, 2),
            _ => MISSING.to_owned(),
        };
        table.row([
            &engine_name(engine) as &dyn Render,
            &optional(*then, 2),
            &optional(*now, 2),
            &difference,
        ]);
    }
    table
}

fn outcomes(page: &Page<'_>, outcomes: &[ChangedOutcome]) -> Table {
    let columns = ["Grasp", "Object", "Engine", "then", "now", page.reality()].map(text);
    let mut table = Table::new("Outcomes that changed", columns)
        .class("data text")
        .caption(format!("Outcomes that changed: {}", outcomes.len()));
    for changed in outcomes {
        let agreement = Agreement(changed.agrees);
        table.row([
            &changed.grasp as &dyn Render,
            &changed.object,
            &engine_name(&changed.engine),
            &outcome_name(&changed.before),
            &outcome_name(&changed.after),
            &html! {
                span class=(agreement.class()) { (agreement.sign()) " " (agreement.word()) }
            },
        ]);
    }
    table
}
