//! Recovers a damaged dataset: keeps readable grasps, moves the rest to `trash/`, deletes nothing.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use serde::Serialize;

use super::descriptor::{Descriptor, NewDataset};
use super::disk::{Disk, SystemDisk, is_partial, replace};
use super::grasp::GraspRecord;
use super::index::{self, IndexRow};
use super::layout::{DATASET_TOML, GRASP_JSON, Layout, METADATA_JSONL, pending_id};
use super::lock::DatasetLock;
use super::migrate::raise;
use super::opening::create_directories;
use super::reader::{entries, grasp_ids};
use super::rebuild::{is_newer, rebuild};
use super::record_file::{check_files, names_to_normalise, read_grasp, to_json};
use super::schema::SCHEMA_VERSION;
use super::trash::move_to_trash;
use super::unfinished::{Unfinished, unfinished};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::{BeneathPath, GraspId};

/// Kind of a recovery action.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum ActionKind {
    /// Writes `dataset.toml` again.
    WriteDescriptor,
    /// Completes a grasp whose renaming was interrupted.
    Complete,
    /// Renames a directory to the id in its record.
    Rename,
    /// Rebuilds a record from the images, the index and the rest of the old record.
    Rebuild,
    /// Stores names in their normal form.
    NormaliseNames,
    /// Moves an item that is not part of a complete grasp to `trash/`.
    SetAside,
    /// Leaves an item of a newer version unchanged.
    Leave,
    /// Writes the index again.
    Reindex,
}

/// One action of a recovery.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Action {
    /// Kind of the action.
    pub kind: ActionKind,
    /// Affected item, relative to the dataset.
    pub item: String,
    /// Reason.
    pub detail: String,
    /// Whether data is lost: a grasp or some of its files are no longer usable.
    pub lost: bool,
}

/// Result of a recovery.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct RecoverReport {
    /// Whether nothing was changed.
    pub dry_run: bool,
    /// Actions that were done, or would be done.
    pub actions: Vec<Action>,
    /// Complete grasps afterwards.
    pub grasps: usize,
}

/// Operation that carries out an action.
enum Step {
    WriteDescriptor(Descriptor),
    Complete(GraspId),
    Rename { from: BeneathPath, to: GraspId },
    WriteRecord(Box<GraspRecord>),
    SetAside(BeneathPath),
    Reindex,
    Nothing,
}

/// Recovers a dataset after crashes, lost files and altered files.
///
/// # Errors
/// `NotFound` or `Input` when there is no dataset or it is of a newer version; `Busy` while it is
/// written; `DiskFull`, `Io`, … when an action fails: earlier actions stay done.
pub fn recover(path: impl AsRef<Path>, dry_run: bool) -> Result<RecoverReport> {
    let layout = Layout::new(path.as_ref());
    let descriptor = match Descriptor::read(&layout) {
        Ok(_) => None,
        Err(error) if error.kind() == ErrorKind::NotFound && layout.grasps().is_dir() => {
            Some(new_descriptor(&layout))
        }
        Err(error) => return Err(error),
    };
    let _lock = if dry_run {
        None
    } else {
        Some(DatasetLock::acquire(&layout)?)
    };
    let mut plan = Plan {
        layout: &layout,
        steps: Vec::new(),
        kept: BTreeMap::new(),
    };
    if let Some(descriptor) = descriptor {
        plan.add(
            ActionKind::WriteDescriptor,
            DATASET_TOML,
            "it was missing; check its name, rig and licence",
            Step::WriteDescriptor(descriptor),
        );
    }
    plan.unfinished()?;
    plan.grasps()?;
    plan.strays()?;
    plan.index();
    if !dry_run {
        create_directories(&SystemDisk, &layout)
            .map_err(|e| layout.failed("cannot create the dataset's directories", e))?;
        for (action, step) in &plan.steps {
            execute(&layout, action, step)?;
        }
    }
    Ok(RecoverReport {
        dry_run,
        grasps: plan.kept.len(),
        actions: plan.steps.into_iter().map(|(action, _)| action).collect(),
    })
}

struct Plan<'a> {
    layout: &'a Layout,
    steps: Vec<(Action, Step)>,
    /// Complete grasps afterwards.
    kept: BTreeMap<GraspId, IndexRow>,
}

