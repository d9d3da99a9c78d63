//! Verifies a dataset.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;

use super::descriptor::Descriptor;
use super::digest::digest;
use super::disk::is_partial;
use super::grasp::{GraspRecord, Outcome};
use super::index::{IndexRow, to_jsonl};
use super::layout::{GRASP_JSON, INITIAL_JSON, Layout, pending_id};
use super::lift::is_lift_file;
use super::lock::DatasetLock;
use super::problem::{Problem, ProblemKind, VerifyReport, by_kind};
use super::reader::{copied_from, entries, grasp_ids};
use super::record_file::{Pending, names_to_normalise, read_grasp};
use super::split::{SplitFile, check_name};
use super::stored_file::StoredFile;
use gripcast_base::error::{ErrorKind, Result};
use gripcast_base::files::{
    BeneathPath, ContentKey, FileKind, GraspId, conflict_copy_of, folded_name, glob_character,
};

/// Verifies a dataset; reads all its files. `on_progress` gets the grasps done and their total.
///
/// # Errors
/// `NotFound` or `Input` when there is no dataset or it is of a newer version. Problems of the
/// dataset are in the report.
pub fn verify(
    path: impl AsRef<Path>,
    on_progress: &(dyn Fn(usize, usize) + Sync),
) -> Result<VerifyReport> {
    let layout = Layout::new(path.as_ref());
    let mut found = Collector::default();
    if let Err(error) = Descriptor::read(&layout) {
        if error.kind() != ErrorKind::NotFound || !layout.grasps().is_dir() {
            return Err(error);
        }
        found.add(
            ProblemKind::Descriptor,
            None,
            "dataset.toml",
            "the file is missing",
        );
    }
    if let Some(character) = glob_character(layout.root()) {
        found.notes.push(format!(
            "the path has a `{character}`: Hugging Face `datasets` and others take it for a pattern and \
             find no files; rename the folder for them"
        ));
    }
    if let Some(holder) = DatasetLock::holder(&layout) {
        found.notes.push(format!(
            "{holder} is writing the dataset: a save in progress may look torn"
        ));
    }
    check_root(&layout, &mut found)?;
    let pending = check_grasps_directory(&layout, &mut found)?;
    let ids = grasp_ids(&layout)?;
    let done = AtomicUsize::new(0);
    let mut grasps: Vec<CheckedGrasp> = ids
        .par_iter()
        .map(|id| {
            let checked = check_grasp(&layout, id);
            on_progress(done.fetch_add(1, Ordering::Relaxed) + 1, ids.len());
            checked
        })
        .collect();
    check_identity(&grasps, &mut found);
    // A copy is one problem, and no grasp.
    grasps.retain(|grasp| {
        grasp
            .record
            .as_ref()
            .is_none_or(|record| record.id == grasp.id)
    });
    note_confusable_objects(&grasps, &mut found);
    check_duplicates(&grasps, &mut found);
    check_references(&layout, &grasps, &mut found)?;
    check_index(&layout, &grasps, &mut found);
    check_splits(&layout, &grasps, &mut found)?;
    let unlabelled = grasps
        .iter()
        .filter_map(|grasp| grasp.record.as_ref())
        .filter(|record| record.outcome == Outcome::Unlabelled)
        .count();
    for grasp in &grasps {
        found.problems.extend(grasp.problems.iter().cloned());
    }
    found.problems.sort();
    Ok(VerifyReport {
        grasps: grasps.len(),
        unlabelled,
        pending,
        notes: found.notes,
        by_kind: by_kind(&found.problems),
        problems: found.problems,
    })
}

#[derive(Default)]
struct Collector {
    problems: Vec<Problem>,
    notes: Vec<String>,
}

impl Collector {
    fn add(
        &mut self,
        kind: ProblemKind,
        grasp: Option<&GraspId>,
        file: &str,
        detail: impl Into<String>,
    ) {
        self.add_with_remedy(kind, grasp, file, detail, kind.remedy());
    }

    fn add_with_remedy(
        &mut self,
        kind: ProblemKind,
        grasp: Option<&GraspId>,
        file: &str,
        detail: impl Into<String>,
        remedy: &str,
    ) {
        self.problems.push(Problem {
            kind,
            grasp: grasp.cloned(),
            file: Some(file.to_owned()),
            detail: detail.into(),
            remedy: remedy.to_owned(),
        });
    }
}

/// A grasp's directory, read and checked by itself.
struct CheckedGrasp {
    /// Name of the directory.
    id: GraspId,
    record: Option<GraspRecord>,
    problems: Vec<Problem>,
    /// sha256 and path of each existing file.
    contents: Vec<(String, String)>,
}

