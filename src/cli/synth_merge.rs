//! `gripcast synth merge`: writes the dataset of a plan.
//!
//! Exit codes: 0 complete · 1 failed · 2 usage · 3 written, but simulations of the plan are open or
//! failed · 130 interrupted.

use std::path::PathBuf;

use super::flags::{named, number};
use super::working::interruptible;
use super::{Context, print_report};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::number::NumberRange;
use gripcast_dataset::shard::SplitFractions;
use gripcast_synth::curate::{CurationSettings, GroupKey, LabelBalance};
use gripcast_synth::plan::Plan;
use gripcast_synth::{MergeReport, MergeSettings, merge};

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder of the plan with its results
    #[arg(long, value_name = "DIR")]
    plan: PathBuf,
    /// Output directory of the dataset
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    selection: SelectionFlags,
    /// Merge the finished simulations of an incomplete plan
    #[arg(long)]
    partial: bool,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// Selection of simulations.
#[derive(Clone, Debug, clap::Args)]
pub(super) struct SelectionFlags {
    /// Splits and their fractions
    #[arg(long, value_name = "SPLIT=FRACTION,…", default_value_t = SplitFractions::standard())]
    split: SplitFractions,
    /// Grouping key of the split (no group in two splits)
    #[arg(long, value_name = "KEY", default_value = "object", value_parser = named([
        ("object", "No object in two splits", GroupKey::Object),
        ("category", "No category in two splits (harder)", GroupKey::Category),
    ]))]
    group_by: GroupKey,
    /// Maximum simulations of a category per split, as a multiple of the mean; 0 disables the cap
    #[arg(long, value_name = "FACTOR", default_value_t = 2.0,
        value_parser = number(NumberRange::NOT_NEGATIVE))]
    category_cap: f64,
    /// How the labels of a split are balanced
    #[arg(long, value_name = "BALANCE", default_value = "overall", value_parser = named([
        ("overall", "As many stable grasps as slips in the split, dropped at random (as in the \
            paper's test set)", LabelBalance::Overall),
        ("category", "At each force, first from the categories with the largest surplus",
            LabelBalance::Category),
        ("none", "Keep all labelled simulations", LabelBalance::None),
    ]))]
    balance: LabelBalance,
    /// Balance all splits but `train`, where training weights the labels instead
    #[arg(long)]
    whole_train: bool,
    /// Random seed of the selection
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    seed: u64,
}

/// Runs the command.
pub(super) fn run(context: &Context, args: Args) -> Result<()> {
    let settings = MergeSettings {
        curation: args.selection.curation(),
        allow_partial: args.partial,
    };
    let is_json = args.json;
    let report = interruptible(context, "merging", move |progress| {
        let plan = Plan::read(&args.plan)?;
        merge(&plan, &args.plan, &args.out, &settings, &|done, all| {
            progress.count(done, all);
        })
    })??;
    print_report(is_json, &report, text)?;
    if report.open + report.failed == 0 {
        return Ok(());
    }
    Err(Error::new(
        ErrorKind::Partial,
        format!(
            "{} simulations of the plan are open, {} failed",
            report.open, report.failed
        ),
    )
    .remedy(match report.open {
        0 => "repeat them: gripcast synth run --retry-failed",
        _ => "finish them with `gripcast synth run` and merge again for the whole plan",
    }))
}

impl SelectionFlags {
    pub(super) fn curation(&self) -> CurationSettings {
        CurationSettings {
            group_by: self.group_by,
            splits: self.split.clone(),
            category_cap: (self.category_cap > 0.0).then_some(self.category_cap),
            balance: self.balance,
            keep_all_training: self.whole_train,
            seed: self.seed,
        }
    }
}

fn text(report: &MergeReport) -> String {
    let mut text = String::new();
    for (name, split) in &report.splits {
        text.push_str(&format!(
            "{name}: {} rows of {} grasps of {} objects; {} stable, {} slip\n",
            split.rows, split.grasps, split.objects, split.stable, split.slip
        ));
    }
    let splits = report.curation.splits.names();
    for name in splits.filter(|name| !report.splits.contains_key(*name)) {
        text.push_str(&format!(
            "{name}: empty; too few objects, or all their simulations have the same label\n"
        ));
    }
    let left_out: usize = report.left_out.values().sum();
    let without: usize = report.without_sample.values().sum();
    text.push_str(&format!(
        "left out: {left_out} for balance and caps, {without} without a visible outcome"
    ));
    if !report.incomplete.is_empty() {
        let category = |(name, [finished, planned]): (&String, &[usize; 2])| {
            format!("{name} {finished} of {planned}")
        };
        let categories: Vec<_> = report.incomplete.iter().map(category).collect();
        text.push_str(&format!(
            "\nincomplete categories: {}",
            categories.join(", ")
        ));
    }
    text
}
