//! File operations of the writer behind a trait, so that tests can inject faults.

use std::io;

use gripcast_base::error::Refused;
use gripcast_base::files::{BeneathPath, Component, FileKind};

/// Operations that change the disk, all below the dataset's root. The default methods are those
/// of the operating system.
pub(super) trait Disk: Send {
    /// Creates a directory whose parent exists.
    fn create_dir(&self, path: &BeneathPath) -> io::Result<()> {
        path.create_dir()
    }

    /// Writes a complete file, replacing an existing one, and flushes its contents to the disk.
    /// The name is durable only after [`Disk::sync_dir`] of the directory.
    fn write(&self, path: &BeneathPath, bytes: &[u8]) -> io::Result<()> {
        path.write(bytes)
    }

    /// Creates a hard link.
    fn link(&self, from: &BeneathPath, to: &BeneathPath) -> io::Result<()> {
        from.hard_link(to)
    }

    /// Renames, replacing an existing file.
    fn rename(&self, from: &BeneathPath, to: &BeneathPath) -> io::Result<()> {
        from.rename(to)
    }

    /// Renames; fails with `AlreadyExists` where the target exists.
    fn rename_new(&self, from: &BeneathPath, to: &BeneathPath) -> io::Result<()> {
        from.rename_new(to)
    }

    /// Removes a file.
    fn remove_file(&self, path: &BeneathPath) -> io::Result<()> {
        path.remove_file()
    }

    /// Removes an empty directory.
    fn remove_dir(&self, path: &BeneathPath) -> io::Result<()> {
        path.remove_dir()
    }

    /// Flushes the directory entries to the disk.
    fn sync_dir(&self, path: &BeneathPath) -> io::Result<()> {
        path.sync_dir()
    }
}

/// The operating system's disk.
#[derive(Debug)]
pub(super) struct SystemDisk;

impl Disk for SystemDisk {}

/// Replaces `dir/name` atomically: temporary file, flush, rename, flush of the directory.
/// Readers see either the old or the new contents.
pub(super) fn replace(
    disk: &dyn Disk,
    dir: &BeneathPath,
    name: impl Component,
    bytes: &[u8],
) -> io::Result<()> {
    let partial = partial_of(dir, &name);
    let written = disk
        .write(&partial, bytes)
        .and_then(|()| disk.rename(&partial, &dir.join(&name)));
    if let Err(error) = written {
        // The caller reports the cause; a leftover is recognised by its name.
        let _ = disk.remove_file(&partial);
        return Err(error);
    }
    disk.sync_dir(dir)
}

/// Moves a file or directory to an unused name, durably. It is copied where `to` is on another
/// disk: its folder may be a link. After a crash both names may exist, never none.
///
/// # Errors
/// `AlreadyExists`; those of the operating system, with the item in its old place.
pub(super) fn move_item(disk: &dyn Disk, from: &BeneathPath, to: &BeneathPath) -> io::Result<()> {
    match disk.rename_new(from, to) {
        Err(e) if e.kind() == io::ErrorKind::CrossesDevices => {
            return move_to_other_disk(disk, from, to);
        }
        renamed => renamed?,
    }
    let synced = [to, from]
        .into_iter()
        .try_for_each(|item| disk.sync_dir(&item.parent()));
    synced.inspect_err(|_| {
        let _ = disk.rename_new(to, from);
    })
}

fn move_to_other_disk(disk: &dyn Disk, from: &BeneathPath, to: &BeneathPath) -> io::Result<()> {
    // The next opening removes hidden leftovers.
    let (copy, old) = (to.partial(), from.partial());
    let copied = copy_item(disk, from, &copy)
        .and_then(|()| disk.rename_new(&copy, to))
        .inspect_err(|_| remove_item(disk, &copy));
    copied?;
    let moved = disk
        .sync_dir(&to.parent())
        .and_then(|()| disk.rename_new(from, &old))
        .and_then(|()| {
            disk.sync_dir(&from.parent()).inspect_err(|_| {
                let _ = disk.rename_new(&old, from);
            })
        });
    if let Err(error) = moved {
        // Never the last copy: the name vanishes only while the item is in its old place.
        if from.is_taken() && disk.rename_new(to, &copy).is_ok() {
            remove_item(disk, &copy);
        }
        return Err(error);
    }
    remove_item(disk, &old);
    Ok(())
}

/// Copies a file or directory and flushes it.
fn copy_item(disk: &dyn Disk, from: &BeneathPath, to: &BeneathPath) -> io::Result<()> {
    if from.is_link() {
        return Err(Refused::NotRegular("a symbolic link").into());
    }
    if !from.is_dir() {
        return disk.write(to, &from.read(FileKind::Bulk)?);
    }
    disk.create_dir(to)?;
    for entry in from.entries()? {
        copy_item(disk, &entry, &entry.moved_into(to))?;
    }
    disk.sync_dir(to)
}

/// Removes a file or directory as far as possible.
pub(super) fn remove_item(disk: &dyn Disk, item: &BeneathPath) {
    if item.is_dir() && !item.is_link() {
        for entry in item.entries().into_iter().flatten() {
            remove_item(disk, &entry);
        }
        let _ = disk.remove_dir(item);
    } else {
        let _ = disk.remove_file(item);
    }
}

/// Temporary path of a file that is being written.
pub(super) fn partial_of(dir: &BeneathPath, name: &impl Component) -> BeneathPath {
    dir.join_affixed(".", name, ".partial")
}

/// Temporary name of a file that is being written.
pub(super) fn partial_name(name: &str) -> String {
    format!(".{name}.partial")
}

/// Whether a name is one of [`partial_name`].
pub(super) fn is_partial(name: &str) -> bool {
    name.starts_with('.') && name.ends_with(".partial")
}
