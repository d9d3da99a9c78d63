//! Visible contact in the tactile images, and duplicate images.

use super::percent;
use crate::report::facts::SynthReport;
use gripcast_report::page::{self, Table, number, placeholder, text};
use gripcast_report::{MISSING, fixed, optional, outcome_label, trimmed};
use maud::{Markup, Render, html};

pub(super) fn section(report: &SynthReport) -> Markup {
    let contact = &report.contact;
    let body = html! {
        p {
            "One rendering of each labelled simulation, both sensors. A pair shows no contact if less \
             than " (trimmed(100.0 * contact.min_changed, 3)) "\u{a0}% of its \
             pixels change by more than " (contact.changed_levels) " grey levels. If slips \
             showed no contact, a model could predict the label from that alone."
        }
        @if contact.groups.is_empty() {
            (placeholder("No images yet."))
        } @else {
            p.verdict {
                b { (percent(without(report, true))) } " of the image pairs of stable grasps and "
                b { (percent(without(report, false))) } " of those of slips show no contact."
            }
            (groups(report))
            p {
                "AUROC: probability that a stable grasp changes the images of both sensors more \
                 than a slip at the same force. 0.5 means no separation; values near 0 or 1 are \
                 undesirable."
            }
        }
        @match &report.dataset {
            Some(dataset) => p {
                "Renderings of the dataset with the same tactile images as another simulation: " b { (dataset.merge.duplicates) } "."
            },
            None => (placeholder("Duplicates are counted when merging.")),
        }
    };
    page::section("contact", "Contact in the tactile images", body)
}

/// Fraction of the image pairs of a label without visible contact.
fn without(report: &SynthReport, stable: bool) -> Option<f64> {
    let groups = report.contact.groups.iter().filter(|g| g.stable == stable);
    let [without, pairs] = groups.fold([0, 0], |[w, p], g| [w + g.without, p + g.pairs]);
    (pairs > 0).then(|| without as f64 / pairs as f64)
}

fn groups(report: &SynthReport) -> Table {
    let columns = [
        text("Force, N"),
        text("Label"),
        number("pairs"),
        number("without contact"),
        number("simulations without contact on both sensors"),
        number("mean change, grey levels: median (5 to 95\u{a0}%)"),
        number("AUROC of the mean change"),
    ];
    let mut table = Table::new("Contact by force and label", columns);
    for group in &report.contact.groups {
        let separation = report.contact.separation.iter();
        let mut separation = separation.filter(|one| one.stop_force_n == group.stop_force_n);
        let auroc = separation.next().and_then(|one| one.auroc);
        let without = 100.0 * group.without as f64 / group.pairs.max(1) as f64;
        let change = &group.mean_change;
        table.row([
            &trimmed(group.stop_force_n, 3) as &dyn Render,
            &outcome_label(group.stable),
            &group.pairs,
            &format!("{} ({}\u{a0}%)", group.without, fixed(without, 1)),
            &group.both_without,
            &format!(
                "{} ({} to {})",
                fixed(change.median, 2),
                fixed(change.p05, 2),
                fixed(change.p95, 2)
            ),
            &if group.stable {
                optional(auroc, 2)
            } else {
                MISSING.to_owned()
            },
        ]);
    }
    table
}
