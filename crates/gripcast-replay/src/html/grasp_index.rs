//! All grasps as a table that the script can sort and filter.

use std::fmt::Write as _;

use super::text::{Agreement, Esc, MISSING, engine_name, fixed, label_name, outcome_name};
use super::{Page, open_wide, put};
use crate::report::{GraspFacts, GraspReplay};

pub(super) fn section(page: &Page<'_>, out: &mut String) {
    page.open_section(out, "index", "All grasps");
    put!(
        out,
        "<p>Outcome at the paper’s choice, whether it agrees with {}, the share of settings that \
         disagree, and the height of the object’s lowest point at the end.</p>\n",
        page.reality()
    );
    filters(page, out);
    open_wide(out, "All grasps");
    heading(page, out);
    out.push_str("<tbody>\n");
    for (i, grasp) in page.report.grasps.iter().enumerate() {
        row(page, out, i, grasp);
    }
    out.push_str("</tbody></table></div>\n</section>\n");
}

/// What a grasp is found by; on its row and its article.
pub(super) fn attributes(page: &Page<'_>, grasp: &GraspFacts) -> String {
    let object = page
        .report
        .objects
        .iter()
        .position(|object| object.name == grasp.object)
        .map_or_else(String::new, |i| i.to_string());
    let mut marks = String::new();
    for (i, engine) in page.report.engines.iter().enumerate() {
        if let Some(replay) = replay_of(grasp, &engine.name) {
            put!(marks, " {}{i}", Agreement(replay.agrees).class());
        }
    }
    format!("data-object=\"{object}\" data-marks=\"{}\"", marks.trim())
}

/// What an engine made of a grasp.
pub(super) fn replay_of<'a>(grasp: &'a GraspFacts, engine: &str) -> Option<&'a GraspReplay> {
    grasp.replays.iter().find(|replay| replay.engine == engine)
}

/// Shown by the script alone: without it there is nothing to filter with.
fn filters(page: &Page<'_>, out: &mut String) {
    out.push_str(
        "<form class=\"filters\" hidden><label>Object <select name=\"object\">\
         <option value=\"\">all</option>",
    );
    for (i, object) in page.report.objects.iter().enumerate() {
        put!(out, "<option value=\"{i}\">{}</option>", Esc(&object.name));
    }
    out.push_str(
        "</select></label><label>Show <select name=\"mark\"><option value=\"\">all grasps</option>",
    );
    for (i, engine) in page.report.engines.iter().enumerate() {
        let name = Esc(engine_name(&engine.name)).to_string();
        put!(
            out,
            "<option value=\"no{i}\">{name}: disagrees</option>\
             <option value=\"yes{i}\">{name}: agrees</option>\
             <option value=\"none{i}\">{name}: no outcome</option>"
        );
    }
    put!(
        out,
        "</select></label><label>Id contains <input type=\"search\" name=\"text\"></label>\
         <output>{0} of {0} grasps</output></form>\n",
        page.report.grasps.len()
    );
}

fn heading(page: &Page<'_>, out: &mut String) {
    out.push_str(
        "<table class=\"data index\"><thead><tr><th scope=\"col\">Grasp</th>\
         <th scope=\"col\">Object</th>",
    );
    put!(out, "<th scope=\"col\">{}</th>", label_heading(page));
    for engine in &page.report.engines {
        let name = Esc(engine_name(&engine.name)).to_string();
        put!(
            out,
            "<th scope=\"col\">{name}</th><th scope=\"col\" class=\"n\">settings that \
             disagree</th><th scope=\"col\" class=\"n\">height, mm</th>"
        );
    }
    out.push_str("</tr></thead>\n");
}

fn label_heading(page: &Page<'_>) -> &'static str {
    match page.simulated() {
        Some(_) => "As if real",
        None => "Real",
    }
}

fn row(page: &Page<'_>, out: &mut String, i: usize, grasp: &GraspFacts) {
    put!(
        out,
        "<tr {}><th scope=\"row\"><a href=\"#g{i}\">{}</a></th><td>{}</td><td>{}</td>",
        attributes(page, grasp),
        Esc(&grasp.id),
        Esc(&grasp.object),
        label_name(grasp.stable)
    );
    for engine in &page.report.engines {
        let Some(replay) = replay_of(grasp, &engine.name) else {
            put!(out, "<td>{MISSING}</td><td class=\"n\">{MISSING}</td>");
            put!(out, "<td class=\"n\">{MISSING}</td>");
            continue;
        };
        let agreement = Agreement(replay.agrees);
        put!(
            out,
            "<td class=\"{}\">{} {}</td><td class=\"n\">{}</td><td class=\"n\">{}</td>",
            agreement.class(),
            agreement.sign(),
            Esc(outcome_name(&replay.case.outcome)),
            disagreeing(replay),
            fixed(1e3 * replay.case.min_height_m, 1)
        );
    }
    out.push_str("</tr>\n");
}

/// `3 of 9`: settings that disagree with reality, of those with an outcome.
pub(super) fn disagreeing(replay: &GraspReplay) -> String {
    let known = replay.cells.iter().filter_map(|cell| cell.agrees);
    let (n, wrong) = known.fold((0, 0), |(n, wrong), agrees| {
        (n + 1, wrong + usize::from(!agrees))
    });
    if n == 0 {
        MISSING.to_owned()
    } else {
        format!("{wrong} of {n}")
    }
}
