//! Runs an import: first reads all labels, then the images of one grasp at a time.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use super::feeling_of_success::{CROP, GraspFile, GraspLabel, images};
use super::report::{ImportReport, ImportedSplit, SourceFile};
use crate::left_out::LeftOut;
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::{Label, Printable, Root};
use gripcast_dataset::shard::{
    ShardEngine, ShardFacts, ShardImages, ShardOutcome, ShardRow, ShardWriter, SplitFractions,
    SplitGroup, shard_path,
};
use gripcast_imaging::Decoder;

/// Name of the dataset on the command line.
const FROM: &str = "feeling-of-success";
/// Rows per shard, about 150 MB.
const ROWS_PER_SHARD: usize = 2000;
/// Directory of the shards.
const DATA: &str = "data";

/// Grasps of one file by name.
type Index = BTreeMap<String, GraspLabel>;

/// Imports files of the *Feeling of Success* as a dataset into `out`.
///
/// Objects are assigned to splits by [`SplitFractions::assign`]. Unreadable grasps are left out and
/// listed in the report. Memory use is limited to one grasp's images and a row group per split.
/// Equal files give equal bytes; the same call restarts an interrupted import.
///
/// # Errors
/// `Usage`: no file, two files with the same name. `Input`: a file of another format or without
/// readable grasps, an empty split, an `out` with other contents. Those of the operating system.
pub fn import_feeling_of_success(
    files: &[PathBuf],
    out: &Path,
    fractions: &SplitFractions,
    on_progress: &dyn Fn(usize, usize),
) -> Result<ImportReport> {
    let stems = stems(files)?;
    let mut report = ImportReport::new(FROM, sources(files)?, fractions);
    let mut indices = Vec::with_capacity(files.len());
    for (path, stem) in files.iter().zip(&stems) {
        indices.push(index(path, stem, &mut report.left_out)?);
    }
    let split_of = assign(&indices, fractions)?;
    let left_out = std::mem::take(&mut report.left_out);
    report.claim(out)?;
    report.left_out = left_out;
    let root = Root::new(out);
    let folder = root.top().join(DATA);
    folder
        .create_dir_all()
        .map_err(|e| Error::io("cannot create the directory", e).at(folder.display()))?;
    let size_of = |split: &str| -> usize {
        let labels = indices.iter().flat_map(Index::values);
        labels
            .filter(|label| split_of[label.object.as_str()] == split)
            .count()
    };
    let mut writers: BTreeMap<&String, SplitWriter<'_>> = fractions
        .names()
        .map(|split| (split, SplitWriter::new(&root, split, size_of(split))))
        .collect();
    let all = indices.iter().map(Index::len).sum();
    let mut done = 0;
    let mut decoder = Decoder::new()?;
    for ((path, stem), index) in files.iter().zip(&stems).zip(&indices) {
        let file = GraspFile::open(path)?;
        for grasp in file.grasps() {
            let Some(label) = index.get(grasp.name()) else {
                continue;
            };
            let id = format!("{stem}-{}", grasp.name());
            let Some(writer) = writers.get_mut(&split_of[label.object.as_str()]) else {
                continue;
            };
            match images(grasp, &mut decoder) {
                Ok(images) => writer.push(row(id, label, images))?,
                Err(error) if error.kind() == ErrorKind::Input => {
                    writer.leave_out()?;
                    let reason = error.to_string();
                    report.left_out.push(LeftOut { id, reason });
                }
                Err(error) => return Err(error.at(grasp.name()).at(path.display())),
            }
            done += 1;
            on_progress(done, all);
        }
    }
    for writer in writers.into_values() {
        let (name, counts) = writer.finish(report.left_out.first())?;
        report.splits.insert(name, counts);
    }
    report.is_finished = true;
    report.save(out)?;
    Ok(report)
}

/// File names without extension, the prefixes of the ids.
fn stems(files: &[PathBuf]) -> Result<Vec<String>> {
    if files.is_empty() {
        return Err(Error::usage("no file to import"));
    }
    let mut unique = BTreeSet::new();
    let stems = files.iter().map(|path| {
        let stem = path.file_stem().unwrap_or_default();
        let stem = stem.to_string_lossy().into_owned();
        if unique.insert(stem.clone()) {
            return Ok(stem);
        }
        let what = format!("duplicate file name {stem:?}: the ids of the grasps would collide");
        Err(Error::usage(what)
            .at(path.display())
            .remedy("give each file once, or rename one"))
    });
    stems.collect()
}

pub(super) fn sources(files: &[PathBuf]) -> Result<Vec<SourceFile>> {
    let source = |path: &PathBuf| {
        let found = fs::metadata(path)
            .map_err(|e| Error::io("cannot read the file", e).at(path.display()))?;
        let name = path.file_name().unwrap_or_default();
        Ok(SourceFile {
            name: name.to_string_lossy().into_owned(),
            bytes: found.len(),
        })
    };
    files.iter().map(source).collect()
}