impl Plan<'_> {
    fn add(&mut self, kind: ActionKind, item: &str, detail: impl Into<String>, step: Step) {
        self.steps.push((
            Action {
                kind,
                item: item.to_owned(),
                detail: detail.into(),
                lost: false,
            },
            step,
        ));
    }

    fn add_loss(&mut self, kind: ActionKind, item: &str, detail: impl Into<String>, step: Step) {
        self.add(kind, item, detail, step);
        if let Some((action, _)) = self.steps.last_mut() {
            action.lost = true;
        }
    }

    /// Directories of saves that were not finished. They were never acknowledged as grasps, so
    /// the trash loses no acknowledged data.
    fn unfinished(&mut self) -> Result<()> {
        for (id, state) in unfinished(self.layout)? {
            let dir = self.layout.pending(&id);
            let item = format!("grasps/.tmp-{id}");
            match state {
                Unfinished::Pending(_) => {}
                Unfinished::Complete => {
                    self.kept
                        .insert(id.clone(), IndexRow::new(&read_grasp(&dir)?));
                    let detail = "the grasp is complete, but its renaming was interrupted";
                    self.add(ActionKind::Complete, &item, detail, Step::Complete(id));
                }
                Unfinished::Unusable(reason) => {
                    self.add(ActionKind::SetAside, &item, reason, Step::SetAside(dir));
                }
            }
        }
        Ok(())
    }

    fn grasps(&mut self) -> Result<()> {
        let ids = grasp_ids(self.layout)?;
        // Directories named after their record come first, so that copies are recognised.
        let (own, other): (Vec<_>, Vec<_>) = ids
            .into_iter()
            .map(|id| {
                let record = read_grasp(&self.layout.grasp(&id));
                (id, record)
            })
            .partition(|(id, record)| record.as_ref().is_ok_and(|record| record.id == *id));
        let hints = index::rows_by_id(self.layout);
        for (id, record) in own.into_iter().chain(other) {
            match record {
                Ok(record) => self.readable(&self.layout.grasp(&id), &record),
                Err(error) => self.unreadable(id, &error, &hints),
            }
        }
        Ok(())
    }

    fn readable(&mut self, dir: &BeneathPath, record: &GraspRecord) {
        let name = dir.name();
        let item = format!("grasps/{name}");
        if self.kept.contains_key(&record.id) {
            let detail = format!("a copy of {}", record.id);
            let step = Step::SetAside(dir.clone());
            self.add(ActionKind::SetAside, &item, detail, step);
            return;
        }
        if let Err(error) = check_files(dir, &record.files) {
            self.add_loss(
                ActionKind::SetAside,
                &item,
                format!("incomplete: {error}"),
                Step::SetAside(dir.clone()),
            );
            return;
        }
        self.extra_files(dir, record);
        self.kept.insert(record.id.clone(), IndexRow::new(record));
        if record.id != *name {
            let detail = format!("the record belongs to {}", record.id);
            let step = Step::Rename {
                from: dir.clone(),
                to: record.id.clone(),
            };
            self.add(ActionKind::Rename, &item, detail, step);
        }
        let names: Vec<String> = names_to_normalise(dir, record)
            .into_iter()
            .map(|(field, stored, normal)| format!("{field} {stored:?} → {normal:?}"))
            .collect();
        if !names.is_empty() {
            let step = Step::WriteRecord(Box::new(record.clone()));
            self.add(ActionKind::NormaliseNames, &item, names.join(", "), step);
        }
    }

    fn extra_files(&mut self, dir: &BeneathPath, record: &GraspRecord) {
        for entry in entries(dir).into_iter().flatten() {
            let name = entry.name();
            if name != GRASP_JSON && !record.files.contains_key(name.as_str()) {
                self.add(
                    ActionKind::SetAside,
                    &format!("grasps/{}/{name}", dir.name()),
                    "not listed in the record",
                    Step::SetAside(entry),
                );
            }
        }
    }

    fn unreadable(
        &mut self,
        id: GraspId,
        error: &Error,
        hints: &BTreeMap<GraspId, serde_json::Value>,
    ) {
        let dir = self.layout.grasp(&id);
        let item = format!("grasps/{id}");
        if is_newer(&dir) {
            self.add_loss(ActionKind::Leave, &item, error.to_string(), Step::Nothing);
            return;
        }
        match rebuild(&dir, &id, hints.get(&id)) {
            Ok(record) => {
                let broken = dir.join(GRASP_JSON);
                if broken.is_taken() {
                    self.add(
                        ActionKind::SetAside,
                        &format!("{item}/{GRASP_JSON}"),
                        error.to_string(),
                        Step::SetAside(broken),
                    );
                }
                self.extra_files(&dir, &record);
                self.kept.insert(id, IndexRow::new(&record));
                self.add(
                    ActionKind::Rebuild,
                    &item,
                    record.note.clone(),
                    Step::WriteRecord(Box::new(record)),
                );
            }
            Err(reason) => self.add_loss(
                ActionKind::SetAside,
                &item,
                format!("{error}; {reason}"),
                Step::SetAside(dir),
            ),
        }
    }

    /// Entries of `grasps/` that are not directories of grasps.
    fn strays(&mut self) -> Result<()> {
        let ids = grasp_ids(self.layout)?;
        let is_grasp = |name: &str| ids.binary_search_by(|id| id.as_str().cmp(name)).is_ok();
        for entry in entries(&self.layout.grasps())? {
            let name = entry.name();
            let is_dir = entry.is_dir();
            if is_dir && (is_grasp(&name) || pending_id(&name).is_some()) {
                continue;
            }
            if is_partial(&name) {
                self.add(
                    ActionKind::SetAside,
                    &format!("grasps/{name}"),
                    "the copy of an interrupted move; the item is in its old or new place",
                    Step::SetAside(entry),
                );
                continue;
            }
            // A copy of a grasp, or a grasp in a directory with an invalid name.
            if is_dir && let Ok(record) = read_grasp(&entry) {
                self.readable(&entry, &record);
                continue;
            }
            self.add(
                ActionKind::SetAside,
                &format!("grasps/{name}"),
                "not a grasp directory",
                Step::SetAside(entry),
            );
        }
        Ok(())
    }

    /// The index afterwards.
    fn index(&mut self) {
        if !index::is_stored(self.layout, &index::to_jsonl(&self.kept)) {
            let detail = "it differs from the records";
            self.add(ActionKind::Reindex, METADATA_JSONL, detail, Step::Reindex);
        }
    }
}

