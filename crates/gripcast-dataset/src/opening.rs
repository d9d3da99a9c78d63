//! Opening a dataset for writing: making it, or putting in order what a crash left.

use std::io;
use std::path::Path;

use super::counts::GraspCounts;
use super::descriptor::{Descriptor, NewDataset};
use super::disk::{Disk, SystemDisk, partial_name, partial_of, replace};
use super::index::{IndexRow, is_stored, to_jsonl};
use super::layout::{DATASET_TOML, GRASP_JSON, INITIAL_JSON, LOCK, Layout};
use super::lock::DatasetLock;
use super::reader::grasp_ids;
use super::record_file::{PendingInitial, read_grasp};
use super::trash::set_aside;
use super::unfinished::{Unfinished, unfinished};
use super::writer::DatasetWriter;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::Root;

/// What was found when a dataset was opened for writing.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct OpenReport {
    /// Whether the dataset is new.
    pub created: bool,
    /// Grasps that are there.
    pub counts: GraspCounts,
    /// The newest durable initial frame that waits for its grasp.
    pub pending: Option<PendingInitial>,
    /// What an earlier crash left and what was done about it, one sentence each.
    pub notes: Vec<String>,
}

impl DatasetWriter {
    /// Opens the dataset at `path` for writing; makes it where nothing or an empty directory is.
    ///
    /// Unfinished work of a crash is put in order: a whole grasp is completed, the newest durable
    /// initial frame is offered, the rest moves to `trash/`.
    ///
    /// # Errors
    /// `Busy` naming the process that writes it; `Input` for a file, a directory of something
    /// else, or a newer format; `Permission` or `DiskFull` where it cannot be written.
    pub fn open_or_create(path: impl AsRef<Path>, new: &NewDataset) -> Result<(Self, OpenReport)> {
        Self::open_on(Box::new(SystemDisk), path.as_ref(), new)
    }

    pub(super) fn open_on(
        disk: Box<dyn Disk>,
        root: &Path,
        new: &NewDataset,
    ) -> Result<(Self, OpenReport)> {
        let layout = Layout::new(root);
        create_root(disk.as_ref(), &layout)?;
        let lock = DatasetLock::acquire(&layout)?;
        let created = !layout.dataset_toml().is_taken();
        if created {
            let text = Descriptor::new(new).to_toml()?;
            replace(disk.as_ref(), &layout.top(), DATASET_TOML, text.as_bytes())
                .map_err(|e| layout.failed("cannot begin the dataset", e))?;
        }
        let descriptor = Descriptor::read(&layout)?;
        create_directories(disk.as_ref(), &layout)
            .map_err(|e| layout.failed("cannot make the dataset's directories", e))?;
        let mut writer = Self::new(layout, disk, lock, descriptor);
        let mut report = OpenReport {
            created,
            ..OpenReport::default()
        };
        writer.settle(&mut report)?;
        writer.read_rows(&mut report)?;
        report.counts = writer.counts();
        writer.index_is_stale = !is_stored(&writer.layout, &to_jsonl(&writer.rows));
        if let Err(error) = writer.flush_index() {
            report.notes.push(error.to_string());
        }
        Ok((writer, report))
    }

    /// Puts in order what a crash left in `grasps/`.
    fn settle(&mut self, report: &mut OpenReport) -> Result<()> {
        let disk = self.disk.as_ref();
        for (id, fate) in unfinished(&self.layout)? {
            let dir = self.layout.pending(&id);
            // The crash may have come before names in the directory were forced to the disk.
            let synced = |()| disk.sync_dir(&self.layout.grasps());
            match fate {
                Unfinished::Complete => {
                    disk.sync_dir(&dir)
                        .and_then(|()| disk.rename_new(&dir, &self.layout.grasp(&id)))
                        .and_then(synced)
                        .map_err(|e| self.failed(&format!("cannot complete {id}"), e))?;
                    report
                        .notes
                        .push(format!("completed {id}, which a crash had interrupted"));
                }
                Unfinished::Waiting(pending) => {
                    disk.sync_dir(&dir)
                        .and_then(synced)
                        .map_err(|e| self.failed("cannot keep the initial frame", e))?;
                    report.pending = Some(pending);
                }
                Unfinished::Unusable(reason) => {
                    report
                        .notes
                        .push(match set_aside(disk, &self.layout, &dir, &reason) {
                            Ok(_slot) => format!("moved .tmp-{id} to trash/: {reason}"),
                            Err(e) => format!("could not move .tmp-{id} to trash/: {e}"),
                        });
                }
            }
        }
        Ok(())
    }

