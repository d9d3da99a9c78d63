//! `gripcast dataset`: inspects, lists, verifies, recovers, indexes, splits, exports and imports
//! datasets.
//!
//! ```text
//! gripcast dataset info DIR      show counts, balance, size, predictions versus labels
//! gripcast dataset list DIR      list grasps by object, outcome and time
//! gripcast dataset verify DIR    read every file and report all problems
//! gripcast dataset recover DIR   recover readable grasps; the rest moves to trash/
//! gripcast dataset edit DIR ID…  correct object, scene or operator of saved grasps
//! gripcast dataset migrate DIR   bring it to the newest version of the format
//! gripcast dataset reindex DIR   rebuild metadata.jsonl from the records
//! gripcast dataset split DIR     split into train, val and test sets with disjoint objects
//! gripcast dataset export DIR    export to Parquet, WebDataset, LeRobot or Zarr
//! gripcast dataset import FILE…  import a third-party dataset as Parquet shards
//! ```
//!
//! Exit codes: 0 done · 1 failed · 2 usage · 3 done, but some grasps were unreadable or lost ·
//! 4 `verify` found problems · 130 interrupted.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::PathBuf;

use clap::Subcommand;
use serde_json::json;

use super::dataset_text::{counted, name_of, outcomes_text, size_text};
use super::flags::{fraction, named};
use super::working::interruptible;
use super::{
    Context, dataset_edit, dataset_export, dataset_import, dataset_list, print_json, print_report,
};
use crate::note;
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_dataset::{
    Dataset, GroupKey, MigrateReport, Outcome, Problem, RecoverReport, SplitFile, SplitPlan,
    Summary, VerifyReport, migrate, recover, reindex, split, summary, verify,
};

/// Arguments of `dataset`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Show the contents of a dataset
    Info(InfoArgs),
    /// List the grasps, newest first
    List(dataset_list::Args),
    /// Find damaged, missing, altered, duplicated and leaking data
    Verify(VerifyArgs),
    /// Recover readable grasps; move the rest to trash/
    Recover(RecoverArgs),
    /// Correct object, scene or operator of saved grasps
    Edit(dataset_edit::Args),
    /// Bring a dataset to the newest version of the format; any change of it does the same
    Migrate(DatasetArgs),
    /// Rebuild metadata.jsonl from the records
    Reindex(DatasetArgs),
    /// Split the grasps into sets with disjoint objects
    Split(SplitArgs),
    /// Export to another format
    Export(dataset_export::Args),
    /// Import a third-party dataset as Parquet shards for train and eval
    Import(dataset_import::Args),
}

#[derive(Debug, clap::Args)]
struct DatasetArgs {
    /// Folder of the dataset
    dataset: PathBuf,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Debug, clap::Args)]
struct InfoArgs {
    /// Folder of the dataset
    dataset: PathBuf,
    /// Print all objects
    #[arg(long)]
    all: bool,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Debug, clap::Args)]
struct VerifyArgs {
    /// Folder of the dataset
    dataset: PathBuf,
    /// Print every problem instead of a summary for each kind
    #[arg(long)]
    all: bool,
    /// Print the result, with every problem, as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Debug, clap::Args)]
struct RecoverArgs {
    /// Folder of the dataset
    dataset: PathBuf,
    /// Only print what would be done
    #[arg(long)]
    dry_run: bool,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Debug, clap::Args)]
