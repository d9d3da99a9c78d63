//! Confusion of each engine with reality, and the comparison of both.

use super::Page;
use super::text::p_value;
use crate::report::{EngineComparison, EngineFacts};
use gripcast_report::engine_name;
use gripcast_report::page::placeholder;
use maud::{Markup, html};

pub(super) fn section(page: &Page<'_>) -> Markup {
    let body = html! {
        p {
            "Counts of grasps at the paper’s choice. Outlined cells disagree with "
            (page.reality()) "."
        }
        div.row {
            @for engine in &page.report.engines { (confusion(page, engine)) }
            @match &page.report.comparison {
                Some(comparison) => (duel_table(comparison)),
                None => (placeholder("Only one engine ran: no comparison.")),
            }
        }
    };
    page.section("confusion", "Confusion and comparison", body)
}

/// Four counts: the outer two are where both sides agree.
struct Square<'a> {
    caption: &'a str,
    columns: [&'a str; 2],
    rows: [String; 2],
    counts: [[usize; 2]; 2],
    foot: Markup,
}

impl Square<'_> {
    fn draw(&self) -> Markup {
        html! {
            table.square {
                caption { (self.caption) }
                thead {
                    tr {
                        td {}
                        @for column in self.columns { th scope="col" { (column) } }
                    }
                }
                tbody {
                    @for (row, (name, counts)) in self.rows.iter().zip(self.counts).enumerate() {
                        tr {
                            th scope="row" { (name) }
                            @for (column, count) in counts.into_iter().enumerate() {
                                td class=[(row != column).then_some("off")] { (count) }
                            }
                        }
                    }
                }
                tfoot {
                    tr {
                        td colspan="3" { (self.foot) }
                    }
                }
            }
        }
    }
}

fn confusion(page: &Page<'_>, engine: &EngineFacts) -> Markup {
    let c = &engine.scores.confusion;
    let square = Square {
        caption: engine_name(&engine.name),
        columns: ["engine: held", "engine: lost"],
        rows: ["held", "lost"].map(|label| format!("{}: {label}", page.reality())),
        counts: [[c.true_stable, c.false_slip], [c.false_stable, c.true_slip]],
        foot: html! { "without outcome: " (engine.without_outcome) },
    };
    square.draw()
}

fn duel_table(comparison: &EngineComparison) -> Markup {
    let [only_fem, only_rigid] = comparison.leave_one_out;
    let square = Square {
        caption: "EngineComparison (McNemar)",
        columns: ["rigid right", "rigid wrong"],
        rows: ["right", "wrong"].map(|verdict| format!("finite elements {verdict}")),
        counts: [[comparison.both, comparison.only_fem], [comparison.only_rigid, comparison.neither]],
        foot: html! {
            "exact, two-sided: " (p_value(comparison.mcnemar_p)) br;
            "leave one grasp out: " (only_fem) " against " (only_rigid) ", "
            (p_value(comparison.leave_one_out_p))
        },
    };
    square.draw()
}
