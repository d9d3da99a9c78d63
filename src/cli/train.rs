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
use gripcast_train::{Finished, RunFolder, TrainEvent, TrainSettings, Trained, finish, train};

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder of the dataset (`synth merge`, `dataset import`, `dataset export --to training`)
    #[arg(long, value_name = "DIR")]
    data: PathBuf,
    /// Output directory; an existing run is resumed
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Input modality of the classifier
    #[arg(long, value_name = "MODALITY", default_value = "vt", value_parser = modality())]
    modality: Modality,
    /// Model name [default: trained-MODALITY]
    #[arg(long)]
    name: Option<String>,
    /// Random seed
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    seed: u64,
    /// Number of runs with consecutive seeds; the best on the validation split is kept
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

/// Runs the command.
pub(super) fn run(context: &Context, args: Args) -> Result<()> {
    let is_json = args.json;
    let report = if !args.headless && !context.quiet && has_screen() {
        under_dashboard(args)?
    } else {
        resumable(context, "training", move |progress| {
            all_seeds(&args, &|news| show(progress, &news))
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
    let settings = args.settings(args.seed)?;
    let name = |path: &Path| {
        let name = path.file_name().unwrap_or(path.as_os_str());
        name.to_string_lossy().into_owned()
    };
    let status = TrainingStatus::new(&name(&args.data), &name(&args.out), settings, args.seeds);
    let (screen, cancel) = TrainingScreen::start(status)?;
    let on_progress = screen.sender();
    let report = resumable_under_screen(cancel, move || all_seeds(&args, &on_progress));
    if let Err(error) = screen.end() {
        // The training does not depend on its screen.
        note!("gripcast: {error}");
    }
    report?
}

fn all_seeds(args: &Args, on_progress: &(dyn Fn(TrainingNews) + Sync)) -> Result<Value> {
    let mut runs = Vec::new();
    let mut best: Option<(f64, Finished)> = None;
    for seed in args.seed..args.seed.saturating_add(args.seeds) {
        let folder = if args.seeds == 1 {
            args.out.clone()
        } else {
            args.out.join(format!("seed-{seed}"))
        };
        let settings = args.settings(seed)?;
        on_progress(TrainingNews::Seed(seed));
        let trained = train(&args.data, &folder, &settings, &|event| {
            on_progress(TrainingNews::Train(event));
        })?;
        let folder = RunFolder::at(folder);
        let file = folder.read()?.ok_or_else(|| {
            Error::internal("the run has no description").at(folder.run().display())
        })?;
        on_progress(TrainingNews::Stage("calibrating"));
        let modality = file.settings.modality.name().to_lowercase();
        let name = args.name.clone().unwrap_or(format!("trained-{modality}"));
        let finished = finish(&folder, &file, &args.data, &name, &|_| {})?;
        runs.push(run_report(seed, &folder, &trained, &finished));
        let accuracy = trained.best.validation_accuracy;
        if best.as_ref().is_none_or(|(max, _)| accuracy > *max) {
            best = Some((accuracy, finished));
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
        "warnings": trained.warnings,
    })
}

fn text(report: &Value) -> String {
    let number = |value: &Value| value.as_f64().map_or("–".to_owned(), |x| format!("{x:.3}"));
    let mut lines: Vec<String> = Vec::new();
    for run in report["runs"].as_array().into_iter().flatten() {
        let validation = &run["validation"];
        lines.push(format!(
            "seed {}: best epoch {} of {}, validation accuracy {}, AUROC {}, ECE {}",
            run["seed"],
            run["best_epoch"],
            run["epochs"],
            number(&validation["balanced_accuracy"]),
            number(&validation["auroc"]),
            number(&validation["ece"]),
        ));
    }
    let model = report["model"].as_str().unwrap_or_default();
    lines.push(format!("model: {model}"));
    lines.join("\n")
}

impl Args {
    fn settings(&self, seed: u64) -> Result<TrainSettings> {
        self.training.settings(self.modality, seed)
    }
}
