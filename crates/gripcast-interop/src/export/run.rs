//! Runs an export.

use std::fs;
use std::path::Path;

use super::format::{ExportContext, Writer};
use super::lerobot::LeRobot;
use super::parquet::ParquetShards;
use super::plan::{ExportFormat, ExportPlan};
use super::report::ExportReport;
use super::selection::{Selection, select};
use super::source::Source;
use super::staged::StagedFolder;
use super::training::TrainingShards;
use super::webdataset::TarShards;
use super::zarr::{self, ReplayBuffer};
use crate::left_out::LeftOut;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::glob_character;
use gripcast_dataset::Dataset;

/// Exports a dataset to `out` atomically.
///
/// `on_progress` gets the number of finished grasps and their total. Damaged grasps are left out
/// and listed in the report. Equal datasets and plans give equal bytes.
///
/// # Errors
/// `Usage`: an invalid split or size; an `out` inside the dataset. `Input`: nothing to export, or
/// `out` exists. `Busy`: `out` is being written. `Permission`, `DiskFull`, `Io`, …: `out` cannot be
/// written; nothing is left there.
pub fn export(
    dataset: &Dataset,
    out: &Path,
    plan: &ExportPlan,
    on_progress: &dyn Fn(usize, usize),
) -> Result<ExportReport> {
    check_outside(dataset.path(), out)?;
    if plan.sequences.is_some() && plan.format != ExportFormat::LeRobot {
        let what = format!("{} has no sequences", plan.format);
        return Err(Error::usage(what).remedy("export to lerobot"));
    }
    let selection = select(dataset, plan).map_err(|e| e.at(dataset.path().display()))?;
    let folder = StagedFolder::create(out)?;
    write(dataset, &folder, plan, selection, on_progress)
        .and_then(|mut report| {
            (report.files, report.bytes) = folder.size()?;
            report.out = out.to_owned();
            report.notes.extend(glob_note(out));
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
    selection: Selection,
    on_progress: &dyn Fn(usize, usize),
) -> Result<ExportReport> {
    let context = ExportContext {
        folder,
        plan,
        survey: &selection.survey,
        dataset: dataset.path(),
        descriptor: dataset.descriptor(),
        splits: &selection.splits,
    };
    let mut writer: Box<dyn Writer + '_> = match plan.format {
        ExportFormat::Parquet => Box::new(ParquetShards::new(context)),
        ExportFormat::WebDataset => Box::new(TarShards::new(context)?),
        ExportFormat::LeRobot => Box::new(LeRobot::new(context)?),
        ExportFormat::Zarr => Box::new(ReplayBuffer::new(context)?),
        ExportFormat::Training => Box::new(TrainingShards::new(context)?),
    };
    let mut report = ExportReport::new(plan.format, &selection);
    let mut source = Source::new(dataset, plan.format.carries_lifts())?;
    let all = selection.grasps();
    let (mut done, mut is_damaged) = (0, !selection.left_out.is_empty());
    for (split, ids) in &selection.splits {
        writer.begin_split(split)?;
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
                    *report.splits.entry(split.clone()).or_default() += 1;
                    *report.outcomes.entry(outcome).or_default() += 1;
                }
                Err(error) => report.left_out.push(LeftOut {
                    id: id.to_string(),
                    reason: error.to_string(),
                }),
            }
            done += 1;
            on_progress(done, all);
        }
    }
    if let (0, Some(first)) = (report.grasps, report.left_out.first()) {
        let reason = &first.reason;
        let what = format!("cannot export any of the {all} grasps, the first because of {reason}");
        return Err(Error::input(what).remedy(match (is_damaged, &plan.sequences) {
            (true, _) => "run `gripcast dataset verify` and `recover`",
            (false, Some(_)) => "name the directory of their log with `--black-box`",
            (false, None) => "the format requires more data than these grasps have, see docs/reference/exports.md",
        }));
    }
    report.notes.extend(writer.finish()?);
    report.notes.extend(not_carried(plan.format, &selection));
    report.left_out.sort_by(|a, b| a.id.cmp(&b.id));
    Ok(report)
}

impl ExportReport {
    fn new(format: ExportFormat, selection: &Selection) -> Self {
        Self {
            format: format.name().to_owned(),
            out: std::path::PathBuf::new(),
            grasps: 0,
            splits: Default::default(),
            outcomes: Default::default(),
            files: 0,
            bytes: 0,
            unlabelled: selection.unlabelled,
            not_in_split: selection.not_in_split,
            notes: Vec::new(),
            left_out: selection.left_out.clone(),
        }
    }
}

/// Notes on what the format as a whole does not have.
fn not_carried(format: ExportFormat, selection: &Selection) -> Vec<String> {
    let survey = &selection.survey;
    let mut notes = Vec::new();
    if !format.carries_lifts() {
        let note = |(role, lift): (_, &super::fields::LiftCounts)| {
            format!("lift frames of {role} left out: {} grasps", lift.grasps)
        };
        notes.extend(survey.lifts.iter().map(note));
    }
    if format == ExportFormat::Training {
        let note =
            |(role, name): &super::fields::FieldKey| format!("field {name} of {role} left out");
        notes.extend(survey.fields.iter().map(|(key, _)| note(key)));
    }
    notes
}

/// A note on a path in which Python libraries do not find the export.
fn glob_note(out: &Path) -> Option<String> {
    let absolute = std::path::absolute(out).unwrap_or_else(|_| out.to_owned());
    let character = glob_character(&absolute)?;
    Some(format!(
        "the path has a `{character}`: Hugging Face `datasets` and others take it for a pattern and find \
         no files; rename the folder for them"
    ))
}

/// Refuses an export inside the dataset.
fn check_outside(dataset: &Path, out: &Path) -> Result<()> {
    let Ok(root) = fs::canonicalize(dataset) else {
        return Ok(());
    };
    let absolute = std::path::absolute(out).unwrap_or_else(|_| out.to_owned());
    let real = absolute
        .ancestors()
        .find_map(|path| fs::canonicalize(path).ok());
    if real.is_some_and(|real| real.starts_with(&root)) {
        let what = "the export would be inside the dataset";
        return Err(Error::usage(what)
            .at(out.display())
            .remedy("choose an `--out` outside of it"));
    }
    Ok(())
}
