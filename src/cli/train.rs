//! `gripcast train`: a classifier from a dataset of labelled grasps.
//!
//! Exit codes: 0 trained · 1 it could not be trained · 2 usage, or a run of other settings · 75
//! stopped by SIGTERM, run it again · 130 interrupted. A run that was stopped in any way goes on
//! where it was and ends with the same bytes.
//!
//! On a terminal it shows a dashboard; elsewhere, and with `--headless`, lines on stderr. What came
//! out goes to stdout.

use std::io::{self, IsTerminal as _};
use std::path::{Path, PathBuf};

use rustix::process::getpgrp;
use rustix::termios::tcgetpgrp;
use serde_json::{Value, json};

use super::training_flags::TrainingFlags;
use super::working::{Progress, resumable, resumable_under_screen};
use super::{Context, print_report};
use crate::note;
use crate::tui::{TrainingNews, TrainingScreen, TrainingStatus, epoch_line};
use gripcast_base::error::{Error, Result};
use gripcast_base::files;
use gripcast_nn::predict::contract;
use gripcast_train::{Finished, RunFolder, TrainEvent, TrainSettings, Trained, finish, train};

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder of the dataset, as `synth merge` makes it
    #[arg(long, value_name = "DIR")]
    data: PathBuf,
    /// Folder of the run; one that was begun is gone on with
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// What the classifier sees
    #[arg(long, value_enum, default_value_t = Modality::Vt)]
    modality: Modality,
    #[command(flatten)]
    training: TrainingFlags,
    /// First seed
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Runs with seeds one after the other; the model is that of the best on the validation part
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=100))]
    seeds: u64,
    /// Name of the model [default: trained- and its senses, as trained-vt]
    #[arg(long)]
    name: Option<String>,
    /// No dashboard, even on a terminal
    #[arg(long)]
    headless: bool,
    /// Print what came out as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum Modality {
    /// The colour image
    V,
    /// Both tactile differences
    T,
    /// All of them
    Vt,
}

impl From<Modality> for contract::Modality {
    fn from(modality: Modality) -> Self {
        match modality {
            Modality::V => Self::V,
            Modality::T => Self::T,
            Modality::Vt => Self::Vt,
        }
    }
}

/// Runs the verb.
pub(super) fn run(context: &Context, args: Args) -> Result<()> {
    let is_json = args.json;
    let found = if !args.headless && !context.quiet && has_screen() {
        under_dashboard(args)?
    } else {
        resumable(context, "training", move |progress| {
            all_seeds(&args, &|news| tell(progress, &news))
        })??
    };
    print_report(is_json, &found, text)
}

/// Whether a dashboard can be shown, and keys can be read, without stopping a job in the background.
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
    let (screen, asked) = TrainingScreen::start(status)?;
    let tell = screen.teller();
    let found = resumable_under_screen(asked, move || all_seeds(&args, &tell));
    if let Err(error) = screen.end() {
        // The training went on without it. A terminal that has gone takes no line either.
        note!("gripcast: {error}");
    }
    found?
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
        let senses = file.settings.variant.name().to_lowercase();
        let name = args.name.clone().unwrap_or(format!("trained-{senses}"));
        let finished = finish(&folder, &file, &args.data, &name, &|_| {})?;
        runs.push(described(seed, &folder, &trained, &finished));
        let accuracy = trained.best.validation_accuracy;
        if best.as_ref().is_none_or(|(most, _)| accuracy > *most) {
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

fn tell(progress: &Progress, news: &TrainingNews) {
    match news {
        TrainingNews::Stage(label) => progress.stage(label),
        TrainingNews::Train(TrainEvent::Step {
            at: [done, all], ..
        }) => progress.at(*done, *all),
        TrainingNews::Train(TrainEvent::Epoch(figures)) => progress.line(epoch_line(figures)),
        TrainingNews::Train(TrainEvent::Begun(_) | TrainEvent::Look(_)) | TrainingNews::Seed(_) => {
        }
    }
}

fn described(seed: u64, folder: &RunFolder, trained: &Trained, finished: &Finished) -> Value {
    json!({
        "seed": seed,
        "model": folder.model().display().to_string(),
        "epochs": trained.epochs,
        "best_epoch": trained.best_epoch,
        "temperature": finished.temperature,
        "threshold": finished.threshold,
        "validation": finished.validation,
    })
}

fn text(found: &Value) -> String {
    let number = |value: &Value| value.as_f64().map_or("–".to_owned(), |x| format!("{x:.3}"));
    let mut lines: Vec<String> = Vec::new();
    for run in found["runs"].as_array().into_iter().flatten() {
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
    lines.push(format!(
        "model: {}",
        found["model"].as_str().unwrap_or_default()
    ));
    lines.join("\n")
}

impl Args {
    fn settings(&self, seed: u64) -> Result<TrainSettings> {
        self.training.settings(self.modality.into(), seed)
    }
}
