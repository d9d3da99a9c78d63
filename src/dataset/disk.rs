//! The few file operations that the writer is made of, so that tests can fail any one of them.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write as _};
use std::path::Path;

use rustix::fs::{CWD, RenameFlags, renameat_with};

/// Operations on the disk that change it. Reading goes through `std::fs`.
pub(super) trait Disk: Send {
    /// Makes a directory whose parent exists.
    fn create_dir(&self, path: &Path) -> io::Result<()>;

    /// Writes a file whole, replacing what was there, and forces its contents to the disk.
    /// The name is durable only after [`Disk::sync_dir`] of the directory.
    fn write(&self, path: &Path, bytes: &[u8]) -> io::Result<()>;

    /// Gives a file a second name; its contents are shared.
    fn link(&self, from: &Path, to: &Path) -> io::Result<()>;

    /// Renames, replacing a file that has the new name.
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()>;

    /// Renames; fails with `AlreadyExists` where the new name is taken.
    fn rename_new(&self, from: &Path, to: &Path) -> io::Result<()>;

    /// Removes a file.
    fn remove_file(&self, path: &Path) -> io::Result<()>;

    /// Removes an empty directory.
    fn remove_dir(&self, path: &Path) -> io::Result<()>;

    /// Forces the names inside a directory to the disk.
    fn sync_dir(&self, path: &Path) -> io::Result<()>;
}

/// The operating system's disk.
#[derive(Debug)]
pub(super) struct SystemDisk;

impl Disk for SystemDisk {
    fn create_dir(&self, path: &Path) -> io::Result<()> {
        fs::create_dir(path)
    }

    fn write(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        let mut file = OpenOptions::new()
            .write(true)
            .create(true)
            .truncate(true)
            .open(path)?;
        file.write_all(bytes)?;
        file.sync_all()
    }

    fn link(&self, from: &Path, to: &Path) -> io::Result<()> {
        fs::hard_link(from, to)
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        fs::rename(from, to)
    }

    fn rename_new(&self, from: &Path, to: &Path) -> io::Result<()> {
        match renameat_with(CWD, from, CWD, to, RenameFlags::NOREPLACE) {
            Ok(()) => Ok(()),
            // Some network and FAT file systems lack the flag. The dataset's lock keeps other
            // writers out, so looking first is as good there.
            Err(rustix::io::Errno::INVAL | rustix::io::Errno::NOSYS) => {
                if to.symlink_metadata().is_ok() {
                    return Err(io::ErrorKind::AlreadyExists.into());
                }
                fs::rename(from, to)
            }
            Err(error) => Err(error.into()),
        }
    }

    fn remove_file(&self, path: &Path) -> io::Result<()> {
        fs::remove_file(path)
    }

    fn remove_dir(&self, path: &Path) -> io::Result<()> {
        fs::remove_dir(path)
    }

    fn sync_dir(&self, path: &Path) -> io::Result<()> {
        File::open(path)?.sync_all()
    }
}

/// Replaces `dir/name` as a whole: temporary file, flush, rename, flush of the directory.
/// Readers see the old contents or the new, never a part.
pub(super) fn replace(disk: &dyn Disk, dir: &Path, name: &str, bytes: &[u8]) -> io::Result<()> {
    let partial = dir.join(partial_name(name));
    let written = disk
        .write(&partial, bytes)
        .and_then(|()| disk.rename(&partial, &dir.join(name)));
    if let Err(error) = written {
        // The cause is what the caller reports; what stays here is recognised by its name.
        let _ = disk.remove_file(&partial);
        return Err(error);
    }
    disk.sync_dir(dir)
}

/// Name under which a file is written before it gets its own.
pub(super) fn partial_name(name: &str) -> String {
    format!(".{name}.partial")
}

/// Whether a file has a name given by [`partial_name`].
pub(super) fn is_partial(name: &str) -> bool {
    name.starts_with('.') && name.ends_with(".partial")
}
