//! The summary: what was planned, how far it is, and that all of it is simulated.

use super::{percent, short};
use crate::report::facts::SynthReport;
use gripcast_report::page::{definitions, warning};
use gripcast_report::{duration, engine_name, fixed, outcome_name, trimmed};
use maud::{Markup, html};

pub(super) fn summary(report: &SynthReport) -> Markup {
    let (plan, progress) = (&report.plan, &report.progress);
    html! {
        section id="summary" {
            h1 { "Simulated grasps: plan " (short(&plan.sha256)) }
            p.simulated role="note" {
                b { "Everything here is simulated and rendered." }
                " No grasp was made by a robot and no image was taken by a camera; whether an \
                 object was held is what a simulator says."
            }
            p.verdict {
                b { (progress.done) " of " (plan.simulations) }
                " planned simulations are done: "
                b { (progress.labels.held) } " held, "
                b { (progress.labels.lost) } " were lost (" (percent(progress.labels.fraction()))
                " held), " (without_label(report)) ". They make " (progress.rows)
                " renderings of " (plan.objects) " objects in " (plan.categories) " categories."
            }
            (warnings(report))
            (facts(report))
        }
    }
}

fn without_label(report: &SynthReport) -> Markup {
    let progress = &report.progress;
    let without = progress.done - progress.labels.all();
    html! {
        @if without == 0 {
            "none is without a label"
        } @else {
            b { (without) } " gave no label"
            @if progress.failed > 0 {
                ", of which " (progress.failed) " could not be simulated"
            }
        }
    }
}

/// What is not as it should be when a dataset is finished.
fn warnings(report: &SynthReport) -> Markup {
    const NAMED: usize = 5;
    let progress = &report.progress;
    let run = html! { code { "gripcast synth run" } };
    let damaged = progress.damaged.iter().take(NAMED).map(String::as_str);
    let damaged = damaged.collect::<Vec<_>>().join(", ");
    html! {
        @if progress.open > 0 {
            (warning(html! {
                "Simulations without a result: " (progress.open) ". This report shows the plan as \
                 far as it is; " (run) " resumes it."
            }))
        }
        @if !progress.damaged.is_empty() {
            (warning(html! {
                "Of these, damaged results that " (run) " makes again: " (progress.damaged.len())
                " (" (damaged) @if progress.damaged.len() > NAMED { ", …" } ")."
            }))
        }
        @if let Some(later) = report.dataset.as_ref().map(|d| d.later_results) {
            @if later > 0 {
                (warning(html! {
                    "The dataset was merged before " (later) " of the results were there."
                }))
            }
        }
    }
}

fn facts(report: &SynthReport) -> Markup {
    let (plan, progress) = (&report.plan, &report.progress);
    let forces: Vec<String> = plan.stop_forces_n.iter().map(|n| trimmed(*n, 3)).collect();
    let outcomes: Vec<String> = progress
        .outcomes
        .iter()
        .map(|(name, count)| format!("{count} {}", outcome_name(name)))
        .collect();
    let total = report.costs.total_s;
    let cpu = total.prepare + total.simulate + total.tactile + total.visual;
    let rate = report.costs.per_core_hour;
    let rate = rate.map_or_else(String::new, |rate| {
        format!(", {} simulations an hour on a core", fixed(rate, 0))
    });
    definitions(
        "facts",
        &[
            ("SHA-256 of the plan", &html! { code { (plan.sha256) } }),
            (
                "Preset and seed",
                &format!("{}, {}", plan.preset, plan.seed),
            ),
            ("Simulator", &engine_name(&plan.engine)),
            ("Forces, N", &forces.join(", ")),
            (
                "Grasps",
                &format!(
                    "{} poses on {} objects; each at every force is a simulation",
                    plan.grasps, plan.objects
                ),
            ),
            (
                "Renderings",
                &format!(
                    "{} of each simulation, {} paths a pixel, sensor spread {}, visual spread {}",
                    plan.renderings,
                    plan.samples,
                    trimmed(plan.sensor_spread, 2),
                    trimmed(plan.visual_spread, 2)
                ),
            ),
            ("Outcomes", &outcomes.join(", ")),
            ("CPU time", &format!("{}{rate}", duration(cpu))),
            (
                "Software",
                &format!(
                    "planned by {}, reported by {}",
                    plan.software, report.software
                ),
            ),
        ],
    )
}
