//! Reads files twice: first what is in them, then the images, a grasp at a time.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use super::feeling_of_success::{CROP, GraspFacts, GraspFile, images};
use super::report::{ImportReport, ImportedPart, SourceFile};
use crate::left_out::LeftOut;
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::{Label, Printable, Root};
use gripcast_dataset::shard::{
    ShardEngine, ShardFacts, ShardImages, ShardOutcome, ShardRow, ShardWriter, Split, SplitGroup,
    shard_place,
};
use gripcast_imaging::Decoder;

/// Name of the dataset on the command line.
const FROM: &str = "feeling-of-success";
/// Rows of a shard: about 150 MB.
const ROWS_PER_SHARD: usize = 2000;
/// Folder of the shards.
const DATA: &str = "data";

/// Grasps of one file by their names in it.
type Index = BTreeMap<String, GraspFacts>;

/// Writes files of the *Feeling of Success* as a dataset into `out`.
///
/// Objects are dealt to the parts by [`Split::deal`]. A grasp that cannot be read is left out
/// and told. Memory holds one grasp's images, and a row group of each part. The same files make
/// the same bytes; a stopped import is begun again by the same call.
///
/// # Errors
/// `Usage`: parts that cannot be, no file, two files of one name. `Input`: a file of another kind,
/// one in which no grasp can be read, a part without an object, an `out` that holds something else.
/// Those of the operating system.
pub fn import_feeling_of_success(
    files: &[PathBuf],
    out: &Path,
    split: &Split,
    on_progress: &dyn Fn(usize, usize),
) -> Result<ImportReport> {
    let stems = stems(files)?;
    let mut report = ImportReport::new(FROM, sources(files)?, split);
    let mut found = Vec::with_capacity(files.len());
    for (path, stem) in files.iter().zip(&stems) {
        found.push(index(path, stem, &mut report.left_out)?);
    }
    let part_of = deal(&found, split)?;
    let left_out = std::mem::take(&mut report.left_out);
    report.claim(out)?;
    report.left_out = left_out;
    let root = Root::new(out);
    let folder = root.top().join(DATA);
    folder
        .create_dir_all()
        .map_err(|e| Error::io("cannot make the folder", e).at(folder.display()))?;
    let of_part = |part: &str| -> usize {
        let facts = found.iter().flat_map(Index::values);
        facts
            .filter(|facts| part_of[facts.object.as_str()] == part)
            .count()
    };
    let mut writing: BTreeMap<&String, PartWriter<'_>> = split
        .names()
        .map(|part| (part, PartWriter::new(&root, part, of_part(part))))
        .collect();
    let all = found.iter().map(Index::len).sum();
    let mut done = 0;
    let mut decoder = Decoder::new()?;
    for ((path, stem), index) in files.iter().zip(&stems).zip(&found) {
        let file = GraspFile::open(path)?;
        for grasp in file.grasps() {
            let Some(facts) = index.get(grasp.name()) else {
                continue;
            };
            let id = format!("{stem}-{}", grasp.name());
            let Some(part) = writing.get_mut(&part_of[facts.object.as_str()]) else {
                continue;
            };
            match images(grasp, &mut decoder) {
                Ok(images) => part.push(row(id, facts, images))?,
                Err(error) if error.kind() == ErrorKind::Input => {
                    part.leave_out()?;
                    let why = error.to_string();
                    report.left_out.push(LeftOut { id, why });
                }
                Err(error) => return Err(error.at(grasp.name()).at(path.display())),
            }
            done += 1;
            on_progress(done, all);
        }
    }
    for part in writing.into_values() {
        let (name, facts) = part.finish(report.left_out.first())?;
        report.parts.insert(name, facts);
    }
    report.is_finished = true;
    report.save(out)?;
    Ok(report)
}

