//! `gripcast synth`: the synthetic dataset, from a laptop to a cluster.
//!
//! ```text
//! gripcast synth plan --preset small --out P        what is to be simulated; nothing is yet
//! gripcast synth run --plan P                       all of it, on all cores
//! gripcast synth run --plan P --shard 3/8           part 3 of 8; /8 where a scheduler tells the index
//! gripcast synth status --plan P                    how far it is, from its files
//! gripcast synth merge --plan P --out D             the dataset: Parquet shards, split and balanced
//! gripcast synth report --plan P --dataset D --out R   what is in it, what it looks like, what it cost
//! ```

use super::{Context, synth_merge, synth_plan, synth_report, synth_run};
use gripcast_base::error::Result;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(Clone, Debug, clap::Subcommand)]
enum Action {
    /// Write a plan: objects, their properties, grasps, forces and seeds
    Plan(Box<synth_plan::Args>),
    /// Simulate and render a plan or a part of it; goes on where it stopped
    Run(synth_run::Args),
    /// How far the simulations of a plan are
    Status(synth_run::StatusArgs),
    /// Choose from the results of a plan and write the dataset
    Merge(synth_merge::Args),
    /// Counts, balance, examples and costs of a plan and its dataset, as a page and as JSON
    Report(synth_report::Args),
}

/// Runs the verb.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    match args.action {
        Action::Plan(args) => synth_plan::run(context, *args),
        Action::Run(args) => synth_run::run(context, args),
        Action::Status(args) => synth_run::status(&args),
        Action::Merge(args) => synth_merge::run(context, args),
        Action::Report(args) => synth_report::run(context, args),
    }
}
