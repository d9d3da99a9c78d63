//! `gripcast completions SHELL`: prints a completion script.

use super::command;
use gripcast_base::error::Result;

/// Arguments of `completions`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Shell to complete for
    shell: clap_complete::Shell,
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<()> {
    let mut command = command();
    clap_complete::generate(args.shell, &mut command, "gripcast", &mut std::io::stdout());
    Ok(())
}