fn check_grasp(layout: &Layout, id: &GraspId) -> CheckedGrasp {
    let dir = layout.grasp(id);
    let mut found = Collector::default();
    let mut contents = Vec::new();
    let at = |name: &str| format!("grasps/{id}/{name}");
    let record = match read_grasp(&dir) {
        Ok(record) => Some(record),
        Err(error) => {
            let kind = match error.kind() {
                ErrorKind::NotFound => ProblemKind::MissingFile,
                _ => ProblemKind::UnreadableRecord,
            };
            let remedy = error.remedy_text().unwrap_or_else(|| kind.remedy());
            let text = error.to_string();
            let detail = text.split("\n  → ").next().unwrap_or_default();
            found.add_with_remedy(kind, Some(id), &at(GRASP_JSON), detail, remedy);
            None
        }
    };
    if let Some(record) = &record {
        let stored = record.stored_files();
        for name in stored
            .keys()
            .filter(|name| !record.files.contains_key(**name))
        {
            found.add(
                ProblemKind::UnreadableRecord,
                Some(id),
                &at(name),
                "the record lacks a digest of the file",
            );
        }
        for (name, expected) in &record.files {
            let bytes = match dir.join(name).read(FileKind::Image) {
                Ok(bytes) => bytes,
                Err(error) => {
                    found.add(
                        ProblemKind::MissingFile,
                        Some(id),
                        &at(name),
                        format!("cannot read the file: {error}"),
                    );
                    continue;
                }
            };
            let digest = digest(&bytes);
            let file = stored.get(name.as_str()).copied();
            if digest != *expected {
                found.add(
                    ProblemKind::Altered,
                    Some(id),
                    &at(name),
                    format!(
                        "expected {} bytes with sha256 {}, found {} bytes with {}",
                        expected.bytes, expected.sha256, digest.bytes, digest.sha256
                    ),
                );
            } else if let Some((kind, defect)) = file.and_then(|file| defect(file, &bytes)) {
                found.add(
                    kind,
                    Some(id),
                    &at(name),
                    format!("{defect}; it was damaged before storing"),
                );
            }
            // Fields may be alike; images of a running camera never are.
            if !matches!(file, Some(StoredFile::Field(_))) {
                contents.push((digest.sha256, at(name)));
            }
        }
        for (field, stored, normal) in names_to_normalise(&dir, record) {
            let detail = format!("{field} {stored:?} is not in normal form: {normal:?}");
            found.add(ProblemKind::Name, Some(id), &at(GRASP_JSON), detail);
        }
        extra_files(&dir, id, record, &mut found);
    }
    CheckedGrasp {
        id: id.clone(),
        record,
        problems: found.problems,
        contents,
    }
}

/// The problem of a file whose contents are those that were stored.
fn defect(file: StoredFile<'_>, bytes: &[u8]) -> Option<(ProblemKind, String)> {
    let kind = match file {
        StoredFile::Image(_) | StoredFile::Lift(_) => ProblemKind::DamagedImage,
        StoredFile::Field(_) => ProblemKind::DamagedField,
    };
    Some((kind, file.defect(bytes)?))
}

/// Remedy for [`copy_text`].
const COPY_REMEDY: &str = "compare it with the original, then move it out of the dataset";

fn copy_text(original: &str) -> String {
    format!(
        "a copy of {original}, made by a file manager or by a program that synchronises folders"
    )
}

fn extra_files(dir: &BeneathPath, id: &GraspId, record: &GraspRecord, found: &mut Collector) {
    for entry in entries(dir).into_iter().flatten() {
        let name = entry.name();
        let at = format!("grasps/{id}/{name}");
        // After a crash, the next opening removes the initial frame's record.
        if name == GRASP_JSON || name == INITIAL_JSON || record.files.contains_key(name.as_str()) {
            continue;
        }
        if is_partial(&name) {
            let detail = "interrupted change of the record";
            found.add(ProblemKind::Torn, Some(id), &at, detail);
        } else if record.lift.is_none() && is_lift_file(&name) {
            let detail = "interrupted save of the lift frames";
            found.add(ProblemKind::Torn, Some(id), &at, detail);
        } else if let Some(original) = conflict_copy_of(&name) {
            let (kind, detail) = (ProblemKind::ExtraFile, copy_text(&original));
            found.add_with_remedy(kind, Some(id), &at, detail, COPY_REMEDY);
        } else {
            let detail = "not listed in any record";
            found.add(ProblemKind::ExtraFile, Some(id), &at, detail);
        }
    }
}

