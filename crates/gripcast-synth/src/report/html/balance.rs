//! Share of held grasps by what may decide it.

use std::fmt::Write as _;

use super::{bar, key, percent, words};
use crate::report::facts::{BalanceTable, Labels, SynthReport};
use gripcast_report::{Esc, open_section, put};

pub(super) fn section(report: &SynthReport, out: &mut String) {
    open_section(out, "balance", "Balance");
    out.push_str(
        "<p>Share of simulations that held. Where a group is nearly all of one label, a model can \
         guess it from that alone",
    );
    out.push_str(match report.dataset {
        Some(_) => "; what counts for training are the columns of the dataset.</p>\n",
        None => ".</p>\n",
    });
    key(out);
    out.push_str("<div class=\"tables\">\n");
    for table in &report.balance {
        draw(table, report.dataset.is_some(), out);
    }
    out.push_str("</div>\n</section>\n");
}

fn draw(table: &BalanceTable, has_dataset: bool, out: &mut String) {
    put!(
        out,
        "<table class=\"data\"><caption>By {}</caption><thead><tr><td></td>\
         <th scope=\"col\" class=\"plot\">{}</th><th scope=\"col\" class=\"n\">share</th>\
         <th scope=\"col\" class=\"n\">of</th>",
        Esc(&table.by),
        if has_dataset { "dataset" } else { "results" }
    );
    if has_dataset {
        out.push_str(
            "<th scope=\"col\" class=\"n\">all results</th><th scope=\"col\" class=\"n\">of</th>",
        );
    }
    out.push_str("</tr></thead><tbody>\n");
    for group in &table.groups {
        let first = group.dataset.unwrap_or(group.results);
        put!(
            out,
            "<tr><th scope=\"row\">{}</th><td>",
            Esc(&words(&group.name))
        );
        bar(out, first, first.all());
        out.push_str("</td>");
        cells(first, out);
        if has_dataset {
            cells(group.results, out);
        }
        out.push_str("</tr>\n");
    }
    out.push_str("</tbody></table>\n");
}

fn cells(labels: Labels, out: &mut String) {
    put!(
        out,
        "<td class=\"n\">{}</td><td class=\"n\">{}</td>",
        percent(labels.share()),
        labels.all()
    );
}
