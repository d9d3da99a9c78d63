//! `gripcast train`: trains a stability classifier on a dataset.
//!
//! Exit codes: 0 trained · 1 failed, or another program trains in the folder · 2 usage, or a run
//! with other settings · 75 stopped by SIGTERM, rerun to resume · 130 interrupted. A resumed run
//! ends with the same bytes.
//!
//! On a terminal it shows a dashboard; elsewhere, and with `--headless`, lines on stderr. The
//! result goes to stdout.

use std::io::{self, IsTerminal as _};
use std::path::{Path, PathBuf};

use rustix::process::getpgrp;
use rustix::termios::tcgetpgrp;
use serde_json::{Value, json};

use super::flags::modality;
use super::training_flags::TrainingFlags;
use super::working::{Progress, resumable, resumable_under_screen};
use super::{Context, print_report};
use crate::note;
use crate::tui::{TrainingNews, TrainingScreen, TrainingStatus, epoch_line};
use gripcast_base::error::{Error, Result};
use gripcast_base::files;
use gripcast_nn::predict::contract::Modality;
use gripcast_train::{
    Finished, RunFolder, Samples, StartModel, TrainEvent, TrainSettings, Trained, fine_tune,
    finish, train,
};

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder of the dataset (`synth merge`, `dataset import`, `dataset export --to training`);
    /// repeat it to train on several datasets together
    #[arg(long, value_name = "DIR", required = true)]
    data: Vec<PathBuf>,
    /// Output directory; an existing run is resumed
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Fine-tune this model on the dataset: a built-in name, an ONNX file of `train`, or a run
    #[arg(long, value_name = "MODEL", conflicts_with_all = ["modality", "arch", "cameras_from"])]
    from: Option<String>,
    /// Epochs of fine-tuning that train the whole network, after those of the head
    #[arg(long, value_name = "N", default_value_t = 0, requires = "from")]
    unfreeze_epochs: u32,
    /// Inputs of the classifier [default: vtd, or vt without depth images]
    #[arg(long, value_name = "MODALITY", value_parser = modality())]
    modality: Option<Modality>,
    /// Epochs in which the encoder of tactile images first learns the displacement of the gels'
    /// faces; 0 where the dataset has none
    #[arg(long, value_name = "N", default_value_t = 15, conflicts_with = "from")]
    contact_epochs: u32,
    /// Model name [default: trained-MODALITY, START-tuned]
    #[arg(long)]
    name: Option<String>,
    /// Random seed
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    seed: u64,
    /// Number of runs with consecutive seeds; the best by validation AUROC is kept
    #[arg(long, value_name = "N", default_value_t = 1,
        value_parser = clap::value_parser!(u64).range(1..=100))]
    seeds: u64,
    /// Disable the dashboard
    #[arg(long)]
    headless: bool,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    training: TrainingFlags,
}

/// Models that a training takes parameters from.
struct Sources {
    /// Start model of fine-tuning.
    start: Option<StartModel>,
    /// Model with the encoders of camera images.
    cameras: Option<StartModel>,
}

/// Runs the command.
pub(super) fn run(context: &Context, args: Args) -> Result<()> {
    let is_json = args.json;
    let report = if !args.headless && !context.quiet && has_screen() {
        under_dashboard(args)?
    } else {
        let sources = args.sources()?;
        resumable(context, "training", move |progress| {
            all_seeds(&args, &sources, &|news| show(progress, &news))
        })??
    };
    print_report(is_json, &report, text)
}

/// Returns whether a dashboard can read keys; a background job would be stopped by it.
fn has_screen() -> bool {
    let is_terminal =
        io::stdin().is_terminal() && io::stdout().is_terminal() && io::stderr().is_terminal();
    let can_draw = std::env::var("TERM").is_ok_and(|term| !term.is_empty() && term != "dumb");
    is_terminal && can_draw && tcgetpgrp(io::stdin()).is_ok_and(|group| group == getpgrp())
}

fn under_dashboard(args: Args) -> Result<Value> {
    let sources = args.sources()?;
    let settings = args.settings(args.seed, &sources)?;
    let name = |path: &Path| {
        let name = path.file_name().unwrap_or(path.as_os_str());
        name.to_string_lossy().into_owned()
    };
    let datasets: Vec<String> = args.data.iter().map(|data| name(data)).collect();
    let status = TrainingStatus::new(&datasets.join(", "), &name(&args.out), settings, args.seeds);
    let (screen, cancel) = TrainingScreen::start(status)?;
    let on_progress = screen.sender();
    let report = resumable_under_screen(cancel, move || all_seeds(&args, &sources, &on_progress));
    if let Err(error) = screen.end() {
        // The training does not depend on its screen.
        note!("gripcast: {error}");
    }
    report?
}

