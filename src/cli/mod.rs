//! The command line, one file per command. stdout carries data, stderr carries text for people.

use std::any::TypeId;
use std::fmt::Display;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::{ArgAction, CommandFactory as _, FromArgMatches as _, Parser, Subcommand};

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
mod board_detect;
mod board_make;
mod calibrate;
mod calibrate_convert;
mod calibrate_force;
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
mod dataset_edit;
mod dataset_export;
mod dataset_import;
mod dataset_list;
mod dataset_text;
mod doctor;
mod eval;
mod experiment;
mod flags;
mod image_folder;
mod man;
mod mesh_repair;
mod predict;
mod predict_conformal;
mod predict_stamp;
mod render;
mod render_calibrate;
mod render_clip;
mod render_figure;
mod render_out;
mod render_source;
mod render_tactile;
mod render_visual;
mod replay;
mod replay_report;
mod rig;
mod sim;
mod sim_grasp;
mod sim_mesh;
mod sim_object;
mod sim_press;
mod sim_validate;
mod synth;
mod synth_merge;
mod synth_plan;
mod synth_report;
mod synth_run;
mod tactile;
mod tactile_overlay;
mod tactile_recording;
mod tactile_table;
mod tactile_track;
mod train;
mod training_flags;
pub mod working;

/// Collect visuo-tactile grasps and predict their stability before the lift
#[derive(Debug, Parser)]
#[command(
    name = "gripcast",
    version,
    propagate_version = true,
    disable_help_flag = true,
    disable_version_flag = true,
    max_term_width = 100
)]
struct Cli {
    #[command(flatten)]
    context: Context,
    /// Print help
    #[arg(short, long, global = true, action = ArgAction::Help, help_heading = GLOBAL)]
    help: Option<bool>,
    /// Print version
    #[arg(short = 'V', long, global = true, action = ArgAction::Version, help_heading = GLOBAL)]
    version: Option<bool>,
    #[command(subcommand)]
    command: Command,
}

/// Heading of the options that every command has.
const GLOBAL: &str = "Global options";

/// Options of every command.
#[derive(Clone, Debug, clap::Args)]
pub struct Context {
    /// Increase verbosity (repeatable)
    #[arg(short, long, global = true, action = ArgAction::Count, conflicts_with = "quiet",
        help_heading = GLOBAL)]
    pub verbose: u8,
    /// Only print errors
    #[arg(short, long, global = true, help_heading = GLOBAL)]
    pub quiet: bool,
}

impl Context {
    /// Prints warnings on stderr, unless `--quiet`.
    pub(crate) fn warn<T: Display>(&self, warnings: impl IntoIterator<Item = T>) {
        if !self.quiet {
            for warning in warnings {
                note!("gripcast: {warning}");
            }
        }
    }
}

/// The configuration file option.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct ConfigFlag {
    /// Configuration file [default: ./gripcast.toml or ~/.config/gripcast/config.toml]
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
}

impl ConfigFlag {
    /// Returns the chosen or the default configuration file, if any.
    pub(crate) fn file(&self) -> Option<ConfigFile> {
        let chosen = self.config.clone().map(ConfigFile::Chosen);
        chosen.or_else(settings::default_file)
    }

    /// Loads all settings; `flags` override the file and the environment.
    pub(crate) fn load(&self, flags: &[FlagValue]) -> Result<Layered> {
        load_settings(self.file().as_ref(), flags)
    }
}

/// Loads all settings. Ignored values are reported on stderr, even with `--quiet`.
pub(crate) fn load_settings(file: Option<&ConfigFile>, flags: &[FlagValue]) -> Result<Layered> {
    let layered = settings::load(file, std::env::vars(), flags)?;
    for (key, ignored) in &layered.ignored {
        note!("gripcast: {}", ignored.warning(key));
    }
    Ok(layered)
}

/// Creates an output folder and its parents.
pub(crate) fn create_folder(path: &Path) -> Result<()> {
    fs::create_dir_all(path)
        .map_err(|e| Error::io("cannot create the folder", e).at(path.display()))
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Collect grasps: live cameras, triggers, prediction, crash-safe saving
    Collect(collect::Args),
    /// Run the collection as a service with a web page and an API
    Daemon(daemon::Args),
    /// List cameras, write a rig file, check a rig
    Rig(rig::Args),
    /// Diagnose the rig, the machine and the dataset folder
    Doctor(doctor::Args),
    /// Print marker boards and tags, inspect and import board files
    Board(board::Args),
    /// Estimate the gripper pose of collected grasps
    Annotate(annotate::Args),
    /// Calibrate cameras, gripper tags and forces; convert and inspect intrinsics
    Calibrate(calibrate::Args),
    /// Predict the stability of recorded grasps, or check a model
    Predict(predict::Args),
    /// Inspect, verify, recover, index, split, export and import datasets
    Dataset(dataset::Args),
    /// Simulate grasps
    Sim(sim::Args),
    /// Render the sensor images of simulated grasps
    Render(render::Args),
    /// Track the gel markers of tactile recordings
    Tactile(tactile::Args),
    /// Replay annotated grasps in the simulators and compare the outcomes
    Replay(Box<replay::Args>),
    /// Generate labelled synthetic datasets, on one machine or many
    Synth(Box<synth::Args>),
    /// Train a stability classifier on a dataset
    Train(Box<train::Args>),
    /// Evaluate models on a labelled dataset
    Eval(eval::Args),
    /// Reproduce experiments of the paper
    Experiment(experiment::Args),
    /// Benchmark gripcast on this machine
    Bench(bench::Args),
    /// Show the configuration and the origin of each value
    Config(config::Args),
    /// Print a shell completion script
    Completions(completions::Args),
    /// Write the manual pages
    Man(man::Args),
}

