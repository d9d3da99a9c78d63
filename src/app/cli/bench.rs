//! `gripcast bench`: measures gripcast on this machine.
//!
//! Each bench prints a table, or with `--json` one object `{"figures", "name", "params", "peers"}`.

use super::{Context, bench_predict};
use crate::error::Result;

/// Arguments.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    bench: Bench,
}

#[derive(Debug, clap::Subcommand)]
enum Bench {
    /// One prediction: load, preprocess, engine
    Predict(bench_predict::Args),
}

/// Runs the verb.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    match args.bench {
        Bench::Predict(args) => bench_predict::run(context, &args),
    }
}
