//! Grasps on which an engine disagrees with reality, the most certain first.

use super::Page;
use super::grasp_index::disagreeing;
use super::text::Agreement;
use crate::report::{GraspFacts, GraspReplay};
use gripcast_report::image::repeat_image;
use gripcast_report::{engine_name, fixed, outcome_label};
use maud::{Markup, html};

pub(super) fn section(page: &Page<'_>) -> Markup {
    let failures = failures(page);
    let body = html! {
        @if failures.is_empty() {
            p { "No engine disagrees with " (page.reality()) " at the paper’s choice." }
        } @else {
            p {
                (failures.len()) " of " (page.report.grasps.len()) " grasps on which an engine \
                 disagrees with " (page.reality()) " at the paper’s choice, sorted by the fraction \
                 of disagreeing settings. If all disagree, no friction and force is right."
            }
            ol.cards {
                @for &i in &failures { (card(page, i, &page.report.grasps[i])) }
            }
        }
    };
    page.section("failures", "Failures", body)
}

/// Indices of the grasps, sorted by the maximum fraction of disagreeing settings, then by the
/// number of disagreeing engines.
fn failures(page: &Page<'_>) -> Vec<usize> {
    let disagreement = |grasp: &GraspFacts| -> (f64, usize) {
        let replays = grasp.replays.iter().filter(|r| r.agrees == Some(false));
        replays.fold((f64::NEG_INFINITY, 0), |(max, n), r| {
            (max.max(r.disagreement), n + 1)
        })
    };
    let grasps = page.report.grasps.iter().enumerate();
    let mut found: Vec<(usize, (f64, usize))> = grasps
        .map(|(i, grasp)| (i, disagreement(grasp)))
        .filter(|(_, (_, engines))| *engines > 0)
        .collect();
    found.sort_by(|(_, a), (_, b)| b.0.total_cmp(&a.0).then(b.1.cmp(&a.1)));
    found.into_iter().map(|(i, _)| i).collect()
}

fn card(page: &Page<'_>, i: usize, grasp: &GraspFacts) -> Markup {
    let alt = |what: &str| format!("grasp {}, {what}, {}", grasp.id, page.real());
    html! {
        li {
            h3 {
                a href={ "#g" (i) } { (grasp.id) }
                " " span { (grasp.object) }
            }
            div.thumbs {
                @if let Some(view) = &grasp.view {
                    (repeat_image(&view.real, &format!("g{i}v"), &alt("camera")))
                }
                @for (k, pair) in grasp.tactile.iter().take(2).enumerate() {
                    @let alt = alt(&format!("{} sensor", pair.sensor));
                    (repeat_image(&pair.images.real, &format!("g{i}r{k}"), &alt))
                }
            }
            dl {
                div {
                    dt { (page.real()) }
                    dd { (outcome_label(grasp.stable)) }
                }
                @for replay in &grasp.replays { (outcome(replay)) }
            }
        }
    }
}

fn outcome(replay: &GraspReplay) -> Markup {
    html! {
        div {
            dt { (engine_name(&replay.engine)) }
            dd {
                (Agreement(replay.agrees).outcome(&replay.case.outcome))
                small {
                    (disagreeing(replay)) " settings disagree"
                    @if let (Some(samples), Some(false)) = (&replay.pose_samples, replay.agrees) {
                        "; " (samples.stable) " of " (samples.n) " poses stable"
                    }
                    "; height " (fixed(1e3 * replay.case.min_height_m, 1)) " mm"
                }
            }
        }
    }
}
