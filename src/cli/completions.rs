//! `gripcast completions SHELL`: prints a completion script.

use super::{Context, command};
use gripcast_base::error::Result;

/// Arguments of `completions`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Shell to complete for
    shell: clap_complete::Shell,
}

/// Runs the verb.
pub(crate) fn run(_context: &Context, args: &Args) -> Result<()> {
    let mut command = command();
    clap_complete::generate(args.shell, &mut command, "gripcast", &mut std::io::stdout());
    Ok(())
}
