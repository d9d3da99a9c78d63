//! `gripcast eval`: evaluates models on a labelled dataset.
//!
//! Exit codes: 0 evaluated · 1 failed · 2 usage · 130 interrupted.

use std::path::PathBuf;
use std::slice;

use serde_json::json;

use super::flags::{ERROR_RATE, number};
use super::working::{Progress, interruptible};
use super::{Context, create_folder, print_report};
use crate::note;
use gripcast_base::error::{Error, Result};
use gripcast_base::files;
use gripcast_nn::predict::Model;
use gripcast_train::metrics::{BaseRateCalibration, Interval};
use gripcast_train::{
    ConformalLabel, EvalReport, LiftEvaluation, ModelEvaluation, Samples, dataset_sha256, evaluate,
    page,
};

/// Error rate of the sets without `--error-rate`.
const DEFAULT_ERROR_RATE: f64 = 0.1;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    /// ONNX file or built-in model; several are compared with the first
    #[arg(long, value_name = "MODEL", required = true, num_args = 1..)]
    model: Vec<String>,
    /// Folder of the dataset (`synth merge`, `dataset import`, `dataset export --to training`)
    #[arg(long, value_name = "DIR")]
    data: PathBuf,
    /// Split of the dataset
    #[arg(long, value_name = "NAME", default_value = "test")]
    split: String,
    /// Error rate of the prediction sets (stable, slip, can't tell) [default: 0.1, of the models that
    /// have conformal scores]
    #[arg(long, value_name = "RATE", value_parser = number(ERROR_RATE))]
    error_rate: Option<f64>,
    /// Output directory of eval.json and eval.html
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print the metrics of the first model as JSON
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub(super) fn run(context: &Context, args: Args) -> Result<()> {
    let is_json = args.json;
    let out = args.out.clone();
    let report = interruptible(context, "evaluating", move |progress| {
        evaluated(&args, progress)
    })??;
    context.warn(&report.warnings);
    print_report(is_json, &first(&report), |_| text(&report))?;
    if let (Some(out), false, false) = (&out, context.quiet, is_json) {
        note!("report: {}", out.join("eval.html").display());
    }
    Ok(())
}

fn evaluated(args: &Args, progress: &Progress) -> Result<EvalReport> {
    let models = args.model.iter();
    let models = models
        .map(|name| Ok((name.clone(), Model::by_name(name)?)))
        .collect::<Result<Vec<_>>>()?;
    let samples = Samples::open(&args.data, &args.split)?;
    let training = Samples::open(&args.data, "train").ok();
    let sha256 = dataset_sha256(slice::from_ref(&args.data))?;
    let on_progress = |done: usize, total: usize| progress.count(done, total);
    let mut report = evaluate(&models, &samples, training.as_ref(), &sha256, &on_progress)?;
    let error_rate = args.error_rate.unwrap_or(DEFAULT_ERROR_RATE);
    report.add_sets(&models, &samples, error_rate, args.error_rate.is_some())?;
    if let Some(out) = &args.out {
        create_folder(out)?;
        let text = serde_json::to_vec_pretty(&report)
            .map_err(|e| Error::internal("cannot write the report").because(e))?;
        files::save(&out.join("eval.json"), &text)?;
        files::save(&out.join("eval.html"), page(&report, &samples)?.as_bytes())?;
    }
    Ok(report)
}

/// Returns the metrics of the first model and those over all models.
fn first(report: &EvalReport) -> serde_json::Value {
    let model = report.models.first();
    let mut metrics = json!(model.map(|m| &m.summary));
    if let (Some(fields), Some(model)) = (metrics.as_object_mut(), model) {
        fields.insert("auroc_interval".into(), json!(model.auroc));
        fields.insert(
            "balanced_accuracy_interval".into(),
            json!(model.balanced_accuracy),
        );
        fields.insert("ece_by_chance".into(), json!(model.ece_by_chance));
        fields.insert("at_base_rate".into(), json!(model.at_base_rate));
        fields.insert("conformal".into(), json!(model.conformal));
        fields.insert("in_contact".into(), json!(model.in_contact));
        fields.insert("over_models".into(), json!(report.over_models));
        fields.insert("differences".into(), json!(report.differences));
        fields.insert("objects".into(), json!(report.objects));
        fields.insert("warnings".into(), json!(report.warnings));
    }
    metrics
}

