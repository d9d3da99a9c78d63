//! `gripcast eval`: how well model files predict the outcomes of a dataset.
//!
//! Exit codes: 0 measured · 1 it could not be measured · 2 usage · 130 interrupted.

use std::path::PathBuf;

use serde_json::json;

use super::working::interruptible;
use super::{Context, create_folder, print, print_json};
use crate::note;
use gripcast_base::error::{Error, Result};
use gripcast_base::files;
use gripcast_nn::predict::Model;
use gripcast_train::metrics::{BaseRateCalibration, Interval};
use gripcast_train::{EvalReport, ModelEvaluation, Samples, dataset_sha256, evaluate, page};

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    /// Model file, or the name of a built-in model; several are compared with the first
    #[arg(long, value_name = "MODEL", required = true, num_args = 1..)]
    model: Vec<String>,
    /// Folder of the dataset, as `synth merge` makes it
    #[arg(long, value_name = "DIR")]
    data: PathBuf,
    /// Part of the dataset
    #[arg(long, default_value = "test")]
    split: String,
    /// Folder for eval.json and eval.html
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print the figures of the first model as JSON
    #[arg(long)]
    json: bool,
}

/// Runs the verb.
pub(super) fn run(context: &Context, args: Args) -> Result<()> {
    let is_json = args.json;
    let out = args.out.clone();
    let report = interruptible(
        context,
        "evaluating",
        move |progress| -> Result<EvalReport> {
            let models = args
                .model
                .iter()
                .map(|name| Ok((name.clone(), Model::by_name(name)?)))
                .collect::<Result<Vec<_>>>()?;
            let samples = Samples::open(&args.data, &args.split)?;
            let training = Samples::open(&args.data, "train").ok();
            let sha256 = dataset_sha256(&args.data)?;
            let report = evaluate(
                &models,
                &samples,
                training.as_ref(),
                &sha256,
                &|done, all| {
                    progress.at(done as u64, all as u64);
                },
            )?;
            if let Some(out) = &args.out {
                create_folder(out)?;
                let text = serde_json::to_vec_pretty(&report)
                    .map_err(|e| Error::internal("cannot write the report").because(e))?;
                files::save(&out.join("eval.json"), &text)?;
                files::save(&out.join("eval.html"), page(&report, &samples)?.as_bytes())?;
            }
            Ok(report)
        },
    )??;
    if !context.quiet {
        for warning in &report.warnings {
            note!("gripcast: {warning}");
        }
    }
    if is_json {
        print_json(&first(&report))?;
    } else {
        print(&text(&report))?;
    }
    if let (Some(out), false, false) = (&out, context.quiet, is_json) {
        note!("report: {}", out.join("eval.html").display());
    }
    Ok(())
}

/// The figures of the first model, and those over all.
fn first(report: &EvalReport) -> serde_json::Value {
    let model = report.models.first();
    let mut found = json!(model.map(|m| &m.summary));
    if let (Some(fields), Some(model)) = (found.as_object_mut(), model) {
        fields.insert("auroc_interval".into(), json!(model.auroc));
        fields.insert(
            "balanced_accuracy_interval".into(),
            json!(model.balanced_accuracy),
        );
        fields.insert("ece_by_chance".into(), json!(model.ece_by_chance));
        fields.insert("at_base_rate".into(), json!(model.at_base_rate));
        fields.insert("in_contact".into(), json!(model.in_contact));
        fields.insert("over_models".into(), json!(report.over_models));
        fields.insert("differences".into(), json!(report.differences));
        fields.insert("objects".into(), json!(report.objects));
        fields.insert("warnings".into(), json!(report.warnings));
    }
    found
}

fn text(report: &EvalReport) -> String {
    let mut lines = vec![format!(
        "{:<28} {:>6} {:>8} {:>8} {:>20} {:>7} {:>9} {:>7}",
        "model", "n", "accuracy", "balanced", "AUROC", "ECE", "by chance", "Brier"
    )];
    lines.extend(report.models.iter().map(row));
    lines.extend(report.models.iter().filter_map(at_base_rate));
    if let Some(over) = &report.over_models {
        let spread = |s: &Option<gripcast_train::metrics::Spread>| {
            s.as_ref().map_or("–".to_owned(), |s| {
                format!("{:.3} ± {:.3}", s.mean, s.standard_deviation.unwrap_or(0.0))
            })
        };
        lines.push(format!(
            "over {} models: balanced accuracy {}, AUROC {}, ECE {}",
            over.seeds,
            spread(&over.balanced_accuracy),
            spread(&over.auroc),
            spread(&over.ece),
        ));
    }
    for difference in &report.differences {
        lines.push(format!(
            "{} − {}: AUROC {}",
            difference.first,
            difference.second,
            interval(difference.auroc),
        ));
    }
    lines.join("\n")
}

fn row(model: &ModelEvaluation) -> String {
    let figure = |x: Option<f64>| x.map_or("–".to_owned(), |x| format!("{x:.3}"));
    let s = &model.summary;
    format!(
        "{:<28} {:>6} {:>8} {:>8} {:>20} {:>7} {:>9} {:>7}",
        model.file,
        s.n,
        figure(s.accuracy),
        figure(s.balanced_accuracy),
        interval(model.auroc),
        figure(s.ece),
        model
            .ece_by_chance
            .map_or("–".to_owned(), |chance| format!("< {:.3}", chance.high)),
        figure(s.brier),
    )
}

/// What would come of a model that knew how often these grasps hold, where it is not every other one.
fn at_base_rate(model: &ModelEvaluation) -> Option<String> {
    let found = model.at_base_rate.filter(BaseRateCalibration::is_uneven)?;
    Some(format!(
        "{}: {:.0} % of these hold; with that as base rate ECE {:.3}, Brier {:.3}",
        model.file,
        100.0 * found.base_rate,
        found.ece,
        found.brier
    ))
}

fn interval(found: Option<Interval>) -> String {
    found.map_or("–".to_owned(), |found| found.to_string())
}
