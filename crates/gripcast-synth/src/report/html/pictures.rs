//! What the tactile pictures show, and pictures that are there twice.

use std::fmt::Write as _;

use super::percent;
use crate::report::facts::{ContactGroup, SynthReport};
use gripcast_report::{
    MISSING, fixed, label_name, open_section, open_wide, optional, put, trimmed,
};

pub(super) fn section(report: &SynthReport, out: &mut String) {
    open_section(out, "contact", "Contact in the tactile pictures");
    let contact = &report.contact;
    put!(
        out,
        "<p>One rendering of each simulation with a label, both sensors. A pair shows no contact \
         where less than {}&nbsp;% of its pixels change by more than {} grey levels. If lost grasps \
         showed none, a model could tell the label from that alone.</p>\n",
        trimmed(100.0 * contact.least_changed, 3),
        contact.changed_levels
    );
    if contact.groups.is_empty() {
        out.push_str("<p class=\"nothing\">There are no pictures yet.</p>\n");
    } else {
        sentence(report, out);
        groups(report, out);
    }
    match &report.dataset {
        Some(dataset) => put!(
            out,
            "<p>Renderings of the dataset whose tactile pictures are also those of another \
             simulation: <b>{}</b>.</p>\n",
            dataset.merge.duplicates
        ),
        None => out.push_str("<p class=\"nothing\">Duplicates are counted when merging.</p>\n"),
    }
    out.push_str("</section>\n");
}

/// Both labels in a sentence.
fn sentence(report: &SynthReport, out: &mut String) {
    let of = |held: bool| {
        let groups = report.contact.groups.iter().filter(|g| g.held == held);
        let [without, pairs] = groups.fold([0, 0], |[w, p], g| [w + g.without, p + g.pairs]);
        (pairs > 0).then(|| without as f64 / pairs as f64)
    };
    put!(
        out,
        "<p class=\"verdict\">No contact is seen in <b>{}</b> of the pairs of held grasps and in \
         <b>{}</b> of those of lost ones.</p>\n",
        percent(of(true)),
        percent(of(false))
    );
}

fn groups(report: &SynthReport, out: &mut String) {
    open_wide(out, "Contact by force and label");
    out.push_str(
        "<table class=\"data\"><thead><tr><th scope=\"col\">Force, N</th>\
         <th scope=\"col\">Label</th><th scope=\"col\" class=\"n\">pairs</th>\
         <th scope=\"col\" class=\"n\">without contact</th>\
         <th scope=\"col\" class=\"n\">simulations without on both sensors</th>\
         <th scope=\"col\" class=\"n\">mean change, grey levels: median (5 to 95&nbsp;%)</th>\
         <th scope=\"col\" class=\"n\">AUROC of the mean change</th></tr></thead><tbody>\n",
    );
    for group in &report.contact.groups {
        let separation = report.contact.separation.iter();
        let mut of_force = separation.filter(|one| one.stop_force_n == group.stop_force_n);
        let auroc = of_force.next().and_then(|one| one.auroc);
        row(group, auroc, out);
    }
    out.push_str("</tbody></table></div>\n");
    out.push_str(
        "<p>AUROC: how often a held grasp changes the pictures of both sensors more than a lost \
         one of the same force; 0.5 tells nothing, and neither 0 nor 1 is wanted.</p>\n",
    );
}

fn row(group: &ContactGroup, auroc: Option<f64>, out: &mut String) {
    let change = &group.mean_change;
    put!(
        out,
        "<tr><th scope=\"row\">{}</th><td>{}</td><td class=\"n\">{}</td>\
         <td class=\"n\">{} ({}&nbsp;%)</td><td class=\"n\">{}</td>\
         <td class=\"n\">{} ({} to {})</td><td class=\"n\">{}</td></tr>\n",
        trimmed(group.stop_force_n, 3),
        label_name(group.held),
        group.pairs,
        group.without,
        fixed(100.0 * group.without as f64 / group.pairs.max(1) as f64, 1),
        group.both_without,
        fixed(change.median, 2),
        fixed(change.p05, 2),
        fixed(change.p95, 2),
        if group.held {
            optional(auroc, 2)
        } else {
            MISSING.to_owned()
        }
    );
}
