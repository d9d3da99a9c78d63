//! Opens a dataset for writing: creates it, or recovers the state after a crash.

use std::io;
use std::path::Path;

use super::counts::GraspCounts;
use super::descriptor::{Descriptor, NewDataset};
use super::disk::{Disk, SystemDisk, is_partial, partial_name, partial_of, remove_item, replace};
use super::grasp_index::GraspIndex;
use super::index::is_stored;
use super::layout::{DATASET_TOML, GRASP_JSON, INITIAL_JSON, LOCK, Layout};
use super::lift::lift_files;
use super::lock::DatasetLock;
use super::provenance::Provenance;
use super::record_file::PendingInitial;
use super::schema::SCHEMA_VERSION;
use super::trash::move_to_trash;
use super::unfinished::{Unfinished, unfinished};
use super::writer::DatasetWriter;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::Root;

/// Warning for file systems without a flush of directories.
const CANNOT_FLUSH: &str = "the file system cannot flush directories: a power failure can lose the \
     grasps of the last seconds, a crash of the program cannot; a local disk has no such limit";

/// State of a dataset that was opened for writing.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct OpenReport {
    /// Whether the dataset was created.
    pub created: bool,
    /// Number of existing grasps.
    pub counts: GraspCounts,
    /// What the existing grasps were taken with.
    pub provenance: Provenance,
    /// The newest pending initial frame.
    pub pending: Option<PendingInitial>,
    /// Leftovers of a crash and how they were handled, one sentence each.
    pub notes: Vec<String>,
}

impl DatasetWriter {
    /// Opens the dataset at `path` for writing; creates it if the directory is missing or empty.
    ///
    /// Recovers after a crash: completes a complete grasp, returns the newest pending initial
    /// frame, and moves other leftovers to `trash/`.
    ///
    /// # Errors
    /// `Busy` naming the process that writes it; `Input` for a file, a directory with other
    /// contents, or a newer format; `Permission` or `DiskFull` where it is not writable.
    pub fn open_or_create(path: impl AsRef<Path>, new: &NewDataset) -> Result<(Self, OpenReport)> {
        Self::open_index(GraspIndex::new(path.as_ref()), new)
    }

    /// As [`open_or_create`](Self::open_or_create), with an index that other parts of the process
    /// read.
    ///
    /// # Errors
    /// As [`open_or_create`](Self::open_or_create).
    pub fn open_index(index: GraspIndex, new: &NewDataset) -> Result<(Self, OpenReport)> {
        Self::open_on(Box::new(SystemDisk), index, new)
    }

    /// Opens an existing dataset for writing, as [`open_or_create`](Self::open_or_create).
    ///
    /// # Errors
    /// `NotFound` without a dataset; as [`open_or_create`](Self::open_or_create).
    pub fn open(path: impl AsRef<Path>) -> Result<(Self, OpenReport)> {
        let path = path.as_ref();
        let found = Descriptor::read(&Layout::new(path))?;
        let same = NewDataset {
            name: found.name,
            rig: found.rig,
            licence: found.licence,
            label_definition: found.label_definition,
        };
        Self::open_or_create(path, &same)
    }

    pub(super) fn open_on(
        disk: Box<dyn Disk>,
        index: GraspIndex,
        new: &NewDataset,
    ) -> Result<(Self, OpenReport)> {
        let layout = Layout::new(index.path());
        create_root(disk.as_ref(), &layout)?;
        let lock = DatasetLock::acquire(&layout)?;
        let created = !layout.dataset_toml().is_taken();
        if created {
            let text = Descriptor::new(new).to_toml()?;
            replace(disk.as_ref(), &layout.top(), DATASET_TOML, text.as_bytes())
                .map_err(|e| layout.failed("cannot create the dataset", e))?;
        }
        let descriptor = Descriptor::read(&layout)?;
        create_directories(disk.as_ref(), &layout)
            .map_err(|e| layout.failed("cannot create the dataset's directories", e))?;
        let mut writer = Self::new(layout, disk, lock, descriptor, index);
        let mut report = OpenReport {
            created,
            ..OpenReport::default()
        };
        if writer.descriptor.schema != SCHEMA_VERSION {
            report.notes.push(format!(
                "the dataset is of version {} of the format; the first change makes it version \
                 {SCHEMA_VERSION}, which earlier versions of gripcast refuse",
                writer.descriptor.schema
            ));
        }
        writer.remove_partial_moves();
        if !writer.layout.grasps().can_sync_dir().unwrap_or(true) {
            report.notes.push(CANNOT_FLUSH.to_owned());
        }
        writer.handle_unfinished(&mut report)?;
        writer.fill_index(&mut report)?;
        report.counts = writer.counts();
        let (revision, text) = writer.index.to_jsonl();
        writer.stored_revision = is_stored(&writer.layout, &text).then_some(revision);
        if let Err(error) = writer.flush_index() {
            report.notes.push(error.to_string());
        }
        Ok((writer, report))
    }

