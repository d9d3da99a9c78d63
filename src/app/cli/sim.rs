//! `gripcast sim`: the grasp simulator.

use super::{Context, sim_grasp};
use crate::error::Result;

/// Arguments.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, clap::Subcommand)]
enum Action {
    /// Simulate one grasp: close, adjust the force, lift
    Grasp(Box<sim_grasp::Args>),
}

/// Runs the verb.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    match args.action {
        Action::Grasp(args) => sim_grasp::run(context, *args),
    }
}
