//! Summary: the plan, its progress, and the notice that everything is simulated.

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
                " No grasp was performed by a robot and no image was taken by a camera; the labels \
                 are those of a simulator."
            }
            p.verdict {
                b { (progress.done) " of " (plan.simulations) }
                " planned simulations are done: "
                b { (progress.labels.stable) } " stable, "
                b { (progress.labels.slip) } " slip (" (percent(progress.labels.stable_fraction()))
                " stable), " (without_label(report)) ". They have " (progress.rows)
                " renderings of " (plan.objects) " objects in " (plan.categories) " categories."
            }
            (warnings(report))
            (facts(report))
        }
    }
}

fn without_label(report: &SynthReport) -> Markup {
    let progress = &report.progress;
    let without = progress.done - progress.labels.total();
    html! {
        @if without == 0 {
            "none without a label"
        } @else {
            b { (without) } " without a label"
            @if progress.failed > 0 {
                ", of which " (progress.failed) " failed"
            }
        }
    }
}

/// Warnings about an unfinished or damaged plan.
fn warnings(report: &SynthReport) -> Markup {
    const LISTED: usize = 5;
    let progress = &report.progress;
    let run = html! { code { "gripcast synth run" } };
    let damaged = progress.damaged.iter().take(LISTED).map(String::as_str);
    let damaged = damaged.collect::<Vec<_>>().join(", ");
    html! {
        @if progress.open > 0 {
            (warning(html! {
                "Simulations without a result: " (progress.open) ". The plan is unfinished; " (run)
                " resumes it."
            }))
        }
        @if !progress.damaged.is_empty() {
            (warning(html! {
                "Of these, damaged results that " (run) " replaces: " (progress.damaged.len())
                " (" (damaged) @if progress.damaged.len() > LISTED { ", …" } ")."
            }))
        }
        @if let Some(later) = report.dataset.as_ref().map(|d| d.later_results) {
            @if later > 0 {
                (warning(html! {
                    "The dataset is older than " (later) " of the results."
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
    let cpu = total.total();
    let rate = report.costs.per_core_hour;
    let rate = rate.map_or_else(String::new, |rate| {
        format!(", {} simulations per core hour", fixed(rate, 0))
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
            ("Friction from", &plan.friction_from),
            ("Forces, N", &forces.join(", ")),
            (
                "Grasps",
                &format!(
                    "{} poses on {} objects, each simulated at every force",
                    plan.grasps, plan.objects
                ),
            ),
            (
                "Renderings",
                &format!(
                    "{} per simulation, {} samples per pixel, sensor spread {}, visual spread {}",
                    plan.renderings,
                    plan.samples_per_pixel,
                    trimmed(plan.sensor_spread, 2),
                    trimmed(plan.visual_spread, 2)
                ),
            ),
            ("Outcomes", &outcomes.join(", ")),
            ("CPU time", &format!("{}{rate}", duration(cpu))),
            (
                "Software",
                &format!(
                    "plan created by {}, report by {}",
                    plan.software, report.software
                ),
            ),
        ],
    )
}
