//! Benchmarks for developers of gripcast: scenes and other implementations that the program itself
//! does not ship.
//!
//! ```text
//! cargo run --release -p gripcast-bench -- contact --peer ipctk --json
//! ```
//!
//! Each bench prints a table, or with `--json` one object `{"figures", "name", "params", "peers"}`.
//! `--peer` runs another implementation through `python3` in the same run. What users measure on
//! their machines is `gripcast bench`.

mod contact;
mod contact_scene;
mod depth_scene;
mod grasp;
mod grasp_cases;
mod live;
mod peer;
mod pose;
mod pose_scenes;
mod predict;
mod render;
mod rigid;
mod rigid_grasps;
mod synth;
mod timing;
mod train;

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use gripcast::cli::{Context, exit_code};

/// Benchmarks for developers of gripcast.
#[derive(Debug, Parser)]
#[command(
    name = "gripcast-bench",
    version,
    propagate_version = true,
    max_term_width = 100
)]
struct Cli {
    #[command(flatten)]
    context: Context,
    #[command(subcommand)]
    bench: Bench,
}

#[derive(Debug, Subcommand)]
enum Bench {
    /// The contact phases of one Newton iteration
    Contact(contact::Args),
    /// Simulated grasps, easy and hard: time, steps, Newton iterations, outcomes
    Grasp(grasp::Args),
    /// `gripcast bench live` with other decoders
    Live(live::Args),
    /// Poses of synthetic images: accuracy, detection, time
    Pose(pose::Args),
    /// `gripcast bench predict` with other engines
    Predict(predict::Args),
    /// Tactile and path-traced images
    Render(render::Args),
    /// Grasps of the rigid-body baseline, beside PyBullet's
    Rigid(rigid::Args),
    /// Simulated and rendered grasps per hour
    Synth(synth::Args),
    /// Samples that the classifier learns from in a second
    Train(train::Args),
}

fn main() -> ExitCode {
    let Cli { context, bench } = Cli::parse();
    exit_code("gripcast-bench", || match bench {
        Bench::Contact(args) => contact::run(&context, &args),
        Bench::Grasp(args) => grasp::run(&context, args),
        Bench::Live(args) => live::run(&context, &args),
        Bench::Pose(args) => pose::run(&context, &args),
        Bench::Predict(args) => predict::run(&context, &args),
        Bench::Render(args) => render::run(&context, args),
        Bench::Rigid(args) => rigid::run(&context, &args),
        Bench::Synth(args) => synth::run(&context, &args),
        Bench::Train(args) => train::run(&context, &args),
    })
}
