//! What changed against an earlier report.

use std::fmt::Write as _;

use super::text::{Agreement, Esc, MISSING, engine_name, fixed, optional, outcome_name};
use super::{Page, open_wide, put};
use crate::report::{ChangedOutcome, Changes};

pub(super) fn section(page: &Page<'_>, out: &mut String) {
    let Some(changes) = &page.report.changes else {
        return;
    };
    page.open_section(out, "changes", "Changes against an earlier report");
    put!(
        out,
        "<p>Compared with <code>{}</code>, written by {}.</p>\n",
        Esc(&changes.path),
        Esc(&changes.software)
    );
    list(out, "Conditions that differ", &changes.conditions);
    scores(out, changes);
    outcomes(page, out, &changes.outcomes);
    list(out, "Grasps only in this report", &changes.added);
    list(out, "Grasps only in the earlier report", &changes.removed);
    out.push_str("</section>\n");
}

fn list(out: &mut String, title: &str, items: &[String]) {
    if items.is_empty() {
        return;
    }
    put!(out, "<h3>{title} ({})</h3>\n<ul>\n", items.len());
    for item in items {
        put!(out, "<li>{}</li>\n", Esc(item));
    }
    out.push_str("</ul>\n");
}

fn scores(out: &mut String, changes: &Changes) {
    if changes.scores.is_empty() {
        return;
    }
    open_wide(out, "Scores then and now");
    out.push_str(
        "<table class=\"data\"><thead><tr><th scope=\"col\">Engine, the paper’s way</th>\
         <th scope=\"col\">then</th><th scope=\"col\">now</th><th scope=\"col\">difference</th>\
         </tr></thead><tbody>\n",
    );
    for (engine, [then, now]) in &changes.scores {
        let difference = match (then, now) {
            (Some(then), Some(now)) if now > then => format!("+{}", fixed(now - then, 2)),
            (Some(then), Some(now)) => fixed(now - then, 2),
            _ => MISSING.to_owned(),
        };
        put!(
            out,
            "<tr><th scope=\"row\">{}</th><td>{}</td><td>{}</td><td>{difference}</td></tr>\n",
            Esc(engine_name(engine)),
            optional(*then, 2),
            optional(*now, 2)
        );
    }
    out.push_str("</tbody></table></div>\n");
}

fn outcomes(page: &Page<'_>, out: &mut String, outcomes: &[ChangedOutcome]) {
    if outcomes.is_empty() {
        out.push_str("<p>No outcome changed.</p>\n");
        return;
    }
    open_wide(out, "Outcomes that changed");
    put!(
        out,
        "<table class=\"data text\"><caption>Outcomes that changed: {}</caption><thead><tr>\
         <th scope=\"col\">Grasp</th><th scope=\"col\">Object</th><th scope=\"col\">Engine</th>\
         <th scope=\"col\">then</th><th scope=\"col\">now</th><th scope=\"col\">{}</th></tr>\
         </thead><tbody>\n",
        outcomes.len(),
        page.reality()
    );
    for changed in outcomes {
        let agreement = Agreement(changed.agrees);
        put!(
            out,
            "<tr><th scope=\"row\">{}</th><td>{}</td><td>{}</td><td>{}</td><td>{}</td>\
             <td class=\"{}\">{} {}</td></tr>\n",
            Esc(&changed.grasp),
            Esc(&changed.object),
            Esc(engine_name(&changed.engine)),
            Esc(outcome_name(&changed.before)),
            Esc(outcome_name(&changed.after)),
            agreement.class(),
            agreement.sign(),
            agreement.word()
        );
    }
    out.push_str("</tbody></table></div>\n");
}
