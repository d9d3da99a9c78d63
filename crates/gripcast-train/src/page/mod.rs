//! An evaluation as one page: no network, no script, light and dark.

mod pictures;
mod tables;

use std::fmt::Write as _;

use super::evaluate::{EvalReport, ModelEvaluation};
use super::metrics::Scored;
use super::metrics::plot::{PrecisionRecallCurve, RocCurve, precision_recall, reliability, roc};
use super::samples::Samples;
use gripcast_base::error::Result;
use gripcast_report::{Esc, open_section, put, section_links, theme_choice};

const STYLE: &str = include_str!("style.css");

/// Sections with their names in the bar.
const SECTIONS: [(&str, &str); 6] = [
    ("summary", "Summary"),
    ("curves", "Curves"),
    ("calibration", "Calibration"),
    ("groups", "Categories"),
    ("mistakes", "Mistakes"),
    ("notes", "Notes"),
];

/// The page of an evaluation; `samples` gives the pictures of the mistakes.
///
/// # Errors
/// Those of reading the samples.
pub fn page(report: &EvalReport, samples: &Samples) -> Result<String> {
    let mut out = String::new();
    open(report, &mut out);
    summary(report, &mut out);
    curves(report, &mut out);
    calibration(report, &mut out);
    if let Some(model) = report.models.first() {
        open_section(&mut out, "groups", "Categories, forces and objects");
        tables::groups(model, &mut out);
        out.push_str("</section>\n");
        open_section(&mut out, "mistakes", "Most confident mistakes");
        pictures::mistakes(model, samples, &mut out)?;
        out.push_str("</section>\n");
    }
    notes(report, &mut out);
    out.push_str("</main>\n</body>\n</html>\n");
    Ok(out)
}

fn open(report: &EvalReport, out: &mut String) {
    let title = format!("Stability prediction on {}", report.dataset);
    gripcast_report::begin(out, &report.software, &title, STYLE, None);
    section_links(out, &SECTIONS);
    theme_choice(out);
    out.push_str("</header>\n<main>\n");
}

fn summary(report: &EvalReport, out: &mut String) {
    out.push_str("<section id=\"summary\">\n<h1>Stability prediction before the lift</h1>\n");
    let n = report.models.first().map_or(0, |model| model.summary.n);
    put!(
        out,
        "<p class=\"verdict\">{n} samples of {} objects, part <b>{}</b> of <code>{}</code></p>\n",
        report.objects,
        Esc(&report.split),
        Esc(&report.dataset)
    );
    for warning in &report.warnings {
        put!(out, "<p class=\"warning\">{}</p>\n", Esc(warning));
    }
    tables::summary(report, out);
    out.push_str("</section>\n");
}

fn scored(model: &ModelEvaluation) -> Vec<Scored> {
    let scored = model.predictions.iter().map(|sample| Scored {
        p_stable: sample.p_stable,
        stable: sample.stable,
    });
    scored.collect()
}

/// What a model is called beside others.
fn called(model: &ModelEvaluation) -> String {
    let file = std::path::Path::new(&model.file);
    let folder = file.parent().and_then(|folder| folder.file_name());
    let folder = folder.map(|name| name.to_string_lossy().into_owned());
    match folder {
        Some(folder) if model.file.ends_with("model.onnx") => format!("{} {folder}", model.variant),
        _ => format!("{} {}", model.variant, model.name),
    }
}

fn curves(report: &EvalReport, out: &mut String) {
    open_section(out, "curves", "Curves");
    let of_roc: Vec<RocCurve> = report
        .models
        .iter()
        .map(|model| RocCurve::new(&called(model), &scored(model)).with_interval(model.auroc))
        .collect();
    let of_recall: Vec<PrecisionRecallCurve> = report
        .models
        .iter()
        .map(|model| PrecisionRecallCurve::new(&called(model), &scored(model)))
        .collect();
    let stable = report.models.first().map(|model| &model.summary);
    let share = stable.map(|s| s.stable as f64 / s.n.max(1) as f64);
    put!(
        out,
        "<div class=\"figures\">\n<figure>{}</figure>\n<figure>{}</figure>\n</div>\n",
        roc("Receiver operating characteristic", &of_roc),
        precision_recall("Precision and recall", &of_recall, share)
    );
    out.push_str("</section>\n");
}

fn calibration(report: &EvalReport, out: &mut String) {
    open_section(out, "calibration", "Calibration");
    out.push_str(
        "<p>How often grasps held that were given a probability. A calibrated model lies on the \
         diagonal.</p>\n<div class=\"figures\">\n",
    );
    for model in report.models.iter().take(4) {
        put!(
            out,
            "<figure>{}</figure>\n",
            reliability(&called(model), &model.reliability)
        );
    }
    out.push_str("</div>\n</section>\n");
}

fn notes(report: &EvalReport, out: &mut String) {
    open_section(out, "notes", "Notes");
    out.push_str(
        "<dl class=\"notes\">\n\
         <dt>Positive class</dt><dd>Stable. A grasp counts as predicted stable from the model's own \
         threshold on, which was chosen on validation data.</dd>\n\
         <dt>Intervals</dt><dd>95 %, of 2,000 resamples of objects with replacement: samples of one \
         object are not independent.</dd>\n\
         <dt>In contact</dt><dd>Samples in which at least 0.4 % of both tactile pictures changed by \
         more than 25 grey levels. Grasps without visible contact are easy: they are lost.</dd>\n\
         <dt>ECE</dt><dd>Mean distance of predicted probability and share of stable grasps over 15 \
         bins of equal width. Small bins are never even: by chance alone, were every probability \
         right, it would be below the figure named there in 95 % of such tests.</dd>\n</dl>\n",
    );
    out.push_str("<dl class=\"facts\">\n");
    put!(
        out,
        "<div><dt>Dataset, SHA-256</dt><dd><code>{}</code></dd></div>\n",
        Esc(&report.dataset_sha256)
    );
    for model in &report.models {
        put!(
            out,
            "<div><dt>{}, SHA-256</dt><dd><code>{}</code></dd></div>\n",
            Esc(&model.file),
            Esc(&model.sha256)
        );
    }
    put!(
        out,
        "<div><dt>Software</dt><dd>{}</dd></div>\n</dl>\n</section>\n",
        Esc(&report.software)
    );
}