    /// Reads all records; clears what interrupted saves left beside them.
    fn read_rows(&mut self, report: &mut OpenReport) -> Result<()> {
        for id in grasp_ids(&self.layout)? {
            let dir = self.layout.grasp(&id);
            match read_grasp(&dir) {
                Ok(record) => {
                    self.rows.insert(id, IndexRow::of(&record));
                }
                Err(error) => {
                    report.notes.push(format!("{id} is not usable: {error}"));
                    continue;
                }
            }
            for leftover in [dir.join(INITIAL_JSON), partial_of(&dir, &GRASP_JSON)] {
                if leftover.is_taken() {
                    // Verification and the next opening see it again where this fails.
                    let _ = self.disk.remove_file(&leftover);
                }
            }
        }
        Ok(())
    }
}

/// Makes the dataset's directory, or refuses one that holds something else.
fn create_root(disk: &dyn Disk, layout: &Layout) -> Result<()> {
    let root = layout.root();
    match layout.top().entries() {
        Err(e) if e.kind() == io::ErrorKind::NotFound => create_all(disk, root)
            .map_err(|e| layout.failed("cannot make the dataset's directory", e)),
        Err(e) if e.kind() == io::ErrorKind::NotADirectory => {
            Err(Error::input("this is a file, not a directory")
                .at(root.display())
                .remedy("give a directory that does not exist yet, is empty, or holds a dataset"))
        }
        Err(e) => Err(layout.failed("cannot read the directory", e)),
        Ok(_) if layout.dataset_toml().is_taken() => Ok(()),
        Ok(entries) => {
            // A crash may have come between the lock and the description.
            let foreign = entries.iter().find(|entry| {
                let name = entry.name();
                name != LOCK && name != partial_name(DATASET_TOML)
            });
            let Some(foreign) = foreign else {
                return Ok(());
            };
            let error = Error::input(format!(
                "the directory holds `{}` but no dataset.toml: it is not a dataset",
                foreign.name()
            ))
            .at(root.display());
            Err(if layout.grasps().is_dir() {
                error.remedy(format!(
                    "if it was one, `gripcast dataset recover {}` writes dataset.toml again",
                    root.display()
                ))
            } else {
                error.remedy("give a directory that does not exist yet or is empty")
            })
        }
    }
}

/// Makes a directory with its ancestors, durably.
fn create_all(disk: &dyn Disk, path: &Path) -> io::Result<()> {
    let parent = match path.parent() {
        Some(parent) if parent.as_os_str().is_empty() => Path::new("."),
        Some(parent) => parent,
        None => return Ok(()),
    };
    if !parent.exists() {
        create_all(disk, parent)?;
    }
    // The folder is named by the user, not by the data.
    let place = Root::new(parent).entry(path);
    disk.create_dir(&place)?;
    disk.sync_dir(&place.parent())
}

pub(super) fn create_directories(disk: &dyn Disk, layout: &Layout) -> io::Result<()> {
    let mut made = false;
    for dir in layout.directories() {
        if !dir.is_dir() {
            disk.create_dir(&dir)?;
            made = true;
        }
    }
    if made {
        disk.sync_dir(&layout.top())?;
    }
    Ok(())
}
