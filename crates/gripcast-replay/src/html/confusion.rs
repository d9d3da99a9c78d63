//! Confusion of each engine with reality, and the duel of both.

use std::fmt::Write as _;

use super::text::{Esc, engine_name, p_value};
use super::{Page, put};
use crate::report::{Duel, EngineFacts};

pub(super) fn sections(page: &Page<'_>, out: &mut String) {
    page.open_section(out, "confusion", "Confusion and duel");
    put!(
        out,
        "<p>Counts of grasps at the paper’s choice. Outlined cells disagree with {}.</p>\n\
         <div class=\"row\">\n",
        page.reality()
    );
    for engine in &page.report.engines {
        matrix(page, out, engine);
    }
    match &page.report.duel {
        Some(duel) => duel_table(out, duel),
        None => out.push_str("<p class=\"nothing\">Only one engine ran: no duel.</p>\n"),
    }
    out.push_str("</div>\n</section>\n");
}

fn matrix(page: &Page<'_>, out: &mut String, engine: &EngineFacts) {
    let c = &engine.scores.confusion;
    put!(
        out,
        "<table class=\"square\"><caption>{}</caption><thead><tr><td rowspan=\"2\"></td>\
         <th colspan=\"2\" scope=\"colgroup\">engine</th></tr>\
         <tr><th scope=\"col\">held</th><th scope=\"col\">lost</th></tr></thead>\
         <tbody><tr><th scope=\"row\">{reality}: held</th><td>{}</td><td class=\"off\">{}</td></tr>\
         <tr><th scope=\"row\">{reality}: lost</th><td class=\"off\">{}</td><td>{}</td></tr></tbody>\
         <tfoot><tr><td colspan=\"3\">without outcome: {}</td></tr></tfoot></table>\n",
        Esc(engine_name(&engine.name)),
        c.true_stable,
        c.false_slip,
        c.false_stable,
        c.true_slip,
        engine.without_outcome,
        reality = page.reality()
    );
}

fn duel_table(out: &mut String, duel: &Duel) {
    let [only_fem, only_rigid] = duel.leave_one_out;
    put!(
        out,
        "<table class=\"square\"><caption>Duel (McNemar)</caption><thead><tr><td></td>\
         <th scope=\"col\">rigid right</th><th scope=\"col\">rigid wrong</th></tr></thead>\
         <tbody><tr><th scope=\"row\">finite elements right</th><td>{}</td>\
         <td class=\"off\">{}</td></tr>\
         <tr><th scope=\"row\">finite elements wrong</th><td class=\"off\">{}</td>\
         <td>{}</td></tr></tbody>\
         <tfoot><tr><td colspan=\"3\">exact, two-sided: {}<br>leave one grasp out: {only_fem} \
         against {only_rigid}, {}</td></tr></tfoot></table>\n",
        duel.both,
        duel.only_fem,
        duel.only_rigid,
        duel.neither,
        p_value(duel.mcnemar_p),
        p_value(duel.leave_one_out_p)
    );
}
