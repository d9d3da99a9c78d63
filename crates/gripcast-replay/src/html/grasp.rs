//! Every grasp: what was recorded and what each engine made of it.

use std::fmt::Write as _;

use super::grasp_index::{attributes, disagreeing};
use super::grid::Grid;
use super::text::{
    Agreement, Esc, MISSING, duration, engine_name, fixed, force_name, label_name, optional,
    outcome_name, trimmed,
};
use super::{Page, curves, picture, put};
use crate::report::{GraspFacts, GraspReplay, PoseSamples, Setting, TactilePair};

pub(super) fn section(page: &Page<'_>, out: &mut String) {
    page.open_section(out, "grasps", "Grasp by grasp");
    put!(
        out,
        "<p>Pictures: {real} beside simulated. Tactile pictures are grasp minus initial, mid-grey \
         is no change; the third is {real} minus simulated. IoU: overlap of both contact masks by \
         their union; FVE: share of the variance that the simulation explains; PSNR and L1: of the \
         difference picture. Curves are those of the paper’s choice; the bands behind them are closure, \
         adjustment and lift.</p>\n",
        real = page.real()
    );
    for (i, grasp) in page.report.grasps.iter().enumerate() {
        article(page, out, i, grasp);
    }
    out.push_str("</section>\n");
}

fn article(page: &Page<'_>, out: &mut String, i: usize, grasp: &GraspFacts) {
    put!(
        out,
        "<article id=\"g{i}\" {}>\n<h3>{} <span>{}</span></h3><p class=\"outcomes\">\
         <span>{}: <b>{}</b></span>",
        attributes(page, grasp),
        Esc(&grasp.id),
        Esc(&grasp.object),
        page.real(),
        label_name(grasp.stable)
    );
    for replay in &grasp.replays {
        let agreement = Agreement(replay.agrees);
        put!(
            out,
            "<span class=\"{}\">{}: <b>{}</b> {} {}</span>",
            agreement.class(),
            Esc(engine_name(&replay.engine)),
            Esc(outcome_name(&replay.case.outcome)),
            agreement.sign(),
            agreement.word()
        );
    }
    out.push_str("</p>\n");
    pictures(page, out, i, grasp);
    out.push_str("<div class=\"engines\">\n");
    for replay in &grasp.replays {
        engine(out, grasp, replay);
    }
    out.push_str("</div>\n");
    pose(out, grasp);
    out.push_str("</article>\n");
}

fn pictures(page: &Page<'_>, out: &mut String, i: usize, grasp: &GraspFacts) {
    if grasp.view.is_none() && grasp.tactile.is_empty() {
        return;
    }
    out.push_str("<div class=\"strip\">\n");
    if let Some(view) = &grasp.view {
        out.push_str("<figure class=\"view\"><div>");
        let alt = format!("grasp {}, camera, {}", grasp.id, page.real());
        picture::picture(out, &view.real, &format!("g{i}v"), &alt);
        let alt = format!("grasp {}, camera, simulated", grasp.id);
        picture::picture(out, &view.sim, &format!("g{i}w"), &alt);
        put!(
            out,
            "</div><figcaption>camera: {} | simulated</figcaption></figure>\n",
            page.real()
        );
    }
    out.push_str("<div class=\"gels\">");
    for (k, pair) in grasp.tactile.iter().enumerate() {
        tactile(page, out, &format!("g{i}"), k, &grasp.id, pair);
    }
    out.push_str("</div></div>\n");
}

fn tactile(page: &Page<'_>, out: &mut String, id: &str, k: usize, grasp: &str, pair: &TactilePair) {
    out.push_str("<figure><div>");
    let three = [
        (&pair.pictures.real, "r", page.real()),
        (&pair.pictures.sim, "s", "simulated"),
        (&pair.difference, "d", "difference"),
    ];
    for (uri, letter, name) in three {
        let alt = format!("grasp {grasp}, {} sensor, {name}", pair.sensor);
        picture::picture(out, uri, &format!("{id}{letter}{k}"), &alt);
    }
    put!(
        out,
        "</div><figcaption>{} sensor:<br>{} | simulated | difference<span>IoU {}</span>\
         <span>FVE {}</span><span>PSNR {} dB</span><span>L1 {}</span></figcaption></figure>\n",
        Esc(&pair.sensor),
        page.real(),
        optional(pair.contact_iou, 2),
        optional(pair.fve, 2),
        optional(pair.psnr_db, 1),
        optional(pair.l1, 1)
    );
}

