//! Changes since an earlier report.

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
        (list("Changed conditions", &changes.conditions))
        @if !changes.scores.is_empty() { (scores(changes)) }
        @if changes.outcomes.is_empty() {
            p { "No outcome changed." }
        } @else {
            (outcomes(page, &changes.outcomes))
        }
        (list("Grasps only in this report", &changes.added))
        (list("Grasps only in the earlier report", &changes.removed))
    };
    page.section("changes", "Changes since an earlier report", body)
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
    let columns = [
        "Engine, the paper’s choice",
        "earlier",
        "current",
        "difference",
    ]
    .map(text);
    let mut table = Table::new("Earlier and current scores", columns);
    for (engine, [earlier, current]) in &changes.scores {
        let difference = match (earlier, current) {
            (Some(a), Some(b)) if b > a => format!("+{}", fixed(b - a, 2)),
            (Some(a), Some(b)) => fixed(b - a, 2),
            _ => MISSING.to_owned(),
        };
        table.row([
            &engine_name(engine) as &dyn Render,
            &optional(*earlier, 2),
            &optional(*current, 2),
            &difference,
        ]);
    }
    table
}

fn outcomes(page: &Page<'_>, outcomes: &[ChangedOutcome]) -> Table {
    let columns = [
        "Grasp",
        "Object",
        "Engine",
        "earlier",
        "current",
        page.reality(),
    ]
    .map(text);
    let mut table = Table::new("Changed outcomes", columns)
        .class("data text")
        .caption(format!("Changed outcomes: {}", outcomes.len()));
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
