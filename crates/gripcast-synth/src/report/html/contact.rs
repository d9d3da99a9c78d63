//! What the tactile images show, and images that are there twice.

use super::percent;
use crate::report::facts::SynthReport;
use gripcast_report::page::{self, Table, nothing, number, text};
use gripcast_report::{MISSING, fixed, label_name, optional, trimmed};
use maud::{Markup, Render, html};

pub(super) fn section(report: &SynthReport) -> Markup {
    let contact = &report.contact;
    let body = html! {
        p {
            "One rendering of each simulation with a label, both sensors. A pair shows no contact \
             where less than " (trimmed(100.0 * contact.least_changed, 3)) "\u{a0}% of its pixels \
             change by more than " (contact.changed_levels) " grey levels. If lost grasps showed \
             none, a model could tell the label from that alone."
        }
        @if contact.groups.is_empty() {
            (nothing("There are no images yet."))
        } @else {
            p.verdict {
                "No contact is seen in " b { (percent(without(report, true))) }
                " of the pairs of held grasps and in " b { (percent(without(report, false))) }
                " of those of lost ones."
            }
            (groups(report))
            p {
                "AUROC: how often a held grasp changes the images of both sensors more than a \
                 lost one of the same force; 0.5 tells nothing, and neither 0 nor 1 is wanted."
            }
        }
        @match &report.dataset {
            Some(dataset) => p {
                "Renderings of the dataset whose tactile images are also those of another \
                 simulation: " b { (dataset.merge.duplicates) } "."
            },
            None => (nothing("Duplicates are counted when merging.")),
        }
    };
    page::section("contact", "Contact in the tactile images", body)
}

/// Fraction of the pairs of a label that show no contact.
fn without(report: &SynthReport, held: bool) -> Option<f64> {
    let groups = report.contact.groups.iter().filter(|g| g.held == held);
    let [without, pairs] = groups.fold([0, 0], |[w, p], g| [w + g.without, p + g.pairs]);
    (pairs > 0).then(|| without as f64 / pairs as f64)
}

fn groups(report: &SynthReport) -> Table {
    let columns = [
        text("Force, N"),
        text("Label"),
        number("pairs"),
        number("without contact"),
        number("simulations without on both sensors"),
        number("mean change, grey levels: median (5 to 95\u{a0}%)"),
        number("AUROC of the mean change"),
    ];
    let mut table = Table::new("Contact by force and label", columns);
    for group in &report.contact.groups {
        let separation = report.contact.separation.iter();
        let mut of_force = separation.filter(|one| one.stop_force_n == group.stop_force_n);
        let auroc = of_force.next().and_then(|one| one.auroc);
        let without = 100.0 * group.without as f64 / group.pairs.max(1) as f64;
        let change = &group.mean_change;
        table.row([
            &trimmed(group.stop_force_n, 3) as &dyn Render,
            &label_name(group.held),
            &group.pairs,
            &format!("{} ({}\u{a0}%)", group.without, fixed(without, 1)),
            &group.both_without,
            &format!(
                "{} ({} to {})",
                fixed(change.median, 2),
                fixed(change.p05, 2),
                fixed(change.p95, 2)
            ),
            &if group.held {
                optional(auroc, 2)
            } else {
                MISSING.to_owned()
            },
        ]);
    }
    table
}
