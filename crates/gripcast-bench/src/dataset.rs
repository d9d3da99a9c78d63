//! `gripcast-bench dataset`: the index of a large dataset and pages of it.
//!
//! The dataset is generated: records without images, an object for each fifty grasps.

use std::fs;
use std::path::Path;

use gripcast::cli::Context;
use gripcast::cli::bench::Report;
use gripcast_base::error::{Error, Result};
use gripcast_dataset::sample::{capture, meta, new_dataset};
use gripcast_dataset::{DatasetWriter, GraspId, GraspIndex, Outcome};
use serde_json::{Value, json};

use crate::timing::{Timing, timed};

/// Grasps per object.
const PER_OBJECT: usize = 50;
/// Grasps on a page, as on the operator's page.
const PAGE: usize = 24;

/// Arguments.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Number of grasps
    #[arg(long, value_name = "N", default_value_t = 10_000, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    grasps: u32,
    /// Number of measurements
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..))]
    runs: u32,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// Runs the benchmark.
pub(crate) fn run(_context: &Context, args: &Args) -> Result<()> {
    let folder = tempfile::tempdir()
        .map_err(|e| Error::io("cannot create a directory for the dataset", e))?;
    let oldest = generate(folder.path(), args.grasps as usize)?;
    let runs = args.runs as usize;
    let index = GraspIndex::new(folder.path());
    let fill = timed(1, || index.refresh());
    let page = |before: Option<&str>| timed(runs, || index.newest(before, PAGE, |_| true).len());
    let filtered = |outcome: Outcome, object: &str| {
        let matches =
            |row: &gripcast_dataset::IndexRow| row.outcome == outcome && row.object == object;
        timed(runs, || index.newest(None, PAGE, matches).len())
    };
    let figures = [
        ("fill", fill),
        ("refresh", timed(runs, || index.refresh())),
        ("first_page", page(None)),
        ("last_page", page(Some(&oldest))),
        (
            "filter_first_object",
            filtered(Outcome::Unlabelled, "thing-0"),
        ),
        ("filter_no_match", filtered(Outcome::Stable, "nothing")),
    ];
    let mut text = "index                    min ms   median ms".to_owned();
    for (name, Timing { min, median }) in figures {
        text += &format!("\n{name:<20}{min:>11.3}{median:>12.3}");
    }
    let figures: serde_json::Map<String, Value> = figures
        .into_iter()
        .map(|(name, timing)| (format!("{name}_ms"), json!(timing)))
        .collect();
    let params = json!({"grasps": args.grasps, "runs": args.runs});
    Report::new("dataset", params, Value::Object(figures), text).print(args.json)
}

/// Writes a dataset; returns the id of the 25th grasp, before which the last page begins.
fn generate(root: &Path, grasps: usize) -> Result<GraspId> {
    let (mut writer, _) = DatasetWriter::open_or_create(root, &new_dataset())?;
    let pending = writer.save_initial(&capture(1), Vec::new())?;
    let sample = writer.save_grasp(&pending, &capture(2), meta("thing"))?;
    writer.trash_grasp(&sample.id)?;
    drop(writer);
    let failed = |e: std::io::Error| Error::io("cannot write the dataset", e);
    let mut last_page = sample.id.clone();
    for number in 0..grasps {
        let mut record = sample.clone();
        let [day, second] = [number / 86_400 % 28 + 1, number % 86_400];
        let time = format!(
            "2026-01-{day:02}T{:02}-{:02}-{:02}Z-{number:06x}",
            second / 3600,
            second / 60 % 60,
            second % 60
        );
        record.id = GraspId::parse(&time)?;
        record.object = format!("thing-{}", number / PER_OBJECT).parse()?;
        let folder = root.join("grasps").join(record.id.as_str());
        fs::create_dir(&folder).map_err(failed)?;
        let json = serde_json::to_vec_pretty(&record)
            .map_err(|e| Error::internal("cannot write a record").because(e))?;
        fs::write(folder.join("grasp.json"), json).map_err(failed)?;
        if number == PAGE.min(grasps - 1) {
            last_page = record.id;
        }
    }
    Ok(last_page)
}
