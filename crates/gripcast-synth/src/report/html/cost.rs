//! What it cost, and what gave no label.

use std::fmt::Write as _;

use crate::report::facts::{CostFacts, EstimateFacts, Quantiles, SettingCost, SynthReport};
use gripcast_report::{
    Esc, duration, engine_name, fixed, open_section, open_wide, optional, outcome_name, put,
    trimmed,
};

/// Parts of the work: name in the report, name on the page.
const PARTS: [(&str, &str); 4] = [
    ("prepare", "mesh"),
    ("simulate", "simulation"),
    ("tactile", "tactile pictures"),
    ("visual", "colour pictures"),
];

pub(super) fn section(report: &SynthReport, out: &mut String) {
    open_section(out, "cost", "Cost");
    let costs = &report.costs;
    if costs.simulations == 0 {
        out.push_str("<p class=\"nothing\">Nothing was simulated yet.</p>\n</section>\n");
        return;
    }
    put!(
        out,
        "<p><b>{} simulations an hour on a core</b>, {} of them with a label, with all their \
         pictures. CPU time of {} simulations; those that failed have none.</p>\n",
        optional(costs.per_core_hour, 0),
        optional(costs.labelled_per_core_hour, 0),
        costs.simulations
    );
    split(costs, out);
    settings(&costs.settings, out);
    if let Some(found) = &costs.estimate {
        estimate(found, out);
    }
    out.push_str("</section>\n");
}

fn split(costs: &CostFacts, out: &mut String) {
    let total = costs.total_s;
    let seconds = [total.prepare, total.simulate, total.tactile, total.visual];
    let all: f64 = seconds.iter().sum();
    let share = |s: f64| 100.0 * s / all;
    out.push_str("<div class=\"wide-bar\"><div class=\"stack\" aria-hidden=\"true\">");
    for (k, s) in seconds.iter().enumerate() {
        let width = fixed(share(*s), 2);
        put!(out, "<i class=\"part-{k}\" style=\"width:{width}%\"></i>");
    }
    out.push_str("</div></div>\n");
    open_wide(out, "CPU time by part");
    out.push_str(
        "<table class=\"data\"><thead><tr><th scope=\"col\">Part</th>\
         <th scope=\"col\" class=\"n\">CPU time of all</th><th scope=\"col\" class=\"n\">share</th>\
         <th scope=\"col\" class=\"n\">each: median</th><th scope=\"col\" class=\"n\">95&nbsp;%</th>\
         <th scope=\"col\" class=\"n\">longest</th></tr></thead><tbody>\n",
    );
    for (k, (key, name)) in PARTS.iter().enumerate() {
        let title = format!("<span class=\"key\"><i class=\"part-{k}\"></i></span> {name}");
        let each = costs.each_s.get(*key).copied().unwrap_or_default();
        part_row(&title, seconds[k], share(seconds[k]), &each, out);
    }
    out.push_str("</tbody><tfoot>");
    let each = costs.each_s.get("all").copied().unwrap_or_default();
    part_row("all", all, 100.0, &each, out);
    out.push_str("</tfoot></table></div>\n");
}

fn part_row(title: &str, seconds: f64, share: f64, each: &Quantiles, out: &mut String) {
    put!(
        out,
        "<tr><th scope=\"row\">{title}</th><td class=\"n\">{}</td><td class=\"n\">{}&nbsp;%</td>\
         <td class=\"n\">{}</td><td class=\"n\">{}</td><td class=\"n\">{}</td></tr>\n",
        duration(seconds),
        fixed(share, 1),
        duration(each.median),
        duration(each.p95),
        duration(each.max)
    );
}

fn settings(settings: &[SettingCost], out: &mut String) {
    open_wide(out, "Cost by simulator and force");
    out.push_str(
        "<table class=\"data\"><thead><tr><th scope=\"col\">Simulator</th>\
         <th scope=\"col\" class=\"n\">force, N</th><th scope=\"col\" class=\"n\">simulations</th>\
         <th scope=\"col\" class=\"n\">CPU time of all</th>\
         <th scope=\"col\" class=\"n\">each: median, 95&nbsp;%, longest</th>\
         <th scope=\"col\" class=\"n\">of it simulator</th>\
         <th scope=\"col\" class=\"n\">Newton iterations</th>\
         <th scope=\"col\" class=\"n\">steps not converged</th></tr></thead><tbody>\n",
    );
    for one in settings {
        put!(
            out,
            "<tr><th scope=\"row\">{}</th><td class=\"n\">{}</td><td class=\"n\">{}</td>\
             <td class=\"n\">{}</td><td class=\"n\">{}</td><td class=\"n\">{}</td>\
             <td class=\"n\">{}</td><td class=\"n\">{} of {} in {} simulations</td></tr>\n",
            Esc(engine_name(&one.engine)),
            trimmed(one.stop_force_n, 3),
            one.simulations,
            duration(one.total_s),
            quantiles(&one.all_s, duration),
            quantiles(&one.simulate_s, duration),
            quantiles(&one.newton_iterations, |count| fixed(count, 0)),
            one.unconverged_steps,
            one.steps,
            one.unconverged_simulations
        );
    }
    out.push_str("</tbody></table></div>\n");
}

fn quantiles(of: &Quantiles, show: fn(f64) -> String) -> String {
    format!("{}, {}, {}", show(of.median), show(of.p95), show(of.max))
}

fn estimate(found: &EstimateFacts, out: &mut String) {
    put!(
        out,
        "<p>The plan estimated {}, and {} were found: {} times as much (each: median {}, 5 to \
         95&nbsp;% {} to {}); {}.</p>\n",
        duration(found.estimated_s),
        duration(found.found_s),
        fixed(found.found_s / found.estimated_s, 2),
        fixed(found.ratio.median, 2),
        fixed(found.ratio.p05, 2),
        fixed(found.ratio.p95, 2),
        match found.correlation {
            Some(correlation) => format!("correlation of both {}", fixed(correlation, 2)),
            None => "the estimate is the same for all, or the cost is".to_owned(),
        }
    );
}

pub(super) fn unlabelled(report: &SynthReport, out: &mut String) {
    open_section(out, "unlabelled", "Simulations without a label");
    if report.unlabelled.is_empty() {
        out.push_str("<p>None: every simulation that is done has a label.</p>\n</section>\n");
        return;
    }
    open_wide(out, "Simulations without a label");
    out.push_str(
        "<table class=\"data text\"><thead><tr><th scope=\"col\">Outcome</th>\
         <th scope=\"col\">Reason</th><th scope=\"col\" class=\"n\">simulations</th>\
         <th scope=\"col\">for instance</th></tr></thead><tbody>\n",
    );
    for group in &report.unlabelled {
        put!(
            out,
            "<tr><th scope=\"row\">{}</th><td>{}</td><td class=\"n\">{}</td><td>{}{}</td></tr>\n",
            Esc(outcome_name(&group.outcome)),
            Esc(&group.reason),
            group.count,
            Esc(&group.example),
            in_full(&group.reason, &group.example_reason)
        );
    }
    out.push_str("</tbody></table></div>\n</section>\n");
}

/// The reason with its numbers, where it has any.
fn in_full(reason: &str, full: &str) -> String {
    if reason == full {
        return String::new();
    }
    format!(": {}", Esc(full))
}
