//! What the words of the page mean.

use crate::report::facts::SynthReport;
use gripcast_report::page::{self, definitions};
use maud::Markup;

pub(super) fn section(report: &SynthReport) -> Markup {
    let force = match report.plan.engine.as_str() {
        "fem" => "The normal force on the gels at which the fingers stop closing.",
        _ => "The force with which the fingers are driven.",
    };
    let notes = definitions(
        "notes",
        &[
            (
                "Held, lost",
                &"Held: the object was up with the gripper at the end of the lift. Lost: it \
                  slipped or was squeezed out. A simulation has no label where the fingers missed \
                  the object or met, could not begin, did not converge, or where nothing was \
                  between them before the lift.",
            ),
            ("Force", &force),
            (
                "Departure of the grasp",
                &"What was done to a pair of opposite places: nothing, contacts off the middle of \
                  the gels, one finger higher (tilted), a leaning approach, only the ends of the \
                  gels (shallow), a closing direction turned away from the normals (edge).",
            ),
            (
                "CPU time",
                &"Of the thread of a simulation; on a machine with other work it is longer than on \
                  a free one. A core makes as many simulations in an hour as fit into its CPU \
                  time.",
            ),
            (
                "Estimate",
                &"What the plan deals to the shards of a cluster; only its proportions matter \
                  there, so the correlation tells more than the ratio.",
            ),
        ],
    );
    page::section("notes", "What the words mean", notes)
}
