//! An export from its beginning to its name.

use std::fs;
use std::path::Path;

use super::choice::{Choice, choose};
use super::format::{Setting, Writer};
use super::lerobot::LeRobot;
use super::parquet::ParquetShards;
use super::plan::{ExportFormat, ExportPlan};
use super::report::ExportReport;
use super::source::Source;
use super::staged::StagedFolder;
use super::training::TrainingShards;
use super::webdataset::TarShards;
use super::zarr::{self, ReplayBuffer};
use crate::left_out::LeftOut;
use gripcast_base::error::{Error, Result};
use gripcast_dataset::Dataset;

/// Writes a dataset in another format to `out`, whole or not at all.
///
/// `told` gets the number of grasps that are done and that of all. A damaged grasp is left out and
/// named in the report. The same dataset and plan make the same bytes.
///
/// # Errors
/// `Usage`: a split, part or size that cannot be; an `out` inside the dataset. `Input`: there is
/// nothing to export, or something at `out` already. `Busy`: `out` is being written.
/// `Permission`, `DiskFull`, `Io`, …: `out` cannot be written; there is nothing then.
pub fn export(
    dataset: &Dataset,
    out: &Path,
    plan: &ExportPlan,
    on_progress: &dyn Fn(usize, usize),
) -> Result<ExportReport> {
    check_apart(dataset.path(), out)?;
    let choice = choose(dataset, plan).map_err(|e| e.at(dataset.path().display()))?;
    let folder = StagedFolder::create(out)?;
    write(dataset, &folder, plan, choice, on_progress)
        .and_then(|mut report| {
            (report.files, report.bytes) = folder.size()?;
            report.out = out.to_owned();
            Ok(report)
        })
        .and_then(|report| {
            let is_file = plan.format == ExportFormat::Zarr && zarr::is_zip(out);
            folder.commit(is_file.then_some(zarr::ZIP_NAME))?;
            Ok(report)
        })
        .map_err(|e| e.at(out.display()))
}

fn write(
    dataset: &Dataset,
    folder: &StagedFolder,
    plan: &ExportPlan,
    choice: Choice,
    on_progress: &dyn Fn(usize, usize),
) -> Result<ExportReport> {
    let setting = Setting {
        folder,
        plan,
        survey: &choice.survey,
        descriptor: dataset.descriptor(),
        parts: &choice.parts,
    };
    let mut writer: Box<dyn Writer + '_> = match plan.format {
        ExportFormat::Parquet => Box::new(ParquetShards::new(setting)),
        ExportFormat::WebDataset => Box::new(TarShards::new(setting)),
        ExportFormat::LeRobot => Box::new(LeRobot::new(setting)?),
        ExportFormat::Zarr => Box::new(ReplayBuffer::new(setting)?),
        ExportFormat::Training => Box::new(TrainingShards::new(setting)?),
    };
    let mut report = ExportReport::new(plan.format, &choice);
    let mut source = Source::new(dataset)?;
    let all = choice.grasps();
    let (mut done, mut is_damaged) = (0, !choice.left_out.is_empty());
    for (part, ids) in &choice.parts {
        writer.begin_part(part)?;
        for id in ids {
            let outcome = match source.read(id) {
                Ok(grasp) => {
                    let outcome = grasp.record.outcome;
                    writer.push(grasp)?.map_or(Ok(outcome), Err)
                }
                Err(error) => {
                    is_damaged = true;
                    Err(error)
                }
            };
            match outcome {
                Ok(outcome) => {
                    report.grasps += 1;
                    *report.parts.entry(part.clone()).or_default() += 1;
                    *report.outcomes.entry(outcome).or_default() += 1;
                }
                Err(error) => report.left_out.push(LeftOut {
                    id: id.to_string(),
                    why: error.to_string(),
                }),
            }
            done += 1;
            on_progress(done, all);
        }
    }
    if let (0, Some(first)) = (report.grasps, report.left_out.first()) {
        let what = format!("none of the {all} grasps can be exported, the first because of");
        let what = format!("{what} {}", first.why);
        return Err(Error::input(what).remedy(match is_damaged {
            true => "run `gripcast dataset verify` and `recover`",
            false => "the format needs more than these grasps have: docs/exports.md says what",
        }));
    }
    report.notes.extend(writer.finish()?);
    report.left_out.sort_by(|a, b| a.id.cmp(&b.id));
    Ok(report)
}

impl ExportReport {
    fn new(format: ExportFormat, choice: &Choice) -> Self {
        Self {
            format: format.name().to_owned(),
            out: std::path::PathBuf::new(),
            grasps: 0,
            parts: Default::default(),
            outcomes: Default::default(),
            files: 0,
            bytes: 0,
            unlabelled: choice.unlabelled,
            not_in_split: choice.not_in_split,
            notes: Vec::new(),
            left_out: choice.left_out.clone(),
        }
    }
}

/// An export inside the dataset would become a part of what it is made from.
fn check_apart(dataset: &Path, out: &Path) -> Result<()> {
    let Ok(root) = fs::canonicalize(dataset) else {
        return Ok(());
    };
    let near = std::path::absolute(out).unwrap_or_else(|_| out.to_owned());
    let real = near
        .ancestors()
        .find_map(|path| fs::canonicalize(path).ok());
    if real.is_some_and(|real| real.starts_with(&root)) {
        let what = "the export would lie inside the dataset";
        return Err(Error::usage(what)
            .at(out.display())
            .remedy("choose an `--out` beside it"));
    }
    Ok(())
}
