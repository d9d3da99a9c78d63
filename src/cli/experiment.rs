//! `gripcast experiment`: comparisons of the paper, repeated.
//!
//! Exit codes: 0 done · 1 it could not be done · 2 usage · 75 stopped by SIGTERM, run it again · 130
//! interrupted. What is done is kept and not done again.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use super::training_flags::TrainingFlags;
use super::working::resumable;
use super::{Context, print_report};
use gripcast_base::error::Result;
use gripcast_base::workers::cores;
use gripcast_nn::predict::contract::Modality;
use gripcast_train::metrics::Interval;
use gripcast_train::{
    Condition, ExperimentEvent, ExperimentReport, ExperimentSettings, TestSet, TrainEvent,
    experiment,
};

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    experiment: Experiment,
}

#[derive(Clone, Debug, clap::Subcommand)]
enum Experiment {
    /// Vision, touch and both on data of the finite elements, both on data of rigid bodies (the
    /// paper's Figure 6)
    Fig6(Fig6Args),
}

/// Arguments of `fig6`.
#[derive(Clone, Debug, clap::Args)]
struct Fig6Args {
    /// Dataset simulated with finite elements
    #[arg(long, value_name = "DIR")]
    fem: PathBuf,
    /// Dataset of the same plan with the rigid engine [default: that bar is left out]
    #[arg(long, value_name = "DIR")]
    rigid: Option<PathBuf>,
    /// Dataset of other objects under other conditions, whose part `test` stands for reality
    #[arg(long, value_name = "DIR")]
    shifted: Option<PathBuf>,
    /// Folder of the runs and the figure
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Seeds of each bar
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u64).range(1..=100))]
    seeds: u64,
    #[command(flatten)]
    training: TrainingFlags,
    /// Models that are trained at a time, of which each takes up to 1.5 GB [default: all cores]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=256))]
    jobs: Option<u16>,
    /// Print what came out as JSON
    #[arg(long)]
    json: bool,
}

/// Runs the verb.
pub(super) fn run(context: &Context, args: Args) -> Result<()> {
    let Experiment::Fig6(args) = args.experiment;
    let test = |title: &str, name: &'static str, data: &PathBuf| TestSet {
        title: title.to_owned(),
        name,
        data: data.clone(),
        split: "test".to_owned(),
    };
    let mut tests = vec![test("Held-out objects", "held-out", &args.fem)];
    if let Some(shifted) = &args.shifted {
        tests.push(test("Shifted domain", "shifted", shifted));
    }
    let settings = ExperimentSettings {
        fem: args.fem.clone(),
        rigid: args.rigid.clone(),
        tests,
        seeds: args.seeds,
        training: args.training.settings(Modality::Vt, 0)?,
    };
    let out = args.out.clone();
    let jobs = args.jobs.map_or_else(cores, usize::from);
    let conditions = Condition::ALL.len() - usize::from(args.rigid.is_none());
    let runs = conditions as u64 * args.seeds;
    let fractions: Mutex<BTreeMap<(Condition, u64), f64>> = Mutex::default();
    let report = resumable(context, "experiment", move |progress| {
        experiment(&settings, &out, jobs, &|event| match event {
            ExperimentEvent::Run(condition, seed) => {
                progress.line(format!("{}, seed {seed}", condition.title()));
            }
            ExperimentEvent::Train(
                condition,
                seed,
                TrainEvent::Step {
                    at: [done, all], ..
                },
            ) => {
                let mut fractions = fractions.lock().unwrap_or_else(PoisonError::into_inner);
                fractions.insert((condition, seed), done as f64 / all.max(1) as f64);
                let sum: f64 = fractions.values().sum();
                progress.at((1000.0 * sum) as u64, 1000 * runs);
            }
            ExperimentEvent::Train(..) => {}
        })
    })??;
    print_report(args.json, &report, text)
}

fn text(report: &ExperimentReport) -> String {
    let interval = |found: Option<Interval>| found.map_or("–".to_owned(), |i| i.to_string());
    let mut lines = vec![format!(
        "{:<12} {:<12} {:>6} {:>22} {:>22}",
        "test", "trained on", "n", "balanced accuracy", "AUROC"
    )];
    for result in &report.results {
        lines.push(format!(
            "{:<12} {:<12} {:>6} {:>22} {:>22}",
            result.test,
            result.condition.title(),
            result.n,
            interval(result.balanced_accuracy),
            interval(result.auroc),
        ));
    }
    lines.push(String::new());
    for difference in &report.differences {
        lines.push(format!(
            "{:<12} {} − {}: balanced accuracy {}, AUROC {}",
            difference.test,
            difference.first.title(),
            difference.second.title(),
            interval(difference.balanced_accuracy),
            interval(difference.auroc),
        ));
    }
    lines.join("\n")
}
