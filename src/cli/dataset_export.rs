//! `gripcast dataset export`: exports a dataset to another format.
//!
//! ```text
//! gripcast dataset export D --to parquet --out D-parquet
//! gripcast dataset export D --to webdataset --out D-tar --split object-0
//! gripcast dataset export D --to lerobot --out D-lerobot
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

use super::dataset_text::{counted, outcomes_text, size_text};
use super::flags::{named, size};
use super::working::interruptible;
use super::{Context, print_report};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_dataset::Dataset;
use gripcast_interop::export::{ExportFormat, ExportPlan, ExportReport, export};

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
        ("lerobot", "LeRobot version 3: a grasp is an episode of two frames",
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
    /// Image size in zarr, px [default: 320x240]
    #[arg(long, value_name = "WxH", value_parser = |text: &str| size(text, 1..=8192))]
    size: Option<[u32; 2]>,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub(super) fn run(context: &Context, args: Args) -> Result<()> {
    let plan = plan(&args)?;
    let Args {
        dataset, out, json, ..
    } = args;
    let folder = out.clone();
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
        .remedy("`gripcast dataset verify` reports the damage"))
}

fn plan(args: &Args) -> Result<ExportPlan> {
    let mut plan = ExportPlan::new(args.to);
    plan.split_file.clone_from(&args.split);
    plan.only_split.clone_from(&args.subset);
    plan.only_labelled = args.only_labelled;
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