fn text(report: &EvalReport) -> String {
    let mut lines = vec![format!(
        "{:<28} {:<6} {:>6} {:>8} {:>8} {:>20} {:>7} {:>9} {:>7}",
        "model", "inputs", "n", "accuracy", "balanced", "AUROC", "ECE", "by chance", "Brier"
    )];
    lines.extend(report.models.iter().map(row));
    lines.extend(report.models.iter().filter_map(at_base_rate));
    lines.extend(report.models.iter().flat_map(in_the_lift));
    lines.extend(report.models.iter().filter_map(sets));
    for result in report.over_models.iter().filter(|r| r.summary.seeds > 1) {
        let over = &result.summary;
        let spread = |s: &Option<gripcast_train::metrics::Spread>| {
            s.as_ref().map_or("–".to_owned(), |s| {
                format!("{:.3} ± {:.3}", s.mean, s.standard_deviation.unwrap_or(0.0))
            })
        };
        lines.push(format!(
            "{} over {} seeds: balanced accuracy {}, AUROC {} (over objects {}), ECE {}; all inputs − {}: AUROC {}",
            result.modality,
            over.seeds,
            spread(&over.balanced_accuracy),
            spread(&over.auroc),
            interval(result.auroc),
            spread(&over.ece),
            result.modality,
            interval(result.auroc_less_than_all),
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
        "{:<28} {:<6} {:>6} {:>8} {:>8} {:>20} {:>7} {:>9} {:>7}",
        model.file,
        model.modality,
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

/// Formats the verdict in the lift.
fn in_the_lift(model: &ModelEvaluation) -> Vec<String> {
    let from_all = model.lift.iter().map(|lift| {
        let with_object = lift.with_object > 0.0;
        (lift, if with_object { " with depth" } else { "" })
    });
    let from_gels = model.lift_from_gels.iter().map(|lift| (lift, ""));
    let each = from_all.chain(from_gels);
    each.flat_map(|(lift, inputs)| lift_lines(&model.file, lift, inputs))
        .collect()
}

fn lift_lines(model: &str, lift: &LiftEvaluation, inputs: &str) -> Vec<String> {
    let [lifts, slips] = lift.lifts;
    // Every image of the first 5 mm, then every fifth.
    let shown = lift.points.iter().enumerate();
    let mut lines: Vec<String> = shown
        .filter(|(image, _)| *image < 6 || image % 5 == 4)
        .map(|(_, point)| {
            format!(
                "{model} after {:.1} mm of lift{inputs}: AUROC {}, balanced accuracy {}",
                1e3 * point.lifted_m,
                interval(point.auroc),
                interval(point.balanced_accuracy),
            )
        })
        .collect();
    lines.push(format!(
        "{model} alarm{inputs}: {} of the held lifts, {} of the slips, {} 80 ms ahead; {} lose contact \
         in the first 80 ms ({lifts} lifts, {slips} slips)",
        interval(lift.alarmed_held),
        interval(lift.alarmed_slips_any),
        interval(lift.alarmed_slips),
        interval(lift.lost_at_once),
    ));
    lines
}

/// Formats the calibration after a prior correction, unless the classes are balanced.
fn at_base_rate(model: &ModelEvaluation) -> Option<String> {
    let corrected = model.at_base_rate.filter(BaseRateCalibration::is_uneven)?;
    Some(format!(
        "{} {}: {:.0} % are stable; corrected for this base rate: ECE {:.3}, Brier {:.3}",
        model.file,
        model.modality,
        100.0 * corrected.base_rate,
        corrected.ece,
        corrected.brier
    ))
}

/// Formats coverage and undecided fraction of the prediction sets.
fn sets(model: &ModelEvaluation) -> Option<String> {
    let conformal = model.conformal.as_ref()?;
    let of = |name: &str, label: &ConformalLabel| {
        format!(
            "{name} {}, can't tell {}",
            interval(label.coverage_interval),
            interval(label.cant_tell_interval)
        )
    };
    Some(format!(
        "{}: sets at an error rate of {} (scores of {}): coverage {}; {}; {}",
        model.file,
        conformal.limits.error_rate,
        conformal.scores_of,
        of("all", &conformal.all),
        of("stable", &conformal.stable),
        of("slip", &conformal.slip),
    ))
}

fn interval(interval: Option<Interval>) -> String {
    interval.map_or("–".to_owned(), |interval| interval.to_string())
}
