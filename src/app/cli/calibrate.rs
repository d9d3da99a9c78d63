//! `gripcast calibrate`: what the cameras are.

use super::{Context, calibrate_intrinsics};
use crate::error::Result;

/// Arguments.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
pub(crate) enum What {
    /// Intrinsics of a camera from views of a flat board
    Intrinsics(calibrate_intrinsics::Args),
}

/// Runs the verb.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    match args.what {
        What::Intrinsics(args) => calibrate_intrinsics::run(context, &args),
    }
}
