//! Benchmarks for developers of gripcast, with scenes and baselines that the program does not ship.
//!
//! ```text
//! cargo run --release -p gripcast-bench -- contact --baseline ipctk --json
//! ```
//!
//! Each benchmark prints a table, or with `--json` one object `{"figures", "name", "params",
//! "baselines"}`. `--baseline` also runs another implementation through `python3`. The benchmarks
//! for users are `gripcast bench`.

mod baseline;
mod contact;
mod contact_scene;
mod dataset;
mod depth_scene;
mod early_end;
mod force_figures;
mod force_fit;
mod force_model;
mod force_presses;
mod force_samples;
mod grasp;
mod grasp_cases;
mod live;
mod pose;
mod pose_scenes;
mod predict;
mod real_alarm;
mod real_clips;
mod render;
mod rigid;
mod rigid_grasps;
mod synth;
mod timing;
mod tracking;
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
    /// Contact phases of a Newton iteration
    Contact(contact::Args),
    /// Index and pages of a large dataset
    Dataset(dataset::Args),
    /// Lifts that end once their outcome is certain
    EarlyEnd(early_end::Args),
    /// Fits the force model to simulated presses and measures it on held-out ones
    ForceModel(force_model::Args),
    /// Simulated grasps: time, steps, Newton iterations, outcomes
    Grasp(grasp::Args),
    /// `gripcast bench live` with baseline decoders
    Live(live::Args),
    /// Pose estimation on synthetic images: accuracy, detection, time
    Pose(pose::Args),
    /// `gripcast bench predict` with baseline engines
    Predict(predict::Args),
    /// Contact, tracking, predictions and alarms on recorded grasps of two fingers
    RealClips(real_clips::Args),
    /// Tactile and visual rendering
    Render(render::Args),
    /// Rigid-body grasps, compared with PyBullet
    Rigid(rigid::Args),
    /// Simulated and rendered grasps per hour
    Synth(synth::Args),
    /// Tracking of gel markers and contact texture
    Tracking(tracking::Args),
    /// Training throughput
    Train(train::Args),
}

fn main() -> ExitCode {
    let Cli { context, bench } = Cli::parse();
    exit_code("gripcast-bench", || match bench {
        Bench::Contact(args) => contact::run(&context, &args),
        Bench::EarlyEnd(args) => early_end::run(&context, &args),
        Bench::Dataset(args) => dataset::run(&context, &args),
        Bench::ForceModel(args) => force_model::run(&context, args),
        Bench::Grasp(args) => grasp::run(&context, args),
        Bench::Live(args) => live::run(&context, &args),
        Bench::Pose(args) => pose::run(&context, &args),
        Bench::Predict(args) => predict::run(&context, &args),
        Bench::RealClips(args) => real_clips::run(&context, &args),
        Bench::Render(args) => render::run(&context, args),
        Bench::Rigid(args) => rigid::run(&context, &args),
        Bench::Synth(args) => synth::run(&context, &args),
        Bench::Tracking(args) => tracking::run(&context, &args),
        Bench::Train(args) => train::run(&context, &args),
    })
}
