//! Fraction of stable grasps by attributes that may predict the label.

use super::{bar, key, percent, words};
use crate::report::facts::{BalanceTable, LabelCounts, SynthReport};
use gripcast_report::page::{self, Table, number, text};
use maud::{Markup, Render, html};

pub(super) fn section(report: &SynthReport) -> Markup {
    let has_dataset = report.dataset.is_some();
    let body = html! {
        p {
            "Fraction of stable simulations. If nearly all labels of a group are equal, a model can \
             predict the label from that attribute alone"
            @if has_dataset { "; training only sees the columns of the dataset" }
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
        let fraction = |labels: LabelCounts| percent(labels.stable_fraction());
        // Without a dataset there are no columns for the last two cells.
        table.row([
            &words(&group.name) as &dyn Render,
            &bar(first, first.total()),
            &fraction(first),
            &first.total(),
            &fraction(group.results),
            &group.results.total(),
        ]);
    }
    table
}