/// Names of files without their endings: the beginnings of the ids.
fn stems(files: &[PathBuf]) -> Result<Vec<String>> {
    if files.is_empty() {
        return Err(Error::usage("there is no file to import"));
    }
    let mut seen = BTreeSet::new();
    let stems = files.iter().map(|path| {
        let stem = path.file_stem().unwrap_or_default();
        let stem = stem.to_string_lossy().into_owned();
        if seen.insert(stem.clone()) {
            return Ok(stem);
        }
        let what = format!("two files are called {stem:?}; their grasps would have the same ids");
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

/// What is in a file, without its images.
fn index(path: &Path, stem: &str, left_out: &mut Vec<LeftOut>) -> Result<Index> {
    let file = GraspFile::open(path)?;
    let mut index = Index::new();
    let mut first = None;
    for grasp in file.grasps() {
        // The name becomes a part of the id.
        let named = Label::parse(grasp.name());
        match named.and_then(|_| GraspFacts::read(grasp)) {
            Ok(facts) => {
                index.insert(grasp.name().to_owned(), facts);
            }
            Err(error) if error.kind() == ErrorKind::Input => {
                left_out.push(LeftOut {
                    id: format!("{stem}-{}", Printable(grasp.name())),
                    why: error.to_string(),
                });
                first.get_or_insert((grasp.name(), error));
            }
            Err(error) => return Err(error.at(grasp.name()).at(path.display())),
        }
    }
    match first {
        // Rather a file of another kind than one with damaged grasps.
        Some((name, error)) if index.is_empty() => Err(error.at(name).at(path.display())),
        _ => Ok(index),
    }
}

/// The part of each object.
///
/// # Errors
/// `Input`: a part would be empty.
fn deal(found: &[Index], split: &Split) -> Result<BTreeMap<String, String>> {
    let mut objects: BTreeMap<String, SplitGroup> = BTreeMap::new();
    for facts in found.iter().flat_map(Index::values) {
        let new = SplitGroup {
            stratum: String::new(),
            size: 0,
        };
        objects.entry(facts.object.to_string()).or_insert(new).size += 1;
    }
    let dealt = split.deal(&objects, 0);
    if let Some(empty) = split
        .names()
        .find(|name| dealt.values().all(|of| of != *name))
    {
        let what = format!(
            "the part `{empty}` would be empty: there are only {} objects",
            objects.len()
        );
        return Err(Error::input(what).remedy("give more files, or fewer parts"));
    }
    Ok(dealt)
}

fn row(id: String, facts: &GraspFacts, images: ShardImages) -> ShardRow {
    let (outcome, detail) = match facts.is_stable {
        true => (ShardOutcome::Stable, "held"),
        false => (ShardOutcome::Slip, "lost"),
    };
    ShardRow {
        facts: ShardFacts {
            simulation: id.clone(),
            id,
            object: facts.object.to_string(),
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
        },
        images,
    }
}

/// The shards of a part, one after the other.
struct PartWriter<'a> {
    root: &'a Root,
    name: &'a str,
    /// Rows that are expected.
    all: usize,
    /// Rows that were written or left out.
    done: usize,
    shard: Option<ShardWriter>,
    objects: BTreeSet<String>,
    facts: ImportedPart,
}

impl<'a> PartWriter<'a> {
    fn new(root: &'a Root, name: &'a str, all: usize) -> Self {
        Self {
            root,
            name,
            all,
            done: 0,
            shard: None,
            objects: BTreeSet::new(),
            facts: ImportedPart::default(),
        }
    }

    fn push(&mut self, row: ShardRow) -> Result<()> {
        match row.facts.outcome {
            ShardOutcome::Stable => self.facts.stable += 1,
            ShardOutcome::Slip => self.facts.slip += 1,
        }
        self.objects.insert(row.facts.object.clone());
        self.shard()?.push(row)?;
        self.next()
    }

    fn leave_out(&mut self) -> Result<()> {
        self.shard()?;
        self.next()
    }

    /// The shard that the next row is for.
    fn shard(&mut self) -> Result<&mut ShardWriter> {
        let shard = match self.shard.take() {
            Some(shard) => shard,
            None => {
                let number = self.done / ROWS_PER_SHARD;
                let count = self.all.div_ceil(ROWS_PER_SHARD);
                let place = shard_place(self.root, self.name, number, count)?;
                ShardWriter::create(&place, &format!("{{\"imported_from\":\"{FROM}\"}}"))?
            }
        };
        Ok(self.shard.insert(shard))
    }

    fn next(&mut self) -> Result<()> {
        self.done += 1;
        if self.done.is_multiple_of(ROWS_PER_SHARD) || self.done == self.all {
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

    fn finish(mut self, left_out: Option<&LeftOut>) -> Result<(String, ImportedPart)> {
        self.close()?;
        if self.objects.is_empty() {
            let mut what = format!("no grasp of the part `{}` could be read", self.name);
            if let Some(LeftOut { id, why }) = left_out {
                what.push_str(&format!("; {id}: {why}"));
            }
            return Err(Error::input(what).at(self.root.path().display()));
        }
        self.facts.objects = self.objects.len();
        Ok((self.name.to_owned(), self.facts))
    }
}