fn all_seeds(
    args: &Args,
    sources: &Sources,
    on_progress: &(dyn Fn(TrainingNews) + Sync),
) -> Result<Value> {
    let start = sources.start.as_ref();
    let mut runs = Vec::new();
    let mut best: Option<(f64, Finished)> = None;
    for seed in args.seed..args.seed.saturating_add(args.seeds) {
        let folder = if args.seeds == 1 {
            args.out.clone()
        } else {
            args.out.join(format!("seed-{seed}"))
        };
        let settings = args.settings(seed, sources)?;
        on_progress(TrainingNews::Seed(seed));
        let on_event = |event| on_progress(TrainingNews::Train(event));
        let trained = match start {
            Some(start) => {
                let unfreeze_epochs = args.unfreeze_epochs;
                fine_tune(
                    &args.data,
                    &folder,
                    &settings,
                    start,
                    unfreeze_epochs,
                    &on_event,
                )?
            }
            None => {
                let cameras = sources.cameras.as_ref();
                train(&args.data, &folder, &settings, cameras, &on_event)?
            }
        };
        let folder = RunFolder::at(folder);
        let file = folder.read()?.ok_or_else(|| {
            Error::internal("the run has no description").at(folder.run().display())
        })?;
        on_progress(TrainingNews::Stage("calibrating"));
        let name = args.name.clone().unwrap_or_else(|| match start {
            Some(start) => format!("{}-tuned", start.contract().name),
            None => format!("trained-{}", file.settings.modality.name().to_lowercase()),
        });
        let finished = finish(&folder, &file, &args.data, &name, &|_| {})?;
        runs.push(run_report(seed, &folder, &trained, &finished));
        let auroc = finished.validation.auroc.unwrap_or(f64::NEG_INFINITY);
        if best.as_ref().is_none_or(|(max, _)| auroc > *max) {
            best = Some((auroc, finished));
        }
        on_progress(TrainingNews::Stage("training"));
    }
    let model = args.out.join("model.onnx");
    if let (true, Some((_, finished))) = (args.seeds > 1, &best) {
        files::save(&model, &finished.onnx)?;
    }
    Ok(json!({ "model": model.display().to_string(), "runs": runs }))
}

fn show(progress: &Progress, news: &TrainingNews) {
    match news {
        TrainingNews::Stage(label) => progress.stage(label),
        TrainingNews::Train(TrainEvent::Step {
            steps: [done, total],
            ..
        }) => progress.count(*done as usize, *total as usize),
        TrainingNews::Train(TrainEvent::Epoch(figures)) => progress.line(epoch_line(figures)),
        TrainingNews::Train(TrainEvent::Started(start)) => {
            for warning in &start.warnings {
                progress.line(format!("gripcast: {warning}"));
            }
        }
        TrainingNews::Train(TrainEvent::Validate(_)) | TrainingNews::Seed(_) => {}
    }
}

fn run_report(seed: u64, folder: &RunFolder, trained: &Trained, finished: &Finished) -> Value {
    json!({
        "seed": seed,
        "model": folder.model().display().to_string(),
        "epochs": trained.epochs,
        "best_epoch": trained.best_epoch,
        "temperature": finished.temperature,
        "threshold": finished.threshold,
        "validation": finished.validation,
        "comparison": finished.comparison,
        "warnings": trained.warnings,
    })
}

fn text(report: &Value) -> String {
    let number = |value: &Value| value.as_f64().map_or("–".to_owned(), |x| format!("{x:.3}"));
    let mut lines: Vec<String> = Vec::new();
    for run in report["runs"].as_array().into_iter().flatten() {
        let validation = &run["validation"];
        lines.push(format!(
            "seed {}: best epoch {} of {}, validation AUROC {}, accuracy {}, ECE {}",
            run["seed"],
            run["best_epoch"],
            run["epochs"],
            number(&validation["auroc"]),
            number(&validation["balanced_accuracy"]),
            number(&validation["ece"]),
        ));
        lines.extend(comparison(run));
    }
    let model = report["model"].as_str().unwrap_or_default();
    lines.push(format!("model: {model}"));
    lines.join("\n")
}

/// Returns the lines that compare a fine-tuned model with its start model.
fn comparison(run: &Value) -> Vec<String> {
    let comparison = &run["comparison"];
    let Some(start) = comparison["start"].as_str() else {
        return Vec::new();
    };
    let number = |value: &Value| value.as_f64().map_or("–".to_owned(), |x| format!("{x:.3}"));
    let difference = |name: &str| {
        let interval = &comparison[name];
        let [estimate, low, high] = ["estimate", "low", "high"].map(|key| number(&interval[key]));
        format!("{estimate} [{low}, {high}]")
    };
    let before = &comparison["start_validation"];
    let mut lines = vec![
        format!(
            "{start} on the same {} lifts of {} objects: validation AUROC {}, accuracy {}, ECE {}",
            comparison["lifts"],
            comparison["objects"],
            number(&before["auroc"]),
            number(&before["balanced_accuracy"]),
            number(&before["ece"]),
        ),
        format!(
            "difference [95 % interval over objects], both calibrated on this split: AUROC {}, \
             accuracy {}",
            difference("auroc"),
            difference("balanced_accuracy"),
        ),
        comparison["advice"].as_str().unwrap_or_default().to_owned(),
    ];
    if let Some(score) = comparison["ood_score_of_start"].as_f64() {
        lines.push(format!(
            "OOD score of the mean of the start model's tactile images: {score:.2} (above 1: UNSURE)"
        ));
    }
    lines
}

impl Args {
    /// Loads the models that parameters are taken from.
    fn sources(&self) -> Result<Sources> {
        Ok(Sources {
            start: self.from.as_deref().map(StartModel::by_name).transpose()?,
            cameras: self.training.cameras()?,
        })
    }

    fn settings(&self, seed: u64, sources: &Sources) -> Result<TrainSettings> {
        let settings = |modality| {
            Ok::<_, Error>(TrainSettings {
                contact_epochs: self.contact_epochs,
                ..self.training.settings(modality, seed)?
            })
        };
        if let Some(start) = &sources.start {
            let modality = start.contract().modality;
            return Ok(settings(modality)?.fine_tuning(start, self.unfreeze_epochs));
        }
        settings(match self.modality {
            Some(modality) => modality,
            None => Samples::open_all(&self.data, "train")?.modality()?,
        })
    }
}
