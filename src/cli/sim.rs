//! `gripcast sim`: grasp simulation.

use super::{Context, sim_grasp, sim_mesh, sim_press, sim_validate};
use gripcast_base::error::Result;

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
    /// Check the mesh of an object: repairs, volume, stable poses
    Mesh(Box<sim_mesh::Args>),
    /// Simulate an indentation test: force versus depth
    Press(Box<sim_press::Args>),
    /// Validate the simulator against theory and converged finite elements
    Validate(sim_validate::Args),
}

/// Runs the command.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    match args.action {
        Action::Grasp(args) => sim_grasp::run(context, *args),
        Action::Mesh(args) => sim_mesh::run(context, &args),
        Action::Press(args) => sim_press::run(context, *args),
        Action::Validate(args) => sim_validate::run(context, args),
    }
}