    /// Removes incomplete copies of moves between disks: the complete item is in its other place.
    fn remove_partial_moves(&self) {
        for folder in [self.layout.grasps(), self.layout.trash()] {
            for entry in folder.entries().into_iter().flatten() {
                if is_partial(&entry.name()) {
                    remove_item(self.disk.as_ref(), &entry);
                }
            }
        }
    }

    /// Handles leftovers of a crash in `grasps/`.
    fn handle_unfinished(&mut self, report: &mut OpenReport) -> Result<()> {
        let disk = self.disk.as_ref();
        for (id, state) in unfinished(&self.layout)? {
            let dir = self.layout.pending(&id);
            // The crash may have come before the directory was flushed.
            let synced = |()| disk.sync_dir(&self.layout.grasps());
            match state {
                Unfinished::Complete => {
                    disk.sync_dir(&dir)
                        .and_then(|()| disk.rename_new(&dir, &self.layout.grasp(&id)))
                        .and_then(synced)
                        .map_err(|e| self.failed(&format!("cannot complete {id}"), e))?;
                    report.notes.push(format!("completed {id} after a crash"));
                }
                Unfinished::Pending(pending) => {
                    disk.sync_dir(&dir)
                        .and_then(synced)
                        .map_err(|e| self.failed("cannot keep the initial frame", e))?;
                    report.pending = Some(*pending);
                }
                Unfinished::Unusable(reason) => {
                    report
                        .notes
                        .push(match move_to_trash(disk, &self.layout, &dir, &reason) {
                            Ok(_slot) => format!("moved .tmp-{id} to trash/: {reason}"),
                            Err(e) => format!("could not move .tmp-{id} to trash/: {e}"),
                        });
                }
            }
        }
        Ok(())
    }

    /// Reads all records; removes leftovers of interrupted saves beside them.
    fn fill_index(&mut self, report: &mut OpenReport) -> Result<()> {
        self.index.fill()?;
        for (id, error) in self.index.unreadable() {
            report.notes.push(format!("cannot use {id}: {error}"));
        }
        report.provenance = Provenance::of(&self.index, &self.layout);
        for id in self.index.ids() {
            let dir = self.layout.grasp(&id);
            let records = [dir.join(INITIAL_JSON), partial_of(&dir, &GRASP_JSON)];
            let has_lift = self.index.get(&id).is_none_or(|row| row.has_lift);
            let lifts = lift_files(&dir).filter(|_| !has_lift);
            for leftover in records.into_iter().chain(lifts) {
                if leftover.is_taken() {
                    // On failure, verification and the next opening find it again.
                    let _ = self.disk.remove_file(&leftover);
                }
            }
        }
        Ok(())
    }
}

/// Creates the dataset's directory, or refuses one with other contents.
fn create_root(disk: &dyn Disk, layout: &Layout) -> Result<()> {
    let root = layout.root();
    match layout.top().entries() {
        Err(e) if e.kind() == io::ErrorKind::NotFound => create_all(disk, root)
            .map_err(|e| layout.failed("cannot create the dataset's directory", e)),
        Err(e) if e.kind() == io::ErrorKind::NotADirectory => {
            Err(Error::input("expected a directory, found a file")
                .at(root.display())
                .remedy("give a new or empty directory, or an existing dataset"))
        }
        Err(e) => Err(layout.failed("cannot read the directory", e)),
        Ok(_) if layout.dataset_toml().is_taken() => Ok(()),
        Ok(entries) => {
            // A crash may have come between locking and writing dataset.toml.
            let foreign = entries.iter().find(|entry| {
                let name = entry.name();
                name != LOCK && name != partial_name(DATASET_TOML)
            });
            let Some(foreign) = foreign else {
                return Ok(());
            };
            let error = Error::input(format!(
                "not a dataset: the directory contains `{}` but no dataset.toml",
                foreign.name()
            ))
            .at(root.display());
            Err(if layout.grasps().is_dir() {
                error.remedy(format!(
                    "if it was one, run `gripcast dataset recover {}` to write dataset.toml again",
                    root.display()
                ))
            } else {
                error.remedy("give a new or empty directory")
            })
        }
    }
}

/// Creates a directory and its ancestors durably.
fn create_all(disk: &dyn Disk, path: &Path) -> io::Result<()> {
    let parent = match path.parent() {
        Some(parent) if parent.as_os_str().is_empty() => Path::new("."),
        Some(parent) => parent,
        None => return Ok(()),
    };
    if !parent.exists() {
        create_all(disk, parent)?;
    }
    // The user names this directory, not the data.
    let dir = Root::new(parent).entry(path);
    disk.create_dir(&dir)?;
    disk.sync_dir(&dir.parent())
}

pub(super) fn create_directories(disk: &dyn Disk, layout: &Layout) -> io::Result<()> {
    let mut created = false;
    for dir in layout.directories() {
        if !dir.is_dir() {
            disk.create_dir(&dir)?;
            created = true;
        }
    }
    if created {
        disk.sync_dir(&layout.top())?;
    }
    Ok(())
}