fn execute(layout: &Layout, action: &Action, step: &Step) -> Result<()> {
    let disk = &SystemDisk;
    let done = match step {
        Step::WriteDescriptor(descriptor) => replace(
            disk,
            &layout.top(),
            DATASET_TOML,
            descriptor.to_toml()?.as_bytes(),
        ),
        Step::Complete(id) => disk
            .sync_dir(&layout.pending(id))
            .and_then(|()| disk.rename_new(&layout.pending(id), &layout.grasp(id)))
            .and_then(|()| disk.sync_dir(&layout.grasps())),
        Step::Rename { from, to } => disk
            .rename_new(from, &layout.grasp(to))
            .and_then(|()| disk.sync_dir(&layout.grasps())),
        Step::WriteRecord(record) => {
            let record = GraspRecord {
                schema: SCHEMA_VERSION,
                ..record.as_ref().clone()
            };
            raise(disk, layout, &mut Descriptor::read(layout)?)?;
            replace(
                disk,
                &layout.grasp(&record.id),
                GRASP_JSON,
                &to_json(&record)?,
            )
        }
        Step::SetAside(path) => move_to_trash(disk, layout, path, &action.detail).map(|_slot| ()),
        Step::Reindex => return index::rewrite(disk, layout).map(|_report| ()),
        Step::Nothing => Ok(()),
    };
    done.map_err(|e| layout.failed(&format!("cannot recover {}", action.item), e))
}

/// Description of a dataset whose `dataset.toml` is missing.
fn new_descriptor(layout: &Layout) -> Descriptor {
    let rig = grasp_ids(layout)
        .into_iter()
        .flatten()
        .find_map(|id| read_grasp(&layout.grasp(&id)).ok())
        .map_or_else(|| "unknown".to_owned(), |record| record.rig);
    let root = fs::canonicalize(layout.root()).unwrap_or_else(|_| layout.root().to_owned());
    Descriptor::new(&NewDataset {
        name: root.file_name().map_or_else(
            || "dataset".to_owned(),
            |name| name.to_string_lossy().into_owned(),
        ),
        rig,
        licence: "unknown".to_owned(),
        label_definition: "unknown".to_owned(),
    })
}
