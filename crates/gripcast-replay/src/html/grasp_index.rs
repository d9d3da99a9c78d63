//! Table of all grasps, which the script can sort and filter.

use super::Page;
use super::text::Agreement;
use crate::report::{GraspFacts, GraspReplay};
use gripcast_report::{MISSING, engine_name, fixed, outcome_label};
use maud::{Markup, html};

pub(super) fn section(page: &Page<'_>) -> Markup {
    let label_heading = match page.simulated() {
        Some(_) => "As if real",
        None => "Real",
    };
    let body = html! {
        p {
            "Outcome at the paper’s choice, whether it agrees with " (page.reality()) ", the number \
             of disagreeing settings, and the height of the object’s lowest point at the end."
        }
        (filters(page))
        div.wide role="region" tabindex="0" aria-label="All grasps" {
            table.data.index {
                thead {
                    tr {
                        @for title in ["Grasp", "Object", label_heading] {
                            th scope="col" { (title) }
                        }
                        @for engine in &page.report.engines {
                            th scope="col" { (engine_name(&engine.name)) }
                            th.n scope="col" { "disagreeing settings" }
                            th.n scope="col" { "height, mm" }
                        }
                    }
                }
                tbody {
                    @for (i, grasp) in page.report.grasps.iter().enumerate() {
                        (row(page, i, grasp))
                    }
                }
            }
        }
    };
    page.section("index", "All grasps", body)
}

/// Data attributes by which the script filters rows and articles.
pub(super) struct Marks {
    /// Index of its object.
    pub(super) object: Option<usize>,
    /// Agreement by engine.
    pub(super) engines: String,
}

impl Marks {
    pub(super) fn of(page: &Page<'_>, grasp: &GraspFacts) -> Self {
        let mut objects = page.report.objects.iter();
        let engines = page.report.engines.iter().enumerate();
        let marks = engines.filter_map(|(i, engine)| {
            let agrees = replay_of(grasp, &engine.name)?.agrees;
            Some(format!("{}{i}", Agreement(agrees).class()))
        });
        Self {
            object: objects.position(|object| object.name == grasp.object),
            engines: marks.collect::<Vec<_>>().join(" "),
        }
    }
}

/// Result of an engine.
fn replay_of<'a>(grasp: &'a GraspFacts, engine: &str) -> Option<&'a GraspReplay> {
    grasp.replays.iter().find(|replay| replay.engine == engine)
}

/// Filter form; hidden without the script.
fn filters(page: &Page<'_>) -> Markup {
    let grasps = page.report.grasps.len();
    html! {
        form.filters hidden {
            label {
                "Object "
                select name="object" {
                    option value="" { "all" }
                    @for (i, object) in page.report.objects.iter().enumerate() {
                        option value=(i) { (object.name) }
                    }
                }
            }
            label {
                "Show "
                select name="mark" {
                    option value="" { "all grasps" }
                    @for (i, engine) in page.report.engines.iter().enumerate() {
                        @for agreement in [Some(false), Some(true), None].map(Agreement) {
                            option value={ (agreement.class()) (i) } {
                                (engine_name(&engine.name)) ": " (agreement.word())
                            }
                        }
                    }
                }
            }
            label { "Id contains " input type="search" name="text"; }
            output { (grasps) " of " (grasps) " grasps" }
        }
    }
}

fn row(page: &Page<'_>, i: usize, grasp: &GraspFacts) -> Markup {
    let marks = Marks::of(page, grasp);
    html! {
        tr data-object=[marks.object] data-marks=(marks.engines) {
            th scope="row" { a href={ "#g" (i) } { (grasp.id) } }
            td { (grasp.object) }
            td { (outcome_label(grasp.stable)) }
            @for engine in &page.report.engines {
                @if let Some(replay) = replay_of(grasp, &engine.name) {
                    td { (Agreement(replay.agrees).outcome(&replay.case.outcome)) }
                    td.n { (disagreeing(replay)) }
                    td.n { (fixed(1e3 * replay.case.min_height_m, 1)) }
                } @else {
                    td { (MISSING) }
                    td.n { (MISSING) }
                    td.n { (MISSING) }
                }
            }
        }
    }
}

/// Formats `3 of 9`: disagreeing settings, of those with an outcome.
pub(super) fn disagreeing(replay: &GraspReplay) -> String {
    let agreements = replay.cells.iter().filter_map(|cell| cell.agrees);
    let (n, disagreeing) = agreements.fold((0, 0), |(n, disagreeing), agrees| {
        (n + 1, disagreeing + usize::from(!agrees))
    });
    if n == 0 {
        MISSING.to_owned()
    } else {
        format!("{disagreeing} of {n}")
    }
}
