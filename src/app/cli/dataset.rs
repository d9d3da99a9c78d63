//! `gripcast dataset`

use super::Context;
use crate::error::Result;

/// Arguments.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {}

/// Runs the verb.
pub(crate) fn run(_context: &Context, _args: Args) -> Result<()> {
    Ok(())
}
