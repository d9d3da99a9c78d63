//! `gripcast bench`: measures gripcast on this machine.
//!
//! Each bench prints a table, or with `--json` one object `{"figures", "name", "params", "peers"}`.

use super::{
    Context, bench_contact, bench_daemon, bench_grasp, bench_live, bench_pose, bench_predict,
    bench_render, bench_rigid, bench_synth, bench_train,
};
use gripcast_base::error::Result;

/// Arguments.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    bench: Bench,
}

#[derive(Debug, clap::Subcommand)]
enum Bench {
    /// The complete live path: frames lost, latency, cores, memory
    Live(bench_live::Args),
    /// A daemon that collects: calls of the API, saves, viewers, memory
    Daemon(bench_daemon::Args),
    /// The contact phases of one Newton iteration
    Contact(bench_contact::Args),
    /// Simulated grasps, easy and hard: time, steps, Newton iterations, outcomes
    Grasp(bench_grasp::Args),
    /// Poses of synthetic pictures: accuracy, detection, time
    Pose(bench_pose::Args),
    /// One prediction: load, preprocess, engine
    Predict(bench_predict::Args),
    /// Tactile and path-traced pictures
    Render(bench_render::Args),
    /// Grasps of the rigid-body baseline, beside PyBullet's
    Rigid(bench_rigid::Args),
    /// Simulated and rendered grasps per hour
    Synth(bench_synth::Args),
    /// Samples that the classifier learns from in a second
    Train(bench_train::Args),
}

/// Runs the verb.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    match args.bench {
        Bench::Live(args) => bench_live::run(context, &args),
        Bench::Daemon(args) => bench_daemon::run(context, &args),
        Bench::Contact(args) => bench_contact::run(context, &args),
        Bench::Grasp(args) => bench_grasp::run(context, args),
        Bench::Pose(args) => bench_pose::run(context, &args),
        Bench::Predict(args) => bench_predict::run(context, &args),
        Bench::Render(args) => bench_render::run(context, args),
        Bench::Rigid(args) => bench_rigid::run(context, &args),
        Bench::Synth(args) => bench_synth::run(context, &args),
        Bench::Train(args) => bench_train::run(context, &args),
    }
}
