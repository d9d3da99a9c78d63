//! The report of an evaluation: one HTML page without scripts or external resources.

mod tables;

use super::evaluate::{EvalReport, ModelEvaluation, sample_images};
use super::metrics::plot::{ModelCurve, precision_recall, reliability, roc};
use super::samples::Samples;
use gripcast_base::error::Result;
use gripcast_report::fixed;
use gripcast_report::image::{data_uri, image};
use gripcast_report::page::{Page, definitions, grasp_card, placeholder, section, warning};
use maud::{Markup, Render, html};

const STYLE: &str = include_str!("style.css");

/// Sections with their names in the navigation bar.
const SECTIONS: [(&str, &str); 6] = [
    ("summary", "Summary"),
    ("curves", "Curves"),
    ("calibration", "Calibration"),
    ("groups", "Categories"),
    ("mistakes", "Mistakes"),
    ("notes", "Notes"),
];

/// Renders the page of an evaluation with the images of mistakes from `samples`.
///
/// # Errors
/// Errors of reading the samples.
pub fn page(report: &EvalReport, samples: &Samples) -> Result<String> {
    let first = report.models.first();
    let mistakes = first.map(|model| mistakes(model, samples)).transpose()?;
    let main = html! {
        (summary(report))
        (curves(report))
        (calibration(report))
        @if let Some(model) = first {
            (section("groups", "Categories, forces and objects", tables::groups(model)))
        }
        @if let Some(mistakes) = mistakes {
            (section("mistakes", "Most confident mistakes", mistakes))
        }
        (notes(report))
    };
    let page = Page {
        software: &report.software,
        title: &format!("Stability prediction on {}", report.dataset),
        style: STYLE,
        script: None,
        sections: &SECTIONS,
        flag: None,
        main,
    };
    Ok(page.to_html())
}

fn summary(report: &EvalReport) -> Markup {
    let n = report.models.first().map_or(0, |model| model.summary.n);
    html! {
        section id="summary" {
            h1 { "Stability prediction before the lift" }
            p.verdict {
                (n) " samples of " (report.objects) " objects, split " b { (report.split) } " of "
                code { (report.dataset) }
            }
            @for text in &report.warnings { (warning(text)) }
            (tables::summary(report))
        }
    }
}

/// Returns the name of a model among others.
fn display_name(model: &ModelEvaluation) -> String {
    let file = std::path::Path::new(&model.file);
    let folder = file.parent().and_then(|folder| folder.file_name());
    let folder = folder.map(|name| name.to_string_lossy().into_owned());
    match folder {
        Some(folder) if model.file.ends_with("model.onnx") => {
            format!("{} {folder}", model.modality)
        }
        _ => format!("{} {}", model.modality, model.name),
    }
}

fn curves(report: &EvalReport) -> Markup {
    let models = report.models.iter();
    let curves: Vec<ModelCurve> = models
        .map(|model| ModelCurve::new(&display_name(model), &model.scored(), model.auroc))
        .collect();
    let stable = report.models.first().map(|model| &model.summary);
    let stable = stable.map(|s| s.stable as f64 / s.n.max(1) as f64);
    let body = html! {
        div.figures {
            figure { (roc(&curves).inline()) }
            figure { (precision_recall(&curves, stable).inline()) }
        }
    };
    section("curves", "Curves", body)
}

fn calibration(report: &EvalReport) -> Markup {
    let body = html! {
        p {
            "Fraction of stable grasps by predicted probability. A calibrated model lies on the \
             diagonal."
        }
        div.figures {
            @for model in report.models.iter().take(4) {
                figure {
                    h3 { (display_name(model)) }
                    (reliability(&display_name(model), &model.reliability).inline())
                }
            }
        }
    };
    section("calibration", "Calibration", body)
}

/// Renders confident mistakes with the model's input images.
fn mistakes(model: &ModelEvaluation, samples: &Samples) -> Result<Markup> {
    let mut halves = Vec::new();
    for (label, title) in [
        (true, "Stable, predicted slip"),
        (false, "Slip, predicted stable"),
    ] {
        let mut cards = Vec::new();
        for mistake in model.mistakes.iter().filter(|m| m.stable == label) {
            let [left, right, rgb] = sample_images(samples, mistake.sample)?;
            let mut images = Vec::new();
            for (pixels, name) in [(&rgb, "colour"), (&left, "left"), (&right, "right")] {
                let id = format!("m{}-{name}", mistake.sample);
                let alt = format!("{} {name}", mistake.id);
                images.push(image(&data_uri(pixels)?, &id, &alt));
            }
            let text = html! {
                b { (mistake.object) }
                p { "probability of stable " (fixed(mistake.p_stable, 3)) }
                p { (mistake.id) }
            };
            cards.push(grasp_card(
                label,
                html! { @for one in images { (one) } },
                text,
            ));
        }
        halves.push((title, cards));
    }
    Ok(html! {
        p {
            "At most one per object. The small images are the tactile differences (grasp minus \
             initial) around grey, left above right."
        }
        @for (title, cards) in halves {
            h3 { (title) }
            @if cards.is_empty() {
                (placeholder("None."))
            } @else {
                ul.grasps { @for card in cards { (card) } }
            }
        }
    })
}

fn notes(report: &EvalReport) -> Markup {
    let notes: [(&str, &dyn Render); 5] = [
        (
            "Positive class",
            &"Stable. A grasp is predicted stable if its probability reaches the model's threshold, \
              which was chosen on validation data.",
        ),
        (
            "Intervals",
            &"95 %, cluster bootstrap over objects with 2,000 resamples: samples of one object are \
              not independent.",
        ),
        (
            "In contact",
            &"Samples in which at least 0.4 % of both tactile images changed by more than 25 \
              grey levels. Grasps without visible contact are easy: they slip.",
        ),
        (
            "ECE",
            &"Expected calibration error over 15 bins of equal width. It is above 0 for a finite \
              number of grasps: for a perfectly calibrated model it is below the value given as \
              “by chance” in 95 % of such tests.",
        ),
        (
            "Prediction sets",
            &"Conformal sets for each outcome on its own: the scores of grasps that the model was \
              not trained on say which outcomes a prediction leaves open. Coverage is the fraction \
              of grasps whose outcome is in the set; it is 1 − error rate only for grasps like \
              those of the scores.",
        ),
    ];
    let body = html! {
        (definitions("notes", &notes))
        dl.facts {
            (hash("Dataset", &report.dataset_sha256))
            @for model in &report.models { (hash(&model.file, &model.sha256)) }
            div {
                dt { "Software" }
                dd { (report.software) }
            }
        }
    };
    section("notes", "Notes", body)
}

fn hash(of: &str, sha256: &str) -> Markup {
    html! {
        div {
            dt { (of) ", SHA-256" }
            dd { code { (sha256) } }
        }
    }
}