struct SplitArgs {
    /// Folder of the dataset
    dataset: PathBuf,
    /// Fraction of the training set
    #[arg(long, value_name = "FRACTION", default_value_t = 0.7, value_parser = fraction)]
    train: f64,
    /// Fraction of the validation set
    #[arg(long, value_name = "FRACTION", default_value_t = 0.15, value_parser = fraction)]
    val: f64,
    /// Fraction of the test set
    #[arg(long, value_name = "FRACTION", default_value_t = 0.15, value_parser = fraction)]
    test: f64,
    /// Grouping key of the split (no group in two sets)
    #[arg(long, value_name = "KEY", default_value = "object", value_parser = named([
        ("object", "No object in two sets", GroupKey::Object),
        ("scene", "No scene in two sets", GroupKey::Scene),
    ]))]
    group_by: GroupKey,
    /// Random seed
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    seed: u64,
    /// Name of the file in splits/ [default: KEY-SEED]
    #[arg(long)]
    name: Option<String>,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    match args.action {
        Action::Info(args) => run_info(&args),
        Action::Verify(args) => run_verify(context, args),
        Action::List(args) => dataset_list::run(&args),
        Action::Recover(args) => run_recover(context, &args),
        Action::Edit(args) => dataset_edit::run(&args),
        Action::Migrate(args) => run_migrate(&args),
        Action::Reindex(args) => run_reindex(context, &args),
        Action::Split(args) => run_split(&args),
        Action::Export(args) => dataset_export::run(context, args),
        Action::Import(args) => dataset_import::run(context, args),
    }
}

fn run_info(args: &InfoArgs) -> Result<()> {
    let summary = summary(&Dataset::open(&args.dataset)?)?;
    print_report(args.json, &summary, |summary| info_text(summary, args.all))
}

fn run_verify(context: &Context, args: VerifyArgs) -> Result<()> {
    let dataset = args.dataset.clone();
    let report = interruptible(context, "verifying", move |progress| {
        verify(&dataset, &|done, all| progress.count(done, all))
    })??;
    print_report(args.json, &report, |report| verify_text(report, args.all))?;
    if report.problems.is_empty() {
        return Ok(());
    }
    Err(Error::new(
        ErrorKind::Check,
        format!("{} found", counted(report.problems.len(), "problem")),
    )
    .at(args.dataset.display())
    .remedy("`gripcast dataset recover` fixes recoverable problems"))
}

fn run_recover(context: &Context, args: &RecoverArgs) -> Result<()> {
    let report = recover(&args.dataset, args.dry_run)?;
    print_report(args.json, &report, recover_text)?;
    let lost = report.actions.iter().filter(|action| action.lost).count();
    if lost > 0 {
        return Err(Error::new(
            ErrorKind::Partial,
            format!("{} could not be recovered", counted(lost, "item")),
        )
        .at(args.dataset.display())
        .remedy("restore the files from a backup; moved files are in trash/, with the reason"));
    }
    if report.actions.is_empty() && !args.json && !context.quiet {
        note!("nothing to recover");
    }
    Ok(())
}

fn run_migrate(args: &DatasetArgs) -> Result<()> {
    let report = migrate(&args.dataset)?;
    print_report(args.json, &report, |report| {
        let MigrateReport { from, to } = report;
        match from == to {
            true => format!("the dataset is of version {to} of the format; nothing changed\n"),
            false => format!(
                "the dataset was of version {from} of the format and is of version {to} now; earlier \
                 versions of gripcast refuse it\n"
            ),
        }
    })
}

