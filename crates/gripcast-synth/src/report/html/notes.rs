//! What the words of the page mean.

use std::fmt::Write as _;

use crate::report::facts::SynthReport;
use gripcast_report::{open_section, put};

pub(super) fn section(report: &SynthReport, out: &mut String) {
    open_section(out, "notes", "What the words mean");
    out.push_str("<dl class=\"notes\">\n");
    let mut note = |name: &str, text: &str| put!(out, "<dt>{name}</dt><dd>{text}</dd>\n");
    note(
        "Held, lost",
        "Held: the object was up with the gripper at the end of the lift. Lost: it slipped or was \
         squeezed out. A simulation has no label where the fingers missed the object or met, could \
         not begin, did not converge, or where nothing was between them before the lift.",
    );
    note(
        "Force",
        match report.plan.engine.as_str() {
            "fem" => "The normal force on the gels at which the fingers stop closing.",
            _ => "The force with which the fingers are driven.",
        },
    );
    note(
        "Departure of the grasp",
        "What was done to a pair of opposite places: nothing, contacts off the middle of the gels, \
         one finger higher (tilted), a leaning approach, only the ends of the gels (shallow), a \
         closing direction turned away from the normals (edge).",
    );
    note(
        "CPU time",
        "Of the thread of a simulation; on a machine with other work it is longer than on a free \
         one. A core makes as many simulations in an hour as fit into its CPU time.",
    );
    note(
        "Estimate",
        "What the plan deals to the shards of a cluster; only its proportions matter there, so the \
         correlation tells more than the ratio.",
    );
    out.push_str("</dl>\n</section>\n");
}
