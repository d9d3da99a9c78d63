//! `gripcast render`: the sensor images of simulated grasps.

use super::{Context, render_calibrate, render_clip, render_figure, render_tactile, render_visual};
use gripcast_base::error::Result;

/// Arguments.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, clap::Subcommand)]
enum Action {
    /// Render tactile images (GelSight Mini)
    Tactile(Box<render_tactile::Args>),
    /// Render path-traced images of the eye-in-hand camera
    Visual(Box<render_visual::Args>),
    /// Fit a sensor profile to ball presses, or score one
    Calibrate(Box<render_calibrate::Args>),
    /// Render clips of simulated grasps for the virtual rig
    Clip(render_clip::Args),
    /// Draw a comparison of the renderers
    Figure(render_figure::Args),
}

/// Runs the command.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    match args.action {
        Action::Tactile(args) => render_tactile::run(context, *args),
        Action::Visual(args) => render_visual::run(context, *args),
        Action::Calibrate(args) => render_calibrate::run(context, *args),
        Action::Clip(args) => render_clip::run(context, args),
        Action::Figure(args) => render_figure::run(context, args),
    }
}
