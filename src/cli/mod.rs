//! The command line: one file a verb. stdout is data, stderr is for people.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::{CommandFactory as _, Parser, Subcommand};

use crate::config::{self as settings, ConfigFile, FlagValue, Layered};
use crate::note;
pub(crate) use crate::terminal_text::{print, print_json, print_report};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::allow_links_into;

mod annotate;
pub mod bench;
mod bench_daemon;
pub mod bench_live;
pub mod bench_predict;
mod board;
mod board_charuco;
mod board_make;
mod calibrate;
mod calibrate_convert;
mod calibrate_gripper;
mod calibrate_intrinsics;
mod calibrate_live;
mod closing_report;
mod collect;
mod collection_flags;
mod completions;
mod config;
mod daemon;
mod dataset;
mod dataset_export;
mod dataset_import;
mod dataset_text;
mod doctor;
mod eval;
mod experiment;
mod image_folder;
mod man;
mod predict;
mod render;
mod render_calibrate;
mod render_figure;
mod render_film;
mod render_out;
mod render_source;
mod render_tactile;
mod render_visual;
mod replay;
mod replay_report;
mod rig;
mod sim;
mod sim_grasp;
mod sim_object;
mod sim_press;
mod sim_validate;
mod synth;
mod synth_merge;
mod synth_plan;
mod synth_report;
mod synth_run;
mod train;
mod training_flags;
pub mod working;

/// Collect grasps with touch; predict before the lift whether they hold.
#[derive(Debug, Parser)]
#[command(
    name = "gripcast",
    version,
    propagate_version = true,
    max_term_width = 100
)]
struct Cli {
    #[command(flatten)]
    context: Context,
    #[command(subcommand)]
    verb: Verb,
}

/// Flags of every verb.
#[derive(Clone, Debug, clap::Args)]
pub struct Context {
    /// Say more (repeat for more)
    #[arg(short, long, global = true, action = clap::ArgAction::Count, conflicts_with = "quiet")]
    pub verbose: u8,
    /// Say nothing but errors
    #[arg(short, long, global = true)]
    pub quiet: bool,
}

/// Which configuration file is read.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct ConfigFlag {
    /// Configuration file [default: ./gripcast.toml or ~/.config/gripcast/config.toml]
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
}

impl ConfigFlag {
    /// The file, if there is one.
    pub(crate) fn file(&self) -> Option<ConfigFile> {
        let named = self.config.clone().map(ConfigFile::Chosen);
        named.or_else(settings::default_file)
    }

    /// All settings, with flags over them.
    pub(crate) fn load(&self, flags: &[FlagValue]) -> Result<Layered> {
        load_settings(self.file().as_ref(), flags)
    }
}

/// All settings. What is ignored is said on stderr, even with `--quiet`.
pub(crate) fn load_settings(file: Option<&ConfigFile>, flags: &[FlagValue]) -> Result<Layered> {
    let layered = settings::load(file, std::env::vars(), flags)?;
    for (key, ignored) in &layered.ignored {
        note!("gripcast: {}", ignored.warning(key));
    }
    Ok(layered)
}

/// Creates a folder for what a command writes, and those above it.
pub(crate) fn create_folder(path: &Path) -> Result<()> {
    fs::create_dir_all(path)
        .map_err(|e| Error::io("cannot create the folder", e).at(path.display()))
}

#[derive(Debug, Subcommand)]
enum Verb {
    /// Collect grasps: live cameras, triggers, prediction, crash-safe saving
    Collect(collect::Args),
    /// Collect as a service with a page and an API for browsers, pedals and programs
    Daemon(daemon::Args),
    /// List cameras, write a rig file, check a rig
    Rig(rig::Args),
    /// Find out why collecting would not work here, and what helps
    Doctor(doctor::Args),
    /// Print boards and tags of markers, look at board files
    Board(board::Args),
    /// Find out where the gripper was in collected grasps
    Annotate(annotate::Args),
    /// Calibrate cameras and the gripper's tags; convert and look at intrinsics
    Calibrate(calibrate::Args),
    /// Predict the stability of recorded grasps, or check a model
    Predict(predict::Args),
    /// Look at, verify, repair, index, split and export a dataset
    Dataset(dataset::Args),
    /// Simulate grasps
    Sim(sim::Args),
    /// Render what the sensors would see of simulated grasps
    Render(render::Args),
    /// Replay annotated grasps in the simulators and compare with what happened
    Replay(Box<replay::Args>),
    /// Generate labelled synthetic datasets, on one machine or many
    Synth(Box<synth::Args>),
    /// Train a stability classifier on a dataset
    Train(Box<train::Args>),
    /// Measure models on a dataset whose outcomes are known
    Eval(eval::Args),
    /// Repeat comparisons of the paper
    Experiment(experiment::Args),
    /// Measure gripcast on this machine
    Bench(bench::Args),
    /// Show the configuration and where each value comes from
    Config(config::Args),
    /// Print a completion script for a shell
    Completions(completions::Args),
    /// Write the manual pages
    Man(man::Args),
}

/// The command line with all its verbs, for manual pages, completions and tests.
#[must_use]
pub fn command() -> clap::Command {
    Cli::command()
}

/// Runs the command line of this process.
#[must_use]
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    exit_code("gripcast", || run(cli))
}

/// Runs what a command line asks `program` for. An error goes to stderr and decides the exit code.
pub fn exit_code(program: &str, run: impl FnOnce() -> Result<()>) -> ExitCode {
    allow_links_into(settings::linked_folders());
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            note!("{program}: {error}");
            ExitCode::from(error.kind().exit_code())
        }
    }
}

fn run(cli: Cli) -> Result<()> {
    let context = cli.context;
    match cli.verb {
        Verb::Collect(args) => collect::run(&context, args),
        Verb::Rig(args) => rig::run(&context, args),
        Verb::Daemon(args) => daemon::run(&context, args),
        Verb::Doctor(args) => doctor::run(&context, args),
        Verb::Board(args) => board::run(&context, args),
        Verb::Annotate(args) => annotate::run(&context, args),
        Verb::Calibrate(args) => calibrate::run(&context, args),
        Verb::Predict(args) => predict::run(&context, args),
        Verb::Dataset(args) => dataset::run(&context, args),
        Verb::Sim(args) => sim::run(&context, args),
        Verb::Render(args) => render::run(&context, args),
        Verb::Replay(args) => replay::run(&context, *args),
        Verb::Synth(args) => synth::run(&context, *args),
        Verb::Train(args) => train::run(&context, *args),
        Verb::Eval(args) => eval::run(&context, args),
        Verb::Experiment(args) => experiment::run(&context, args),
        Verb::Bench(args) => bench::run(&context, args),
        Verb::Config(args) => config::run(&context, args),
        Verb::Completions(args) => completions::run(&context, &args),
        Verb::Man(args) => man::run(&context, &args),
    }
}
