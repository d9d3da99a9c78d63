//! `gripcast tactile`: what recordings of tactile sensors show.

use super::{Context, tactile_track};
use gripcast_base::error::Result;

/// Arguments.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, clap::Subcommand)]
enum Action {
    /// Track the gel markers, or the contact's texture, of a recording
    Track(Box<tactile_track::Args>),
}

/// Runs the command.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    match args.action {
        Action::Track(args) => tactile_track::run(context, *args),
    }
}
