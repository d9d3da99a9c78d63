//! Definitions of the terms on the page.

use crate::report::facts::SynthReport;
use gripcast_report::page::{self, definitions};
use maud::Markup;

pub(super) fn section(report: &SynthReport) -> Markup {
    let force = match report.plan.engine.as_str() {
        "fem" => "The normal force per finger at which closure ends.",
        _ => "The closing force of the fingers.",
    };
    let notes = definitions(
        "notes",
        &[
            (
                "Stable, slip",
                &"Stable: the object followed the gripper to the end of the lift. Slip: it slipped or \
                  was ejected. A simulation has no label if the gripper missed the object, the gels \
                  met, the start was in collision, the solver did not converge, or no object was \
                  between the fingers before the lift.",
            ),
            ("Force", &force),
            (
                "Grasp fault",
                &"Deviation from an antipodal grasp: none, contacts off the centre of the gels, one \
                  finger higher (tilted), a non-vertical approach (leaned), contact only at the gel \
                  tips (shallow), a closing direction off the surface normals (edge).",
            ),
            (
                "CPU time",
                &"Of the thread of a simulation; longer on a machine with other load.",
            ),
            (
                "Estimate",
                &"Used to distribute simulations over shards. Only its proportions matter, so the \
                  correlation is more relevant than the ratio.",
            ),
        ],
    );
    page::section("notes", "Definitions", notes)
}
