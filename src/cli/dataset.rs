//! `gripcast dataset`: look at, verify, repair, index and split a dataset, export it for others, or
//! import one of theirs.
//!
//! ```text
//! gripcast dataset info DIR      what is in it: counts, balance, size, predictions against labels
//! gripcast dataset verify DIR    read every file and report all that is wrong
//! gripcast dataset recover DIR   rescue what is there; the rest moves to trash/, nothing is deleted
//! gripcast dataset reindex DIR   write metadata.jsonl again from the records
//! gripcast dataset split DIR     divide it into train, val and test without sharing an object
//! gripcast dataset export DIR    write it as Parquet, WebDataset, LeRobot or Zarr
//! gripcast dataset import FILE…  make Parquet shards of somebody else's files
//! ```
//!
//! Every one takes `--json`. Exit codes: 0 all is well · 1 could not be done · 2 the command line
//! is wrong · 3 finished, but some grasps could not be rescued or read · 4 `verify` found problems.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::PathBuf;

use clap::{Subcommand, ValueEnum};
use serde_json::json;

use super::dataset_text::{counted, name_of, outcomes_text, progress_bar, size_text, to_value};
use super::{Context, dataset_export, dataset_import, print, print_json};
use crate::note;
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_dataset::{
    Dataset, GroupKey, Outcome, RecoverReport, SplitFile, SplitPlan, Summary, VerifyReport,
    recover, reindex, split, summary, verify,
};

/// Arguments of `dataset`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Show what is in a dataset
    Info(Place),
    /// Find everything that is torn, missing, altered, duplicated or leaking
    Verify(Place),
    /// Rescue what is there; move the rest to trash/
    Recover(RecoverArgs),
    /// Write metadata.jsonl again from the records
    Reindex(Place),
    /// Divide the grasps into parts that share no object
    Split(SplitArgs),
    /// Write the dataset in a format of others
    Export(dataset_export::Args),
    /// Make Parquet shards, for train and eval, of somebody else's files
    Import(dataset_import::Args),
}

#[derive(Debug, clap::Args)]
struct Place {
    /// Directory of the dataset
    dataset: PathBuf,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

#[derive(Debug, clap::Args)]
struct RecoverArgs {
    #[command(flatten)]
    place: Place,
    /// Only say what would be done
    #[arg(long)]
    dry_run: bool,
}

#[derive(Debug, clap::Args)]
struct SplitArgs {
    #[command(flatten)]
    place: Place,
    /// Fraction of the grasps for training
    #[arg(long, default_value_t = 0.7)]
    train: f64,
    /// Fraction of the grasps for validation
    #[arg(long, default_value_t = 0.15)]
    val: f64,
    /// Fraction of the grasps for testing
    #[arg(long, default_value_t = 0.15)]
    test: f64,
    /// Seed; the same seed and grasps give the same split
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// What may not be in two parts
    #[arg(long, value_enum, default_value_t = By::Object)]
    by: By,
    /// Name of the file in splits/; `<by>-<seed>` unless given
    #[arg(long)]
    name: Option<String>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum By {
    Object,
    Scene,
}

/// Runs the verb.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    match args.action {
        Action::Info(place) => run_info(&place),
        Action::Verify(place) => run_verify(context, &place),
        Action::Recover(args) => run_recover(context, &args),
        Action::Reindex(place) => run_reindex(context, &place),
        Action::Split(args) => run_split(&args),
        Action::Export(args) => dataset_export::run(context, args),
        Action::Import(args) => dataset_import::run(context, &args),
    }
}

fn run_info(place: &Place) -> Result<()> {
    let summary = summary(&Dataset::open(&place.dataset)?)?;
    if place.json {
        print_json(&to_value(&summary)?)
    } else {
        print(&info_text(&summary))
    }
}

fn run_verify(context: &Context, place: &Place) -> Result<()> {
    let bar = progress_bar(context, "verifying");
    let report = verify(&place.dataset, &|done, all| {
        bar.set_length(all as u64);
        bar.set_position(done as u64);
    });
    bar.finish_and_clear();
    let report = report?;
    if place.json {
        print_json(&to_value(&report)?)?;
    } else {
        print(&verify_text(&report))?;
    }
    if report.problems.is_empty() {
        return Ok(());
    }
    Err(Error::new(
        ErrorKind::Check,
        format!("{} found", counted(report.problems.len(), "problem")),
    )
    .at(place.dataset.display())
    .remedy("`gripcast dataset recover` fixes what can be fixed"))
}

fn run_recover(context: &Context, args: &RecoverArgs) -> Result<()> {
    let place = &args.place;
    let report = recover(&place.dataset, args.dry_run)?;
    if place.json {
        print_json(&to_value(&report)?)?;
    } else {
        print(&recover_text(&report))?;
    }
    let lost = report.actions.iter().filter(|action| action.lost).count();
    if lost > 0 {
        return Err(Error::new(
            ErrorKind::Partial,
            format!("{} could not be rescued", counted(lost, "item")),
        )
        .at(place.dataset.display())
        .remedy("restore the files from a copy; what moved is in trash/, with the reason"));
    }
    if report.actions.is_empty() && !place.json && !context.quiet {
        note!("nothing to recover");
    }
    Ok(())
}

fn run_reindex(context: &Context, place: &Place) -> Result<()> {
    let report = reindex(&place.dataset)?;
    if place.json {
        print_json(&to_value(&report)?)?;
    } else if !context.quiet {
        note!(
            "metadata.jsonl {}: {}",
            if report.changed {
                "written"
            } else {
                "was up to date"
            },
            counted(report.grasps, "grasp")
        );
    }
    if report.skipped.is_empty() {
        return Ok(());
    }
    Err(Error::new(
        ErrorKind::Partial,
        format!(
            "{} with an unreadable record left out: {}",
            counted(report.skipped.len(), "grasp"),
            report.skipped.join(", ")
        ),
    )
    .at(place.dataset.display())
    .remedy("run `gripcast dataset recover`"))
}

