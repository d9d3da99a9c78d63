//! `gripcast synth`: synthetic datasets, on a laptop or a cluster.
//!
//! ```text
//! gripcast synth plan --preset small --out P        plan the simulations
//! gripcast synth run --plan P                       run all of them, on all cores
//! gripcast synth run --plan P --shard 3/8           run shard 3 of 8; /8 with a scheduler's index
//! gripcast synth status --plan P                    show the progress
//! gripcast synth merge --plan P --out D             write the dataset: Parquet shards, split,
//! balanced gripcast synth report --plan P --dataset D --out R   report counts, examples and costs
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
    /// Write a plan: objects, properties, grasps, forces and seeds
    Plan(Box<synth_plan::Args>),
    /// Simulate and render a plan or a shard of it; an interrupted run is resumed
    Run(synth_run::Args),
    /// Show the progress of a plan
    Status(synth_run::StatusArgs),
    /// Select results of a plan and write the dataset
    Merge(synth_merge::Args),
    /// Report counts, balance, examples and costs of a plan and its dataset (HTML and JSON)
    Report(synth_report::Args),
}

/// Runs the command.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    match args.action {
        Action::Plan(args) => synth_plan::run(context, *args),
        Action::Run(args) => synth_run::run(context, args),
        Action::Status(args) => synth_run::status(&args),
        Action::Merge(args) => synth_merge::run(context, args),
        Action::Report(args) => synth_report::run(context, args),
    }
}
