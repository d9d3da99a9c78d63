//! The summary: what was planned, how far it is, and that all of it is simulated.

use std::fmt::Write as _;

use super::{percent, short};
use crate::report::facts::SynthReport;
use gripcast_report::{Esc, duration, engine_name, fixed, outcome_name, put, trimmed};

pub(super) fn summary(report: &SynthReport, out: &mut String) {
    let (plan, progress) = (&report.plan, &report.progress);
    put!(
        out,
        "<section id=\"summary\">\n<h1>Simulated grasps: plan {}</h1>\n\
         <p class=\"simulated\" role=\"note\"><b>Everything here is simulated and rendered.</b> No \
         grasp was made by a robot and no picture was taken by a camera; whether an object was held \
         is what a simulator says.</p>\n",
        Esc(&short(&plan.sha256))
    );
    put!(
        out,
        "<p class=\"verdict\"><b>{} of {}</b> planned simulations are done: <b>{}</b> held, \
         <b>{}</b> were lost ({} held), {}. They make {} renderings of {} objects in {} \
         categories.</p>\n",
        progress.done,
        plan.simulations,
        progress.labels.held,
        progress.labels.lost,
        percent(progress.labels.share()),
        without_label(report),
        progress.rows,
        plan.objects,
        plan.categories
    );
    warnings(report, out);
    facts(report, out);
    out.push_str("</section>\n");
}

fn without_label(report: &SynthReport) -> String {
    let progress = &report.progress;
    match (progress.done - progress.labels.all(), progress.failed) {
        (0, _) => "none is without a label".to_owned(),
        (without, 0) => format!("<b>{without}</b> gave no label"),
        (without, failed) => {
            format!("<b>{without}</b> gave no label, of which {failed} could not be simulated")
        }
    }
}

/// What is not as it should be when a dataset is finished.
fn warnings(report: &SynthReport, out: &mut String) {
    let progress = &report.progress;
    let mut warn = |text: String| put!(out, "<p class=\"warning\">{text}</p>\n");
    if progress.open > 0 {
        warn(format!(
            "Simulations without a result: {}. This report shows the plan as far as it is; \
             <code>gripcast synth run</code> goes on with it.",
            progress.open
        ));
    }
    if !progress.damaged.is_empty() {
        let names: Vec<String> = progress
            .damaged
            .iter()
            .take(5)
            .map(|id| Esc(id).to_string())
            .collect();
        warn(format!(
            "Of these, damaged results that <code>gripcast synth run</code> makes again: {} \
             ({}{}).",
            progress.damaged.len(),
            names.join(", "),
            if progress.damaged.len() > names.len() {
                ", …"
            } else {
                ""
            }
        ));
    }
    if let Some(dataset) = &report.dataset
        && dataset.later_results > 0
    {
        warn(format!(
            "The dataset was merged before {} of the results were there.",
            dataset.later_results
        ));
    }
}

fn facts(report: &SynthReport, out: &mut String) {
    let (plan, progress) = (&report.plan, &report.progress);
    out.push_str("<dl class=\"facts\">\n");
    let mut fact = |name: &str, value: String| {
        put!(out, "<div><dt>{name}</dt><dd>{value}</dd></div>\n");
    };
    let code = |text: &str| format!("<code>{}</code>", Esc(text));
    fact("SHA-256 of the plan", code(&plan.sha256));
    fact(
        "Preset and seed",
        format!("{}, {}", Esc(&plan.preset), plan.seed),
    );
    fact("Simulator", Esc(engine_name(&plan.engine)).to_string());
    let forces: Vec<String> = plan.stop_forces_n.iter().map(|n| trimmed(*n, 3)).collect();
    fact("Forces, N", forces.join(", "));
    fact(
        "Grasps",
        format!(
            "{} poses on {} objects; each at every force is a simulation",
            plan.grasps, plan.objects
        ),
    );
    fact(
        "Renderings",
        format!(
            "{} of each simulation, {} paths a pixel, sensor spread {}, visual spread {}",
            plan.renderings,
            plan.samples,
            trimmed(plan.sensor_spread, 2),
            trimmed(plan.visual_spread, 2)
        ),
    );
    let outcomes: Vec<String> = progress
        .outcomes
        .iter()
        .map(|(name, count)| format!("{count} {}", Esc(outcome_name(name))))
        .collect();
    fact("Outcomes", outcomes.join(", "));
    let total = report.costs.total_s;
    let cpu = total.prepare + total.simulate + total.tactile + total.visual;
    let rate = report.costs.per_core_hour;
    let rate = rate.map_or_else(String::new, |rate| {
        format!(", {} simulations an hour on a core", fixed(rate, 0))
    });
    fact("CPU time", format!("{}{rate}", duration(cpu)));
    fact(
        "Software",
        format!(
            "planned by {}, reported by {}",
            Esc(&plan.software),
            Esc(&report.software)
        ),
    );
    out.push_str("</dl>\n");
}