fn run_split(args: &SplitArgs) -> Result<()> {
    let by = match args.by {
        By::Object => GroupKey::Object,
        By::Scene => GroupKey::Scene,
    };
    let plan = SplitPlan {
        name: args
            .name
            .clone()
            .unwrap_or_else(|| format!("{by}-{}", args.seed)),
        by,
        seed: args.seed,
        fractions: BTreeMap::from([
            ("train".to_owned(), args.train),
            ("val".to_owned(), args.val),
            ("test".to_owned(), args.test),
        ]),
    };
    let file = split(&Dataset::open(&args.place.dataset)?, &plan)?;
    if args.place.json {
        print_json(&json!({
            "file": format!("splits/{}.json", plan.name),
            "split": to_value(&file)?,
        }))
    } else {
        print(&split_text(&plan.name, &file))
    }
}

fn info_text(summary: &Summary) -> String {
    let mut text = String::new();
    let mut line = |name: &str, value: &str| {
        let _ = writeln!(text, "{name:<12} {value}");
    };
    let rigs: Vec<&str> = summary.rigs.iter().map(String::as_str).collect();
    line("name", &summary.name);
    line("licence", &summary.licence);
    line("labels", &summary.label_definition);
    line("rigs", &rigs.join(", "));
    line(
        "grasps",
        &match summary.unreadable {
            0 => summary.grasps.to_string(),
            unreadable => format!("{}, and {unreadable} unreadable", summary.grasps),
        },
    );
    line("outcomes", &outcomes_text(&summary.outcomes));
    if let Some(fraction) = summary.stable_fraction {
        line(
            "balance",
            &format!("{:.0} % of the labelled are stable", fraction * 100.0),
        );
    }
    if let (Some(first), Some(last)) = (&summary.first_captured_at, &summary.last_captured_at) {
        line("taken", &format!("{first} to {last}"));
    }
    line(
        "size",
        &format!(
            "{} ({} more in trash)",
            size_text(summary.bytes),
            size_text(summary.trash_bytes)
        ),
    );
    for (model, agreement) in &summary.predictions {
        line(
            "prediction",
            &format!(
                "{model}: {} of {} labelled grasps as predicted; {} slipped and {} held unexpectedly",
                agreement.agreed(),
                agreement.total(),
                agreement.false_stable,
                agreement.false_slip
            ),
        );
    }
    let width = summary
        .objects
        .keys()
        .map(|object| object.chars().count())
        .max()
        .unwrap_or(0)
        .max("object".len());
    if !summary.objects.is_empty() {
        let _ = writeln!(
            text,
            "\n{:<width$}  {:>6}  {:>6}  {:>10}",
            "object", "stable", "slip", "unlabelled"
        );
    }
    for (object, outcomes) in &summary.objects {
        let count = |outcome| outcomes.get(&outcome).copied().unwrap_or(0);
        let _ = writeln!(
            text,
            "{object:<width$}  {:>6}  {:>6}  {:>10}",
            count(Outcome::Stable),
            count(Outcome::Slip),
            count(Outcome::Unlabelled)
        );
    }
    if !summary.scenes.is_empty() {
        let scenes: Vec<String> = summary
            .scenes
            .iter()
            .map(|(scene, grasps)| format!("{scene} {grasps}"))
            .collect();
        let _ = writeln!(text, "\nscenes: {}", scenes.join(", "));
    }
    text
}

fn verify_text(report: &VerifyReport) -> String {
    let mut text = String::new();
    for problem in &report.problems {
        let place = problem.file.clone().or_else(|| {
            let grasp = problem.grasp.as_ref()?;
            Some(format!("grasps/{grasp}"))
        });
        let _ = writeln!(
            text,
            "{}  {}: {}\n  → {}",
            name_of(&problem.kind),
            place.unwrap_or_default(),
            problem.detail,
            problem.remedy
        );
    }
    for note in &report.notes {
        let _ = writeln!(text, "note  {note}");
    }
    let _ = writeln!(
        text,
        "{}, {} unlabelled, {} pending, {}",
        counted(report.grasps, "grasp"),
        report.unlabelled,
        report.pending,
        counted(report.problems.len(), "problem")
    );
    text
}

fn recover_text(report: &RecoverReport) -> String {
    let mut text = String::new();
    for action in &report.actions {
        let _ = writeln!(
            text,
            "{}{}  {}: {}",
            if action.lost { "LOST  " } else { "" },
            name_of(&action.kind),
            action.item,
            action.detail
        );
    }
    let _ = writeln!(
        text,
        "{}{}",
        counted(report.grasps, "grasp"),
        if report.dry_run {
            " would be whole; nothing was changed"
        } else {
            " whole"
        }
    );
    text
}

fn split_text(name: &str, file: &SplitFile) -> String {
    let all: usize = file.splits.values().map(|split| split.grasps.len()).sum();
    let mut text = format!("splits/{name}.json, by {}, seed {}\n", file.by, file.seed);
    for (name, part) in &file.splits {
        let fraction = 100.0 * part.grasps.len() as f64 / all.max(1) as f64;
        let _ = writeln!(
            text,
            "{name:<6} {:>6} ({fraction:.1} %)  {:>4}  {}",
            counted(part.grasps.len(), "grasp"),
            counted(part.groups.len(), &file.by.to_string()),
            outcomes_text(&part.outcomes)
        );
    }
    text
}