fn run_reindex(context: &Context, args: &DatasetArgs) -> Result<()> {
    let report = reindex(&args.dataset)?;
    if args.json {
        print_json(&report)?;
    } else if !context.quiet {
        let state = match report.changed {
            true => "written",
            false => "was up to date",
        };
        note!(
            "metadata.jsonl {state}: {}",
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
    .at(args.dataset.display())
    .remedy("run `gripcast dataset recover`"))
}

fn run_split(args: &SplitArgs) -> Result<()> {
    let by = args.group_by;
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
    let file = split(&Dataset::open(&args.dataset)?, &plan)?;
    let report = json!({ "file": format!("splits/{}.json", plan.name), "split": file });
    print_report(args.json, &report, |_| split_text(&plan.name, &file))
}

/// Objects that `info` prints without `--all`.
const OBJECTS: usize = 30;
/// Problems of a kind that `verify` prints without `--all`.
const PROBLEMS: usize = 3;

fn info_text(summary: &Summary, all: bool) -> String {
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
            &format!(
                "{:.0} % of the labelled grasps are stable",
                fraction * 100.0
            ),
        );
    }
    if let (Some(first), Some(last)) = (&summary.first_captured_at, &summary.last_captured_at) {
        line("taken", &format!("{first} to {last}"));
    }
    let fields = summary.fields.iter();
    let touch = fields
        .map(|(name, grasps)| format!("{name} of {}", counted(*grasps, "grasp")))
        .chain((summary.lifts > 0).then(|| format!("lift of {}", counted(summary.lifts, "grasp"))));
    let touch: Vec<String> = touch.collect();
    if !touch.is_empty() {
        line("touch", &touch.join(", "));
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
                "{model}: {} of {} labelled grasps correct; {} false stable, {} false slip",
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
    let shown = if all { usize::MAX } else { OBJECTS };
    for (object, outcomes) in summary.objects.iter().take(shown) {
        let count = |outcome| outcomes.get(&outcome).copied().unwrap_or(0);
        let _ = writeln!(
            text,
            "{object:<width$}  {:>6}  {:>6}  {:>10}",
            count(Outcome::Stable),
            count(Outcome::Slip),
            count(Outcome::Unlabelled)
        );
    }
    if let Some(more) = summary.objects.len().checked_sub(shown).filter(|n| *n > 0) {
        let _ = writeln!(
            text,
            "and {}; `--all` prints them",
            counted(more, "more object")
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

fn verify_text(report: &VerifyReport, all: bool) -> String {
    let mut text = String::new();
    let mut problems = report.problems.iter().peekable();
    for summary in &report.by_kind {
        let of_kind = std::iter::from_fn(|| problems.next_if(|p| p.kind == summary.kind));
        let is_short = all || summary.problems <= PROBLEMS;
        let shown = if is_short { usize::MAX } else { PROBLEMS };
        if !is_short {
            let grasps = match summary.grasps {
                0 => String::new(),
                grasps => format!(" in {}", counted(grasps, "grasp")),
            };
            let _ = writeln!(
                text,
                "{}  {}{grasps}, the first of them:",
                name_of(&summary.kind),
                counted(summary.problems, "problem")
            );
        }
        for problem in of_kind
            .enumerate()
            .filter_map(|(i, p)| (i < shown).then_some(p))
        {
            problem_text(&mut text, problem);
        }
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
    if !all && report.by_kind.iter().any(|kind| kind.problems > PROBLEMS) {
        text.push_str("`--all` prints every problem\n");
    }
    text
}

fn problem_text(text: &mut String, problem: &Problem) {
    let file = problem.file.clone().or_else(|| {
        let grasp = problem.grasp.as_ref()?;
        Some(format!("grasps/{grasp}"))
    });
    let _ = writeln!(
        text,
        "{}  {}: {}\n  → {}",
        name_of(&problem.kind),
        file.unwrap_or_default(),
        problem.detail,
        problem.remedy
    );
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
            " would be complete; nothing was changed"
        } else {
            " complete"
        }
    );
    text
}

fn split_text(name: &str, file: &SplitFile) -> String {
    let all: usize = file.splits.values().map(|set| set.grasps.len()).sum();
    let mut text = format!("splits/{name}.json, by {}, seed {}\n", file.by, file.seed);
    for (name, set) in &file.splits {
        let percent = 100.0 * set.grasps.len() as f64 / all.max(1) as f64;
        let _ = writeln!(
            text,
            "{name:<6} {:>6} ({percent:.1} %)  {:>4}  {}",
            counted(set.grasps.len(), "grasp"),
            counted(set.groups.len(), &file.by.to_string()),
            outcomes_text(&set.outcomes)
        );
    }
    text
}
