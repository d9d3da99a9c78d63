//! Confusion matrix of each engine, and the paired comparison of both.

use super::Page;
use super::text::p_value;
use crate::report::{EngineComparison, EngineFacts};
use gripcast_report::engine_name;
use gripcast_report::page::placeholder;
use maud::{Markup, html};

pub(super) fn section(page: &Page<'_>) -> Markup {
    let body = html! {
        p {
            "Numbers of grasps at the paper’s choice. Outlined cells disagree with "
            (page.reality()) "."
        }
        div.row {
            @for engine in &page.report.engines { (confusion(page, engine)) }
            @match &page.report.comparison {
                Some(comparison) => (comparison_table(comparison)),
                None => (placeholder("Only one engine ran.")),
            }
        }
    };
    page.section("confusion", "Confusion and comparison", body)
}

/// A table of four counts; both sides agree on the diagonal.
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
        columns: ["engine: stable", "engine: slip"],
        rows: ["stable", "slip"].map(|label| format!("{}: {label}", page.reality())),
        counts: [[c.true_stable, c.false_slip], [c.false_stable, c.true_slip]],
        foot: html! { "without outcome: " (engine.without_outcome) },
    };
    square.draw()
}

fn comparison_table(comparison: &EngineComparison) -> Markup {
    let [only_fem, only_rigid] = comparison.leave_one_out;
    let square = Square {
        caption: "Comparison (McNemar)",
        columns: ["rigid bodies agree", "rigid bodies disagree"],
        rows: ["agree", "disagree"].map(|verb| format!("finite elements {verb}")),
        counts: [
            [comparison.both, comparison.only_fem],
            [comparison.only_rigid, comparison.neither],
        ],
        foot: html! {
            "exact, two-sided: " (p_value(comparison.mcnemar_p)) br;
            "leave one grasp out: " (only_fem) " vs. " (only_rigid) ", "
            (p_value(comparison.leave_one_out_p))
        },
    };
    square.draw()
}
