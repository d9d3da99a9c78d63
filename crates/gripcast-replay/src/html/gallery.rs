//! Grasps where an engine disagrees with reality, the most certain first.

use std::fmt::Write as _;

use super::grasp_index::disagreeing;
use super::text::{Agreement, Esc, engine_name, fixed, label_name, outcome_name};
use super::{Page, picture, put};
use crate::report::{GraspFacts, GraspReplay};

pub(super) fn section(page: &Page<'_>, out: &mut String) {
    page.open_section(out, "failures", "Failures");
    let failures = failures(page);
    if failures.is_empty() {
        put!(
            out,
            "<p>No engine disagrees with {} at the paper’s choice.</p>\n</section>\n",
            page.reality()
        );
        return;
    }
    put!(
        out,
        "<p>{} of {} grasps where an engine disagrees with {} at the paper’s choice; ordered by \
         the share of settings that disagree. Where all do, no choice of friction and force mends it.</p>\n\
         <ol class=\"cards\">\n",
        failures.len(),
        page.report.grasps.len(),
        page.reality()
    );
    for i in failures {
        card(page, out, i, &page.report.grasps[i]);
    }
    out.push_str("</ol>\n</section>\n");
}

/// Numbers of the grasps, by the greatest share of settings that disagree, then by the engines
/// that do.
fn failures(page: &Page<'_>) -> Vec<usize> {
    let wrong = |grasp: &GraspFacts| -> (f64, usize) {
        let replays = grasp.replays.iter().filter(|r| r.agrees == Some(false));
        replays.fold((f64::NEG_INFINITY, 0), |(most, n), r| {
            (most.max(r.disagreement), n + 1)
        })
    };
    let grasps = page.report.grasps.iter().enumerate();
    let mut found: Vec<(usize, (f64, usize))> = grasps
        .map(|(i, grasp)| (i, wrong(grasp)))
        .filter(|(_, (_, engines))| *engines > 0)
        .collect();
    found.sort_by(|(_, a), (_, b)| b.0.total_cmp(&a.0).then(b.1.cmp(&a.1)));
    found.into_iter().map(|(i, _)| i).collect()
}

fn card(page: &Page<'_>, out: &mut String, i: usize, grasp: &GraspFacts) {
    put!(
        out,
        "<li><h3><a href=\"#g{i}\">{}</a> <span>{}</span></h3><div class=\"thumbs\">",
        Esc(&grasp.id),
        Esc(&grasp.object)
    );
    if let Some(view) = &grasp.view {
        let alt = format!("grasp {}, camera, {}", grasp.id, page.real());
        picture::again(out, &view.real, &format!("g{i}v"), &alt);
    }
    for (k, pair) in grasp.tactile.iter().take(2).enumerate() {
        let alt = format!(
            "grasp {}, {} sensor, {}",
            grasp.id,
            pair.sensor,
            page.real()
        );
        picture::again(out, &pair.pictures.real, &format!("g{i}r{k}"), &alt);
    }
    put!(
        out,
        "</div><dl><div><dt>{}</dt><dd>{}</dd></div>",
        page.real(),
        label_name(grasp.stable)
    );
    for replay in &grasp.replays {
        outcome(out, replay);
    }
    out.push_str("</dl></li>\n");
}

fn outcome(out: &mut String, replay: &GraspReplay) {
    let agreement = Agreement(replay.agrees);
    put!(
        out,
        "<div class=\"{}\"><dt>{}</dt><dd>{} {} <small>{} settings disagree",
        agreement.class(),
        Esc(engine_name(&replay.engine)),
        agreement.sign(),
        Esc(outcome_name(&replay.case.outcome)),
        disagreeing(replay)
    );
    if let (Some(samples), Some(false)) = (&replay.pose_samples, replay.agrees) {
        put!(out, "; {} of {} poses held", samples.stable, samples.n);
    }
    put!(
        out,
        "; height {} mm</small></dd></div>",
        fixed(1e3 * replay.case.min_height_m, 1)
    );
}