/// Reads the labels of a file.
fn index(path: &Path, stem: &str, left_out: &mut Vec<LeftOut>) -> Result<Index> {
    let file = GraspFile::open(path)?;
    let mut index = Index::new();
    let mut first = None;
    for grasp in file.grasps() {
        // The name becomes part of the id.
        let named = Label::parse(grasp.name());
        match named.and_then(|_| GraspLabel::read(grasp)) {
            Ok(label) => {
                index.insert(grasp.name().to_owned(), label);
            }
            Err(error) if error.kind() == ErrorKind::Input => {
                left_out.push(LeftOut {
                    id: format!("{stem}-{}", Printable(grasp.name())),
                    reason: error.to_string(),
                });
                first.get_or_insert((grasp.name(), error));
            }
            Err(error) => return Err(error.at(grasp.name()).at(path.display())),
        }
    }
    match first {
        // Probably a file of another format.
        Some((name, error)) if index.is_empty() => Err(error.at(name).at(path.display())),
        _ => Ok(index),
    }
}

/// Assigns each object to a split.
///
/// # Errors
/// `Input`: a split would be empty.
fn assign(indices: &[Index], fractions: &SplitFractions) -> Result<BTreeMap<String, String>> {
    let mut objects: BTreeMap<String, SplitGroup> = BTreeMap::new();
    for label in indices.iter().flat_map(Index::values) {
        let new = SplitGroup {
            stratum: String::new(),
            size: 0,
        };
        objects.entry(label.object.to_string()).or_insert(new).size += 1;
    }
    let assigned = fractions.assign(&objects, 0);
    if let Some(empty) = fractions
        .names()
        .find(|name| assigned.values().all(|split| split != *name))
    {
        let what = format!(
            "the split `{empty}` would be empty: there are only {} objects",
            objects.len()
        );
        return Err(Error::input(what).remedy("give more files, or fewer splits"));
    }
    Ok(assigned)
}

fn row(id: String, label: &GraspLabel, images: ShardImages) -> ShardRow {
    let (outcome, detail) = match label.is_stable {
        true => (ShardOutcome::Stable, "stable"),
        false => (ShardOutcome::Slip, "slip"),
    };
    ShardRow {
        facts: ShardFacts {
            simulation: id.clone(),
            id,
            object: label.object.to_string(),
            category: "unknown".to_owned(),
            engine: ShardEngine::Real,
            outcome,
            outcome_detail: detail.to_owned(),
            stop_force_n: None,
            friction: None,
            mass_kg: None,
            lifted_m: None,
            force_left_n: None,
            force_right_n: None,
            opening_m: None,
            t_object_gripper: None,
            fault: None,
            appearance: "real".to_owned(),
            rendering: 0,
            seed: 0,
            crop_profile: CROP.name().to_owned(),
            geometry: None,
            lift: None,
            contact: None,
        },
        images,
    }
}

/// Writes the shards of a split.
struct SplitWriter<'a> {
    root: &'a Root,
    name: &'a str,
    /// Expected number of rows.
    total: usize,
    /// Number of rows written or left out.
    done: usize,
    shard: Option<ShardWriter>,
    objects: BTreeSet<String>,
    counts: ImportedSplit,
}

impl<'a> SplitWriter<'a> {
    fn new(root: &'a Root, name: &'a str, total: usize) -> Self {
        Self {
            root,
            name,
            total,
            done: 0,
            shard: None,
            objects: BTreeSet::new(),
            counts: ImportedSplit::default(),
        }
    }

    fn push(&mut self, row: ShardRow) -> Result<()> {
        match row.facts.outcome {
            ShardOutcome::Stable => self.counts.stable += 1,
            ShardOutcome::Slip => self.counts.slip += 1,
        }
        self.objects.insert(row.facts.object.clone());
        self.shard()?.push(row)?;
        self.next()
    }

    fn leave_out(&mut self) -> Result<()> {
        self.shard()?;
        self.next()
    }

    /// Returns the shard of the next row.
    fn shard(&mut self) -> Result<&mut ShardWriter> {
        let shard = match self.shard.take() {
            Some(shard) => shard,
            None => {
                let number = self.done / ROWS_PER_SHARD;
                let count = self.total.div_ceil(ROWS_PER_SHARD);
                let path = shard_path(self.root, self.name, number, count)?;
                ShardWriter::create(&path, &format!("{{\"imported_from\":\"{FROM}\"}}"))?
            }
        };
        Ok(self.shard.insert(shard))
    }

    fn next(&mut self) -> Result<()> {
        self.done += 1;
        if self.done.is_multiple_of(ROWS_PER_SHARD) || self.done == self.total {
            self.close()?;
        }
        Ok(())
    }

    fn close(&mut self) -> Result<()> {
        match self.shard.take() {
            Some(shard) => shard.finish(),
            None => Ok(()),
        }
    }

    fn finish(mut self, left_out: Option<&LeftOut>) -> Result<(String, ImportedSplit)> {
        self.close()?;
        if self.objects.is_empty() {
            let mut what = format!("no readable grasp in the split `{}`", self.name);
            if let Some(LeftOut { id, reason }) = left_out {
                what.push_str(&format!("; {id}: {reason}"));
            }
            return Err(Error::input(what).at(self.root.path().display()));
        }
        self.counts.objects = self.objects.len();
        Ok((self.name.to_owned(), self.counts))
    }
}
