//! Fraction of held grasps by what may decide it.

use super::{bar, key, percent, words};
use crate::report::facts::{BalanceTable, Labels, SynthReport};
use gripcast_report::page::{self, Table, number, text};
use maud::{Markup, Render, html};

pub(super) fn section(report: &SynthReport) -> Markup {
    let has_dataset = report.dataset.is_some();
    let body = html! {
        p {
            "Fraction of simulations that held. Where a group is nearly all of one label, a model can \
             guess it from that alone"
            @if has_dataset { "; what counts for training are the columns of the dataset" }
            "."
        }
        (key())
        div.tables {
            @for table in &report.balance { (draw(table, has_dataset)) }
        }
    };
    page::section("balance", "Balance", body)
}

fn draw(facts: &BalanceTable, has_dataset: bool) -> Table {
    let first = if has_dataset { "dataset" } else { "results" };
    let mut columns = vec![text(""), text(first), number("fraction"), number("of")];
    if has_dataset {
        columns.extend([number("all results"), number("of")]);
    }
    let caption = format!("By {}", facts.by);
    let mut table = Table::new(&caption, columns)
        .caption(&caption)
        .class("data balance");
    for group in &facts.groups {
        let first = group.dataset.unwrap_or(group.results);
        let fraction = |labels: Labels| percent(labels.fraction());
        // Where there is no dataset, there are no columns for the last two cells.
        table.row([
            &words(&group.name) as &dyn Render,
            &bar(first, first.all()),
            &fraction(first),
            &first.all(),
            &fraction(group.results),
            &group.results.all(),
        ]);
    }
    table
}