/// Returns the command line with all commands, for manual pages, completions and tests.
#[must_use]
pub fn command() -> clap::Command {
    with_negative_numbers(Cli::command())
}

/// Lets options with numbers take values such as `-.006` and `-1e-3,2e-3` as the next argument.
fn with_negative_numbers(command: clap::Command) -> clap::Command {
    let numbers = [
        TypeId::of::<f64>(),
        TypeId::of::<f32>(),
        TypeId::of::<[f64; 2]>(),
        TypeId::of::<[f64; 3]>(),
        TypeId::of::<i64>(),
        TypeId::of::<i32>(),
    ];
    let takes_negative = move |arg: clap::Arg| {
        let kind = arg.get_value_parser().type_id();
        let is_number = arg.get_long().is_some() && numbers.iter().any(|n| kind == *n);
        if is_number {
            arg.allow_hyphen_values(true)
        } else {
            arg
        }
    };
    command
        .mut_args(takes_negative)
        .mut_subcommands(with_negative_numbers)
}

/// Runs the command line of this process.
#[must_use]
pub fn main() -> ExitCode {
    let parsed = Cli::from_arg_matches_mut(&mut command().get_matches());
    let cli = parsed.unwrap_or_else(|error| error.format(&mut command()).exit());
    exit_code("gripcast", || run(cli))
}

/// Runs `program`. An error is printed on stderr and decides the exit code.
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
    match cli.command {
        Command::Collect(args) => collect::run(&context, args),
        Command::Rig(args) => rig::run(&context, args),
        Command::Daemon(args) => daemon::run(&context, args),
        Command::Doctor(args) => doctor::run(&context, args),
        Command::Board(args) => board::run(&context, args),
        Command::Annotate(args) => annotate::run(&context, args),
        Command::Calibrate(args) => calibrate::run(&context, args),
        Command::Predict(args) => predict::run(&context, args),
        Command::Dataset(args) => dataset::run(&context, args),
        Command::Sim(args) => sim::run(&context, args),
        Command::Render(args) => render::run(&context, args),
        Command::Tactile(args) => tactile::run(&context, args),
        Command::Replay(args) => replay::run(&context, *args),
        Command::Synth(args) => synth::run(&context, *args),
        Command::Train(args) => train::run(&context, *args),
        Command::Eval(args) => eval::run(&context, args),
        Command::Experiment(args) => experiment::run(&context, args),
        Command::Bench(args) => bench::run(&context, args),
        Command::Config(args) => config::run(args),
        Command::Completions(args) => completions::run(&args),
        Command::Man(args) => man::run(&context, &args),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A floating-point option of a command: its path and name.
    fn floats(command: &clap::Command, path: &[String]) -> Vec<(Vec<String>, String)> {
        let own = command.get_arguments().filter_map(|arg| {
            let kind = arg.get_value_parser().type_id();
            let is_float = kind == TypeId::of::<f64>() || kind == TypeId::of::<f32>();
            let name = arg.get_long().filter(|_| is_float)?;
            Some((path.to_vec(), name.to_owned()))
        });
        let own: Vec<_> = own.collect();
        let inner = command.get_subcommands().flat_map(|inner| {
            let path = [path, &[inner.get_name().to_owned()]].concat();
            floats(inner, &path)
        });
        own.into_iter().chain(inner).collect()
    }

    #[test]
    fn floating_point_options_refuse_numbers_that_are_not_finite() {
        let found = floats(&command(), &["gripcast".to_owned()]);
        assert!(found.len() > 40, "{found:?}");
        for (path, name) in found {
            for bad in ["nan", "-nan", "inf", "-inf", "1e400", "ten"] {
                let option = format!("--{name}={bad}");
                let arguments = path.iter().cloned().chain([option.clone()]);
                let error = command().try_get_matches_from(arguments).unwrap_err();
                let text = error.to_string();
                assert_eq!(
                    error.kind(),
                    clap::error::ErrorKind::ValueValidation,
                    "{path:?} {option}: {text}"
                );
                assert!(text.contains(&name), "{text}");
                assert_eq!(error.exit_code(), 2);
            }
        }
    }

    #[test]
    fn floating_point_options_take_negative_numbers() {
        for (path, name) in floats(&command(), &["gripcast".to_owned()]) {
            for value in ["-.006", "-1", "-1e-3", "-2.5E2"] {
                let option = [format!("--{name}"), value.to_owned()];
                let arguments = path.iter().cloned().chain(option);
                let Err(error) = command().try_get_matches_from(arguments) else {
                    continue;
                };
                // Out of range is fine, and so are other options that are missing.
                let text = error.to_string();
                assert_ne!(
                    error.kind(),
                    clap::error::ErrorKind::UnknownArgument,
                    "{path:?} --{name} {value}: {text}"
                );
                assert!(
                    !text.contains("a value is required for"),
                    "{path:?}: {text}"
                );
            }
        }
        let lists = [
            "sim",
            "press",
            "--indenter",
            "plate",
            "--shift-m",
            "-1e-4,-.0002",
        ];
        let press = command().try_get_matches_from([&["gripcast"][..], &lists].concat());
        assert!(press.is_ok(), "{press:?}");
    }

    #[test]
    fn object_option_refuses_what_is_no_name() {
        for bad in ["", " ", "mug\nblue", "a/b", "\u{200b}", "a\u{202e}b"] {
            let arguments = ["gripcast", "collect", "--object", bad];
            let error = command().try_get_matches_from(arguments).unwrap_err();
            assert!(error.to_string().contains("--object"), "{bad:?}: {error}");
        }
    }
}
