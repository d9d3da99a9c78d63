//! `gripcast experiment`: reproduces experiments of the paper.
//!
//! Exit codes: 0 done · 1 failed · 2 usage · 75 stopped by SIGTERM, rerun to resume · 130
//! interrupted. Finished runs are kept.

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
    Condition, ExperimentEvent, ExperimentReport, ExperimentSettings, Samples, TestSet, TrainEvent,
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
    /// Compare vision, touch and both trained on FEM data, and both on rigid-body data (Figure 6)
    Fig6(Fig6Args),
}

/// Arguments of `fig6`.
#[derive(Clone, Debug, clap::Args)]
struct Fig6Args {
    /// Dataset simulated with the FEM engine
    #[arg(long, value_name = "DIR")]
    fem: PathBuf,
    /// Dataset of the same plan simulated with the rigid engine [default: omit this condition]
    #[arg(long, value_name = "DIR")]
    rigid: Option<PathBuf>,
    /// Dataset of a shifted domain; its test split stands in for real data
    #[arg(long, value_name = "DIR")]
    shifted: Option<PathBuf>,
    /// Output directory of the runs and the figure; an existing experiment is resumed
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Number of seeds per condition
    #[arg(long, value_name = "N", default_value_t = 5,
        value_parser = clap::value_parser!(u64).range(1..=100))]
    seeds: u64,
    /// Number of parallel trainings (up to 1.5 GB each) [default: all cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256))]
    jobs: Option<u16>,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    training: TrainingFlags,
}

/// Runs the command.
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
    let with_depth = [("train", &args.fem), ("test", &args.fem)]
        .into_iter()
        .chain(args.shifted.iter().map(|shifted| ("test", shifted)))
        .map(|(split, data)| Ok(Samples::open(data, split)?.modality()?.has_depth()))
        .collect::<Result<Vec<bool>>>()?;
    let settings = ExperimentSettings {
        with_depth: with_depth.into_iter().all(|has_depth| has_depth),
        fem: args.fem.clone(),
        rigid: args.rigid.clone(),
        tests,
        seeds: args.seeds,
        training: args.training.settings(Modality::Vt, 0)?,
        cameras: args.training.cameras()?,
    };
    let out = args.out.clone();
    let jobs = args.jobs.map_or_else(cores, usize::from);
    let runs = settings.conditions().count() * args.seeds as usize;
    let fractions: Mutex<BTreeMap<(Condition, u64), f64>> = Mutex::default();
    let report = resumable(context, "experiment", move |progress| {
        experiment(&settings, &out, jobs, &|event| match event {
            ExperimentEvent::Run(condition, seed) => {
                progress.line(format!("{}, seed {seed}", condition.title()));
            }
            ExperimentEvent::Train(condition, seed, TrainEvent::Step { steps, .. }) => {
                let [done, total] = steps;
                let mut fractions = fractions.lock().unwrap_or_else(PoisonError::into_inner);
                fractions.insert((condition, seed), done as f64 / total.max(1) as f64);
                let sum: f64 = fractions.values().sum();
                progress.count((1000.0 * sum) as usize, 1000 * runs);
            }
            ExperimentEvent::Train(..) => {}
        })
    })??;
    print_report(args.json, &report, text)
}

fn text(report: &ExperimentReport) -> String {
    let interval =
        |interval: Option<Interval>| interval.map_or("–".to_owned(), |i| i.to_string());
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
    for result in &report.results {
        // The third image is at 2.4 mm.
        let points = result
            .lift
            .iter()
            .filter_map(|lift| lift.points.get(2)?.auroc);
        let points: Vec<f64> = points.map(|auroc| auroc.estimate).collect();
        if points.is_empty() {
            continue;
        }
        lines.push(format!(
            "{:<12} {} after 2.4 mm of lift: AUROC {:.3}, mean of {} seeds",
            result.test,
            result.condition.title(),
            points.iter().sum::<f64>() / points.len() as f64,
            points.len()
        ));
    }
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
