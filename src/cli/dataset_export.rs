//! `gripcast dataset export`: exports a dataset to another format.
//!
//! ```text
//! gripcast dataset export D --to parquet --out D-parquet
//! gripcast dataset export D --to webdataset --out D-tar --split object-0
//! gripcast dataset export D --to lerobot --out D-lerobot
//! gripcast dataset export D --to lerobot --sequences --lift 3 --out D-lerobot-sequences
//! gripcast dataset export D --to zarr --out D.zarr.zip --size 320x240
//! gripcast dataset export D --to training --out D-training --split object-0
//! ```
//!
//! `training` is the format of `train` and `eval`. Contents and loading:
//! `docs/reference/exports.md`. The export gets its name once it is complete. Damaged grasps are
//! reported and left out.
//!
//! Exit codes: 0 all exported · 1 failed · 2 usage · 3 done, but some grasps were left out · 130
//! interrupted.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::time::Duration;

use super::dataset_text::{counted, outcomes_text, size_text};
use super::flags::{named, number, size};
use super::working::interruptible;
use super::{Context, print_report};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::number::NumberRange;
use gripcast_dataset::Dataset;
use gripcast_interop::export::{ExportFormat, ExportPlan, ExportReport, SequencePlan, export};

/// Arguments.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Folder of the dataset
    dataset: PathBuf,
    /// Export format
    #[arg(long, value_name = "FORMAT", value_parser = named([
        ("parquet", "Shards with embedded images, for Hugging Face datasets and pandas",
            ExportFormat::Parquet),
        ("webdataset", "Tar shards, for webdataset", ExportFormat::WebDataset),
        ("lerobot", "LeRobot version 3: a grasp is an episode of two frames, or a sequence",
            ExportFormat::LeRobot),
        ("zarr", "Zarr version 2 in the layout of UMI's replay buffer", ExportFormat::Zarr),
        ("training", "Shards of the labelled grasps for `train` and `eval`",
            ExportFormat::Training),
    ]))]
    to: ExportFormat,
    /// Output directory, which must not exist; for zarr also a file that ends in .zip
    #[arg(long, value_name = "PATH")]
    out: PathBuf,
    /// Export the subsets of this split separately; leave out grasps in none
    #[arg(long, value_name = "NAME")]
    split: Option<String>,
    /// Export only this subset (train, val, test) of --split, or of the only split of the dataset
    #[arg(long, value_name = "NAME")]
    subset: Option<String>,
    /// Leave out unlabelled grasps; lerobot and training always do
    #[arg(long)]
    only_labelled: bool,
    /// Export the sequence of each grasp, approach to lift, from the black box (lerobot)
    #[arg(long)]
    sequences: bool,
    /// Directory of the black box [default: blackbox in the dataset]
    #[arg(long, value_name = "DIR", requires = "sequences")]
    black_box: Option<PathBuf>,
    /// Frames per second of sequences [default: the rate of the slowest camera]
    #[arg(long, value_name = "N", requires = "sequences",
        value_parser = clap::value_parser!(u32).range(1..=240))]
    fps: Option<u32>,
    /// Begin sequences at most this long before the grasp, s [default: at the initial trigger]
    #[arg(long, value_name = "SECONDS", requires = "sequences", value_parser = part_of_sequence)]
    approach: Option<f64>,
    /// End sequences this long after the grasp, or at the label, s [default: 3]
    #[arg(long, value_name = "SECONDS", requires = "sequences", value_parser = part_of_sequence)]
    lift: Option<f64>,
    /// Image size in zarr, px [default: 320x240]
    #[arg(long, value_name = "WxH", value_parser = |text: &str| size(text, 1..=8192))]
    size: Option<[u32; 2]>,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// Parses the time of a part of a sequence, s.
fn part_of_sequence(text: &str) -> Result<f64, String> {
    number(NumberRange::between(0.0, 3600.0).unit("s"))(text)
}

/// Runs the command.
pub(super) fn run(context: &Context, args: Args) -> Result<()> {
    let plan = plan(&args)?;
    let Args {
        dataset, out, json, ..
    } = args;
    let folder = out.clone();
    let remedy = match plan.sequences {
        Some(_) => "the report above has the reasons",
        None => "`gripcast dataset verify` reports the damage",
    };
    let report = interruptible(context, "exporting", move |progress| {
        export(&Dataset::open(&dataset)?, &out, &plan, &|done, all| {
            progress.count(done, all);
        })
    })??;
    print_report(json, &report, text)?;
    if report.left_out.is_empty() {
        return Ok(());
    }
    let what = format!("{} left out", counted(report.left_out.len(), "grasp"));
    Err(Error::new(ErrorKind::Partial, what)
        .at(folder.display())
        .remedy(remedy))
}

fn plan(args: &Args) -> Result<ExportPlan> {
    let mut plan = ExportPlan::new(args.to);
    plan.split_file.clone_from(&args.split);
    plan.only_split.clone_from(&args.subset);
    plan.only_labelled = args.only_labelled;
    if args.sequences {
        let default = SequencePlan::default();
        plan.sequences = Some(SequencePlan {
            black_box: args.black_box.clone(),
            fps: args.fps,
            approach: args.approach.map(Duration::from_secs_f64),
            lift: args.lift.map_or(default.lift, Duration::from_secs_f64),
        });
    }
    if let Some([width, height]) = args.size {
        if args.to != ExportFormat::Zarr {
            let what = match args.to {
                ExportFormat::Training => "`--size` is for zarr; models have a fixed size".into(),
                _ => format!("`--size` is for zarr; {} keeps the images", plan.format),
            };
            return Err(Error::usage(what).remedy("omit `--size`"));
        }
        plan.size = (width, height);
    }
    Ok(plan)
}

fn text(report: &ExportReport) -> String {
    let mut text = String::new();
    let _ = writeln!(
        text,
        "{}  {}: {}, {} in {}",
        report.format,
        counted(report.grasps, "grasp"),
        outcomes_text(&report.outcomes),
        size_text(report.bytes),
        counted(report.files, "file")
    );
    if report.splits.len() > 1 {
        for (name, grasps) in &report.splits {
            let _ = writeln!(text, "{name:<12} {}", counted(*grasps, "grasp"));
        }
    }
    for (count, why) in [
        (report.unlabelled, "not labelled"),
        (report.not_in_split, "not in the split"),
    ] {
        if count > 0 {
            let _ = writeln!(text, "left out     {}: {why}", counted(count, "grasp"));
        }
    }
    for note in &report.notes {
        let _ = writeln!(text, "note         {note}");
    }
    for one in &report.left_out {
        let _ = writeln!(text, "left out     {}: {}", one.id, one.reason);
    }
    text
}