fn check_root(layout: &Layout, found: &mut Collector) -> Result<()> {
    for entry in entries(&layout.top())? {
        let name = entry.name();
        if is_partial(&name) {
            found.notes.push(format!(
                "{name} is a leftover of an interrupted save and will be replaced"
            ));
        }
    }
    Ok(())
}

/// Checks entries that are not complete grasps; returns the number of pending initial frames.
fn check_grasps_directory(layout: &Layout, found: &mut Collector) -> Result<usize> {
    let mut pending = 0;
    let entries = entries(&layout.grasps())?;
    let names: Vec<String> = entries.iter().map(BeneathPath::name).collect();
    for entry in entries {
        let name = entry.name();
        let at = format!("grasps/{name}");
        let is_dir = entry.is_dir();
        if is_dir && !name.starts_with('.') {
            if let Some(original) = copied_from(&name, &names) {
                let (kind, detail) = (ProblemKind::DuplicateId, copy_text(&original));
                found.add_with_remedy(kind, None, &at, detail, COPY_REMEDY);
            } else if let Err(error) = GraspId::parse(&name) {
                let detail = format!("invalid directory name: {}", error.what());
                found.add(ProblemKind::IdMismatch, None, &at, detail);
            }
            continue;
        }
        let Some(id) = pending_id(&name).filter(|_| is_dir) else {
            let detail = "not a grasp directory";
            found.add(ProblemKind::ExtraFile, None, &at, detail);
            continue;
        };
        let detail = match Pending::inspect(&entry, &id) {
            Pending::Initial(initial) => match &initial.reopened_from {
                Some(grasp) if layout.grasp(grasp).is_taken() => {
                    format!("the undo of {grasp} was interrupted")
                }
                _ => {
                    pending += 1;
                    found.notes.push(format!("pending initial frame: {id}"));
                    continue;
                }
            },
            Pending::Grasp => "the grasp is complete, but was not renamed".to_owned(),
            Pending::Torn(reason) => format!("incomplete save: {reason}"),
        };
        found.add(ProblemKind::Torn, Some(&id), &at, detail);
    }
    Ok(pending)
}

fn check_identity(grasps: &[CheckedGrasp], found: &mut Collector) {
    let names: BTreeSet<&GraspId> = grasps.iter().map(|grasp| &grasp.id).collect();
    let mut owners: BTreeMap<&GraspId, Vec<&GraspId>> = BTreeMap::new();
    for grasp in grasps {
        if let Some(record) = &grasp.record {
            owners.entry(&record.id).or_default().push(&grasp.id);
        }
    }
    for (id, dirs) in owners {
        for dir in dirs.iter().copied().filter(|dir| *dir != id) {
            let at = format!("grasps/{dir}/{GRASP_JSON}");
            let (kind, more) = if dirs.len() > 1 || names.contains(id) {
                (ProblemKind::DuplicateId, ", which exists as well")
            } else {
                (ProblemKind::IdMismatch, "")
            };
            let detail = format!("the record belongs to {id}{more}");
            found.add(kind, Some(dir), &at, detail);
        }
    }
}

/// Notes objects whose names differ only in case or in characters that look alike.
fn note_confusable_objects(grasps: &[CheckedGrasp], found: &mut Collector) {
    let mut names: BTreeMap<String, BTreeSet<&str>> = BTreeMap::new();
    for record in grasps.iter().filter_map(|grasp| grasp.record.as_ref()) {
        let folded = folded_name(&record.object);
        names.entry(folded).or_default().insert(&record.object);
    }
    for alike in names.values().filter(|names| names.len() > 1) {
        let alike: Vec<String> = alike.iter().map(|name| format!("`{name}`")).collect();
        found.notes.push(format!(
            "objects {} are easily confused; if they are one, run `gripcast dataset edit DIR \
             --all-of NAME --object NAME`",
            alike.join(" and ")
        ));
    }
}

fn check_duplicates(grasps: &[CheckedGrasp], found: &mut Collector) {
    let mut files_of: BTreeMap<&str, Vec<(&GraspId, &str)>> = BTreeMap::new();
    for grasp in grasps {
        for (sha256, file) in &grasp.contents {
            files_of
                .entry(sha256)
                .or_default()
                .push((&grasp.id, file.as_str()));
        }
    }
    for files in files_of.values().filter(|files| files.len() > 1) {
        let (_, first) = files[0];
        for (id, file) in &files[1..] {
            found.add(
                ProblemKind::DuplicateContent,
                Some(id),
                file,
                format!("identical to {first}: a frozen camera or a copied grasp"),
            );
        }
    }
}

