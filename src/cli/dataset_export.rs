//! `gripcast dataset export`: a dataset in a format of others.
//!
//! ```text
//! gripcast dataset export D --to parquet --out D-parquet
//! gripcast dataset export D --to webdataset --out D-tar --split object-0
//! gripcast dataset export D --to lerobot --out D-lerobot
//! gripcast dataset export D --to zarr --out D.zarr.zip --size 320x240
//! gripcast dataset export D --to training --out D-training --split object-0
//! ```
//!
//! `train` and `eval` read the last. `docs/exports.md` says what each holds and how it is loaded. The export has its name when it is
//! whole. A damaged grasp is left out and told.
//!
//! Exit codes: 0 all is exported · 1 could not be done · 2 the command line is wrong · 3 finished, but
//! some grasps were left out · 130 interrupted.

use std::fmt::Write as _;
use std::path::PathBuf;

use clap::ValueEnum;

use super::dataset_text::{counted, outcomes_text, size_text};
use super::render_visual::size;
use super::working::interruptible;
use super::{Context, print_report};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_dataset::Dataset;
use gripcast_interop::export::{ExportFormat, ExportPlan, ExportReport, export};

/// Arguments.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Directory of the dataset
    dataset: PathBuf,
    /// Format
    #[arg(long, value_enum, value_name = "FORMAT")]
    to: Format,
    /// New folder for the export; with zarr also a file that ends in .zip
    #[arg(long, value_name = "PATH")]
    out: PathBuf,
    /// Keep the parts of this split apart; leave out what is in none
    #[arg(long, value_name = "NAME")]
    split: Option<String>,
    /// Only this part, of --split or of the only split there is
    #[arg(long)]
    part: Option<String>,
    /// Leave out grasps without a label; lerobot and training always do
    #[arg(long)]
    only_labelled: bool,
    /// Size of the images in zarr, pixels [default: 320x240]
    #[arg(long, value_name = "WxH", value_parser = size)]
    size: Option<[usize; 2]>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    /// Shards with embedded images, for Hugging Face datasets and pandas
    Parquet,
    /// Tar shards, for webdataset
    #[value(name = "webdataset")]
    WebDataset,
    /// LeRobot version 3: a grasp is an episode of two frames
    #[value(name = "lerobot")]
    LeRobot,
    /// Zarr version 2 in the layout of UMI's replay buffer
    Zarr,
    /// Shards of the labelled grasps for `train` and `eval`
    Training,
}

impl From<Format> for ExportFormat {
    fn from(format: Format) -> Self {
        match format {
            Format::Parquet => Self::Parquet,
            Format::WebDataset => Self::WebDataset,
            Format::LeRobot => Self::LeRobot,
            Format::Zarr => Self::Zarr,
            Format::Training => Self::Training,
        }
    }
}

/// Runs the verb.
pub(super) fn run(context: &Context, args: Args) -> Result<()> {
    let plan = plan(&args)?;
    let Args {
        dataset, out, json, ..
    } = args;
    let place = out.clone();
    let report = interruptible(context, "exporting", move |progress| {
        export(&Dataset::open(&dataset)?, &out, &plan, &|done, all| {
            progress.at(done as u64, all as u64);
        })
    })??;
    print_report(json, &report, text)?;
    if report.left_out.is_empty() {
        return Ok(());
    }
    let what = format!("{} left out", counted(report.left_out.len(), "grasp"));
    Err(Error::new(ErrorKind::Partial, what)
        .at(place.display())
        .remedy("`gripcast dataset verify` says what is wrong with damaged grasps"))
}

fn plan(args: &Args) -> Result<ExportPlan> {
    let mut plan = ExportPlan::new(args.to.into());
    plan.split_file.clone_from(&args.split);
    plan.only_split.clone_from(&args.part);
    plan.only_labelled = args.only_labelled;
    if let Some([width, height]) = args.size {
        if args.to != Format::Zarr {
            let what = match args.to {
                Format::Training => "`--size` is for zarr; models know one size".to_owned(),
                _ => format!("`--size` is for zarr; {} keeps the images", plan.format),
            };
            return Err(Error::usage(what).remedy("leave `--size` out"));
        }
        plan.size = (width as u32, height as u32);
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
        (report.not_in_split, "in no part of the split"),
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
