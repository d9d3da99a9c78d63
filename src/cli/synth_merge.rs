//! `gripcast synth merge`: the dataset of a plan.
//!
//! Exit codes: 0 the dataset is whole · 1 it could not be written · 2 usage · 3 it was written, but
//! simulations of the plan are open or could not be done · 130 interrupted.

use std::path::PathBuf;

use super::working::interruptible;
use super::{Context, print_report};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_dataset::shard::SplitFractions;
use gripcast_synth::curate::{Apart, CurationSettings};
use gripcast_synth::plan::Plan;
use gripcast_synth::{MergeReport, MergeSettings, merge};

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder of the plan with its results
    #[arg(long, value_name = "DIR")]
    plan: PathBuf,
    /// Folder of the dataset
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    choice: ChoiceArgs,
    /// Merge what is there of a plan that is not finished
    #[arg(long)]
    partial: bool,
    /// Print what is in the dataset as JSON
    #[arg(long)]
    json: bool,
}

/// Which simulations are chosen.
#[derive(Clone, Debug, clap::Args)]
pub(super) struct ChoiceArgs {
    /// Parts and their fractions
    #[arg(long, value_name = "PART=FRACTION,…", default_value_t = SplitFractions::standard())]
    split: SplitFractions,
    /// What may not be in two parts
    #[arg(long, value_enum, default_value_t = ApartName::Object)]
    apart: ApartName,
    /// Most simulations of a category in a part, as a multiple of the mean; 0 for no cap
    #[arg(long, value_name = "TIMES", default_value_t = 2.0)]
    category_cap: f64,
    /// Keep all of both labels instead of as many of one as of the other
    #[arg(long)]
    unbalanced: bool,
    /// Keep all of both labels in the part `train`; training weighs them, the other parts are
    /// balanced
    #[arg(long, conflicts_with = "unbalanced")]
    whole_train: bool,
    /// Decides what is left out
    #[arg(long, default_value_t = 0)]
    seed: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum ApartName {
    /// Objects
    Object,
    /// Whole categories, which is harder
    Category,
}

/// Runs the verb.
pub(super) fn run(context: &Context, args: Args) -> Result<()> {
    let settings = MergeSettings {
        curation: args.choice.curation()?,
        is_partial_allowed: args.partial,
    };
    let is_json = args.json;
    let report = interruptible(context, "merging", move |progress| {
        let plan = Plan::read(&args.plan)?;
        merge(&plan, &args.plan, &args.out, &settings, &|done, all| {
            progress.at(done as u64, all as u64);
        })
    })??;
    print_report(is_json, &report, text)?;
    if report.open + report.failed == 0 {
        return Ok(());
    }
    Err(Error::new(
        ErrorKind::Partial,
        format!(
            "{} simulations of the plan are open, {} could not be done",
            report.open, report.failed
        ),
    ))
}

impl ChoiceArgs {
    pub(super) fn curation(&self) -> Result<CurationSettings> {
        if !(self.category_cap >= 0.0 && self.category_cap.is_finite()) {
            return Err(Error::usage(format!(
                "`--category-cap` must be 0 or above, found {}",
                self.category_cap
            )));
        }
        Ok(CurationSettings {
            apart: match self.apart {
                ApartName::Object => Apart::Object,
                ApartName::Category => Apart::Category,
            },
            parts: self.split.clone(),
            category_cap: (self.category_cap > 0.0).then_some(self.category_cap),
            is_balanced: !self.unbalanced,
            is_training_whole: self.whole_train,
            seed: self.seed,
        })
    }
}

fn text(report: &MergeReport) -> String {
    let mut text = String::new();
    for (name, part) in &report.parts {
        text.push_str(&format!(
            "{name}: {} rows of {} grasps on {} objects; {} simulations held, {} were lost\n",
            part.rows, part.grasps, part.objects, part.stable, part.slip
        ));
    }
    let parts = report.curation.parts.names();
    for name in parts.filter(|name| !report.parts.contains_key(*name)) {
        text.push_str(&format!(
            "{name}: nothing; it has too few objects, or all of their simulations ended alike\n"
        ));
    }
    let left_out: usize = report.left_out.values().sum();
    let without: usize = report.without_sample.values().sum();
    text.push_str(&format!(
        "left out: {left_out} for balance and caps, {without} without an outcome to see"
    ));
    text
}
