//! The few file operations that the writer is made of, so that tests can fail any one of them.

use std::io;

use gripcast_base::files::{BeneathPath, Component};

/// Operations on the disk that change it, all below the dataset's root.
pub(super) trait Disk: Send {
    /// Makes a directory whose parent exists.
    fn create_dir(&self, path: &BeneathPath) -> io::Result<()>;

    /// Writes a file whole, replacing what was there, and forces its contents to the disk.
    /// The name is durable only after [`Disk::sync_dir`] of the directory.
    fn write(&self, path: &BeneathPath, bytes: &[u8]) -> io::Result<()>;

    /// Gives a file a second name; its contents are shared.
    fn link(&self, from: &BeneathPath, to: &BeneathPath) -> io::Result<()>;

    /// Renames, replacing a file that has the new name.
    fn rename(&self, from: &BeneathPath, to: &BeneathPath) -> io::Result<()>;

    /// Renames; fails with `AlreadyExists` where the new name is taken.
    fn rename_new(&self, from: &BeneathPath, to: &BeneathPath) -> io::Result<()>;

    /// Removes a file.
    fn remove_file(&self, path: &BeneathPath) -> io::Result<()>;

    /// Removes an empty directory.
    fn remove_dir(&self, path: &BeneathPath) -> io::Result<()>;

    /// Forces the names inside a directory to the disk.
    fn sync_dir(&self, path: &BeneathPath) -> io::Result<()>;
}

/// The operating system's disk.
#[derive(Debug)]
pub(super) struct SystemDisk;

impl Disk for SystemDisk {
    fn create_dir(&self, path: &BeneathPath) -> io::Result<()> {
        path.create_dir()
    }

    fn write(&self, path: &BeneathPath, bytes: &[u8]) -> io::Result<()> {
        path.write(bytes)
    }

    fn link(&self, from: &BeneathPath, to: &BeneathPath) -> io::Result<()> {
        from.hard_link(to)
    }

    fn rename(&self, from: &BeneathPath, to: &BeneathPath) -> io::Result<()> {
        from.rename(to)
    }

    fn rename_new(&self, from: &BeneathPath, to: &BeneathPath) -> io::Result<()> {
        from.rename_new(to)
    }

    fn remove_file(&self, path: &BeneathPath) -> io::Result<()> {
        path.remove_file()
    }

    fn remove_dir(&self, path: &BeneathPath) -> io::Result<()> {
        path.remove_dir()
    }

    fn sync_dir(&self, path: &BeneathPath) -> io::Result<()> {
        path.sync_dir()
    }
}

/// Replaces `dir/name` as a whole: temporary file, flush, rename, flush of the directory.
/// Readers see the old contents or the new, never a part.
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
        // The cause is what the caller reports; what stays here is recognised by its name.
        let _ = disk.remove_file(&partial);
        return Err(error);
    }
    disk.sync_dir(dir)
}

/// Where a file is written before it gets its name.
pub(super) fn partial_of(dir: &BeneathPath, name: &impl Component) -> BeneathPath {
    dir.join_affixed(".", name, ".partial")
}

/// Name under which a file is written before it gets its own.
pub(super) fn partial_name(name: &str) -> String {
    format!(".{name}.partial")
}

/// Whether a file has a name given by [`partial_name`].
pub(super) fn is_partial(name: &str) -> bool {
    name.starts_with('.') && name.ends_with(".partial")
}
