//! File operations of the writer behind a trait, so that tests can inject faults.

use std::io;

use gripcast_base::files::{BeneathPath, Component};

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