fn engine(out: &mut String, grasp: &GraspFacts, replay: &GraspReplay) {
    put!(
        out,
        "<div class=\"engine\"><h4>{} <span>friction {}, {} {} N</span></h4>\n",
        Esc(engine_name(&replay.engine)),
        trimmed(replay.chosen.friction, 3),
        force_name(&replay.engine),
        trimmed(replay.chosen.force_n, 2)
    );
    curves::figure(out, replay, &grasp.id);
    if let Some(detail) = &replay.case.detail {
        put!(out, "<p class=\"detail\">{}</p>\n", Esc(detail));
    }
    if let Some(samples) = &replay.pose_samples {
        put!(
            out,
            "<p class=\"detail\">{}</p>\n",
            pose_error(samples, grasp.stable, replay)
        );
    }
    out.push_str("<div class=\"side\">");
    settings(out, replay);
    solver(out, replay);
    out.push_str("</div></div>\n");
}

/// What poses drawn from the covariance say about a disagreement.
fn pose_error(samples: &PoseSamples, stable: bool, replay: &GraspReplay) -> String {
    let PoseSamples { n, stable: held } = *samples;
    if n == 0 {
        return "None of the drawn poses has an outcome.".to_owned();
    }
    let as_reality = if stable { held } else { n.saturating_sub(held) };
    let meaning = match replay.agrees {
        Some(false) if 2 * as_reality >= n => "the pose error explains the disagreement",
        Some(false) if as_reality > 0 => "the pose error can explain the disagreement",
        Some(false) => "the pose error does not explain the disagreement",
        Some(true) if as_reality == n => "the agreement does not hang on the pose error",
        Some(true) => "the outcome hangs on the pose error",
        None => "the annotated pose itself has no outcome",
    };
    format!("{held} of {n} drawn poses held: {meaning}.")
}

/// Outcome at every setting.
fn settings(out: &mut String, replay: &GraspReplay) {
    let grid = Grid::of(replay.cells.iter().map(|cell| cell.setting));
    if grid.forces_n.is_empty() {
        return;
    }
    put!(
        out,
        "<table class=\"cells\"><caption>{} settings disagree</caption><thead><tr>\
         <th scope=\"col\">friction</th>",
        disagreeing(replay)
    );
    for &force_n in &grid.forces_n {
        put!(out, "<th scope=\"col\">{} N</th>", trimmed(force_n, 2));
    }
    out.push_str("</tr></thead><tbody>");
    for &friction in grid.frictions.iter().rev() {
        put!(out, "<tr><th scope=\"row\">{}</th>", trimmed(friction, 3));
        for &force_n in &grid.forces_n {
            setting(out, replay, Setting { friction, force_n });
        }
        out.push_str("</tr>");
    }
    out.push_str("</tbody></table>");
}

fn setting(out: &mut String, replay: &GraspReplay, setting: Setting) {
    let Some(cell) = replay.cells.iter().find(|cell| cell.setting == setting) else {
        put!(out, "<td>{MISSING}</td>");
        return;
    };
    let agreement = Agreement(cell.agrees);
    let chosen = if setting == replay.chosen {
        " chosen"
    } else {
        ""
    };
    put!(
        out,
        "<td class=\"{}{chosen}\">{} {}</td>",
        agreement.class(),
        agreement.sign(),
        Esc(outcome_name(&cell.outcome))
    );
}

fn solver(out: &mut String, replay: &GraspReplay) {
    let case = &replay.case;
    out.push_str("<dl class=\"counts\">");
    let mut fact = |name: &str, value: &str| {
        put!(out, "<div><dt>{name}</dt><dd>{value}</dd></div>");
    };
    let height = fixed(1e3 * case.min_height_m, 1);
    fact("lowest point at the end", &format!("{height} mm"));
    fact(
        "centre of mass rose",
        &format!("{} mm", fixed(1e3 * case.lifted_m, 1)),
    );
    fact(
        "force before the lift",
        &format!("{} N", optional(case.force_n, 1)),
    );
    fact("steps", &case.steps.to_string());
    if case.newton_iterations > 0 {
        let each = case.newton_iterations as f64 / case.steps.max(1) as f64;
        fact(
            "Newton iterations",
            &format!("{} ({} a step)", case.newton_iterations, fixed(each, 1)),
        );
        fact("steps not converged", &case.unconverged_steps.to_string());
    }
    fact("CPU time", &duration(case.cpu_s));
    out.push_str("</dl>");
}

fn pose(out: &mut String, grasp: &GraspFacts) {
    let [x, y, z, quaternion @ ..] = grasp.t_object_gripper;
    put!(
        out,
        "<p class=\"pose\">Gripper in the object’s frame: ({}) mm, quaternion wxyz ({})",
        [x, y, z].map(|v| fixed(1e3 * v, 2)).join(", "),
        quaternion.map(|v| fixed(v, 4)).join(", ")
    );
    if let Some(sd) = grasp.pose_sd_m {
        let sd = sd.map(|v| fixed(1e3 * v, 2)).join(", ");
        put!(out, "; standard deviation ({sd}) mm");
    }
    if let Some(sd) = grasp.pose_sd_rad {
        let sd = sd.map(|v| fixed(v.to_degrees(), 2)).join(", ");
        put!(out, "; ({sd})°");
    }
    out.push_str(".</p>\n");
}