fn check_references(layout: &Layout, grasps: &[CheckedGrasp], found: &mut Collector) -> Result<()> {
    let mut calibrations = BTreeSet::new();
    for (name, at) in immutable_files(
        &layout.calibration(),
        ".toml",
        found,
        ProblemKind::Calibration,
    )? {
        let used = grasps.iter().any(|grasp| {
            grasp
                .record
                .as_ref()
                .is_some_and(|record| record.calibration_keys().any(|key| **key == *name))
        });
        if !used {
            found.notes.push(format!("no grasp refers to {at}"));
        }
        calibrations.extend(ContentKey::parse(&name));
    }
    for grasp in grasps {
        let keys: BTreeSet<&ContentKey> = grasp
            .record
            .iter()
            .flat_map(|record| record.calibration_keys())
            .collect();
        for key in keys {
            if !calibrations.contains(key) {
                found.add(
                    ProblemKind::Calibration,
                    Some(&grasp.id),
                    &format!("calibration/{key}.toml"),
                    "the grasp refers to a missing calibration",
                );
            }
        }
    }
    immutable_files(&layout.models(), ".json", found, ProblemKind::Model)?;
    Ok(())
}

/// Keys and paths of the content-addressed files in a directory.
fn immutable_files(
    dir: &BeneathPath,
    extension: &str,
    found: &mut Collector,
    kind: ProblemKind,
) -> Result<Vec<(String, String)>> {
    if !dir.is_dir() {
        return Ok(Vec::new());
    }
    let folder = dir.name();
    let mut files = Vec::new();
    for entry in entries(dir)? {
        let name = entry.name();
        let at = format!("{folder}/{name}");
        if is_partial(&name) {
            found
                .notes
                .push(format!("{at} is a leftover of an interrupted save"));
            continue;
        }
        let Some(key) = name.strip_suffix(extension) else {
            found.add_with_remedy(
                ProblemKind::ExtraFile,
                None,
                &at,
                format!("expected only *{extension} files"),
                "move it elsewhere",
            );
            continue;
        };
        match entry.read(FileKind::Record) {
            Ok(bytes) if ContentKey::from_contents(&bytes) == key => {}
            Ok(_) => found.add(kind, None, &at, "the contents do not match the name"),
            Err(error) => found.add(kind, None, &at, format!("cannot read the file: {error}")),
        }
        files.push((key.to_owned(), at));
    }
    Ok(files)
}

fn check_index(layout: &Layout, grasps: &[CheckedGrasp], found: &mut Collector) {
    let rows = grasps
        .iter()
        .filter_map(|grasp| Some((grasp.id.clone(), IndexRow::new(grasp.record.as_ref()?))))
        .collect();
    let detail = match layout.index().read(FileKind::List) {
        Err(_) => "cannot read the index",
        Ok(bytes) if bytes == to_jsonl(&rows).as_bytes() => return,
        Ok(bytes) if !bytes.is_empty() && bytes.last() != Some(&b'\n') => "the index is truncated",
        Ok(_) => "the index differs from the records",
    };
    found.add(ProblemKind::Index, None, "metadata.jsonl", detail);
}

fn check_splits(layout: &Layout, grasps: &[CheckedGrasp], found: &mut Collector) -> Result<()> {
    if !layout.splits().is_dir() {
        return Ok(());
    }
    let records: BTreeMap<&GraspId, &GraspRecord> = grasps
        .iter()
        .filter_map(|grasp| Some((&grasp.id, grasp.record.as_ref()?)))
        .collect();
    for entry in entries(&layout.splits())? {
        let name = entry.name();
        if is_partial(&name) {
            continue;
        }
        let at = format!("splits/{name}");
        if let Err(error) = check_name(name.trim_end_matches(".json")) {
            found.add_with_remedy(
                ProblemKind::Split,
                None,
                &at,
                error.to_string(),
                "rename the file",
            );
        }
        let split = match SplitFile::read_beneath(&entry) {
            Ok(split) => split,
            Err(error) => {
                found.add(ProblemKind::Split, None, &at, error.to_string());
                continue;
            }
        };
        for id in split.grasps().filter(|id| !records.contains_key(id)) {
            found.add(
                ProblemKind::Split,
                Some(id),
                &at,
                "the split lists a missing grasp",
            );
        }
        for leak in split.leaks(|id| records.get(id).copied()) {
            found.add(ProblemKind::Leak, None, &at, leak);
        }
    }
    Ok(())
}
