//! What was left out, what it cost, how the numbers are defined and how to repeat them.

use std::fmt::Write as _;

use super::text::{Esc, duration, engine_name, force_name, trimmed};
use super::{Page, open_wide, put};

pub(super) fn left_out(page: &Page<'_>, out: &mut String) {
    page.open_section(out, "left-out", "Left out");
    if page.report.left_out.is_empty() {
        out.push_str("<p>Nothing: every grasp of the dataset was replayed.</p>\n</section>\n");
        return;
    }
    out.push_str("<p>Not in the scores, and why.</p>\n");
    open_wide(out, "Left out");
    out.push_str(
        "<table class=\"data text\"><thead><tr><th scope=\"col\">Grasp</th>\
         <th scope=\"col\">Object</th><th scope=\"col\">Reason</th></tr></thead><tbody>\n",
    );
    for left in &page.report.left_out {
        put!(
            out,
            "<tr><th scope=\"row\">{}</th><td>{}</td><td>{}</td></tr>\n",
            Esc(&left.grasp),
            Esc(&left.object),
            Esc(&left.reason)
        );
    }
    out.push_str("</tbody></table></div>\n</section>\n");
}

pub(super) fn cost(page: &Page<'_>, out: &mut String) {
    page.open_section(out, "cost", "Cost");
    let cost = &page.report.cost;
    put!(
        out,
        "<p>{} cases, {} of them simulated in this run ({} at a time, {} by the clock) and {} \
         found finished. Processor: {}.</p>\n",
        cost.cases,
        cost.simulated_now,
        cost.jobs,
        duration(cost.wall_s),
        cost.cases.saturating_sub(cost.simulated_now),
        Esc(&cost.processor)
    );
    open_wide(out, "Cost");
    out.push_str(
        "<table class=\"data\"><thead><tr><th scope=\"col\">Engine</th>\
         <th scope=\"col\">CPU time, all cases</th><th scope=\"col\">a grasp, all settings</th>\
         <th scope=\"col\">frictions</th><th scope=\"col\">forces, N</th></tr></thead><tbody>\n",
    );
    let grasps = page.report.grasps.len().max(1) as f64;
    for engine in &page.report.engines {
        let cpu = cost.cpu_s.get(&engine.name).copied().unwrap_or(f64::NAN);
        let list = |values: &[f64]| -> String {
            let values: Vec<String> = values.iter().map(|v| trimmed(*v, 3)).collect();
            values.join(", ")
        };
        put!(
            out,
            "<tr><th scope=\"row\">{}</th><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>\n",
            Esc(engine_name(&engine.name)),
            duration(cpu),
            duration(cpu / grasps),
            list(&engine.frictions),
            list(&engine.forces_n)
        );
    }
    out.push_str("</tbody></table></div>\n");
    for engine in &page.report.engines {
        let parameters = serde_json::to_string_pretty(&engine.parameters).unwrap_or_default();
        put!(
            out,
            "<details><summary>{}: all other parameters</summary><pre>{}</pre></details>\n",
            Esc(engine_name(&engine.name)),
            Esc(&parameters)
        );
    }
    out.push_str("</section>\n");
}

pub(super) fn notes(page: &Page<'_>, out: &mut String) {
    page.open_section(out, "notes", "How to repeat it, and what the numbers mean");
    put!(
        out,
        "<p>The command that repeats it:</p>\n<pre class=\"command\">{}</pre>\n<dl class=\"notes\">\n",
        Esc(&page.report.command)
    );
    let reality = match page.simulated() {
        Some(how) => format!("Simulated, not measured: {}", Esc(&with_stop(how))),
        None => "The outcome that was recorded with the grasp.".to_owned(),
    };
    let mut note = |name: &str, text: &str| put!(out, "<dt>{name}</dt><dd>{text}</dd>\n");
    note("Reality", &reality);
    note(
        "Agreement",
        "A simulated grasp counts as held if its outcome is <i>held</i>, and as lost if the object \
         slipped, was squeezed out or missed, or the fingers met. A case without outcome (it did not \
         converge or could not begin) is not counted, and said apart.",
    );
    note(
        "Choice of the setting",
        "Friction and force are unknown, so all are tried. <i>The paper’s way</i> takes the friction \
         with most agreement when each object has its best force, and then that force. It is \
         chosen on the same grasps that it is scored on, and so too favourable; <i>leave one grasp \
         out</i> and <i>leave one object out</i> are not.",
    );
    note(
        "Intervals",
        "Wilson’s score interval at 95&nbsp;% for a share of independent grasps. The duel is \
         McNemar’s test with exact binomial probabilities, two-sided, on the grasps where just one \
         engine is right.",
    );
    let forces: Vec<String> = page.report.engines.iter().map(force).collect();
    note("Force", &forces.join(" "));
    note(
        "Disagreement",
        "Of all settings with an outcome, the share whose outcome is not that of the dataset. One \
         that disagrees everywhere points at geometry, pose or model rather than at friction or \
         force.",
    );
    note(
        "Drawn poses",
        "The grasp replayed at the chosen setting with poses drawn from the covariance of its \
         annotation. Where half of them end as the dataset says, the pose error explains a \
         disagreement.",
    );
    out.push_str("</dl>\n</section>\n");
}

fn force(engine: &crate::report::EngineFacts) -> String {
    let meaning = match engine.name.as_str() {
        "fem" => "the normal force on the gels at which the fingers stop closing",
        _ => "the force with which the fingers are driven",
    };
    format!(
        "{}: {}, {meaning}.",
        Esc(engine_name(&engine.name)),
        force_name(&engine.name)
    )
}

fn with_stop(text: &str) -> String {
    let text = text.trim_end();
    if text.ends_with(['.', '!', '?']) {
        text.to_owned()
    } else {
        format!("{text}.")
    }
}
