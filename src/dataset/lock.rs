//! One writer at a time.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, Read as _, Seek as _, Write as _};

use super::layout::Layout;
use crate::error::{Error, ErrorKind, Result};

/// The dataset's lock; released when dropped or when the process ends, however it ends.
#[derive(Debug)]
pub(super) struct DatasetLock {
    _file: File,
}

impl DatasetLock {
    /// Takes the lock.
    ///
    /// # Errors
    /// `Busy` naming the process that has it; `Permission` where the dataset cannot be written.
    pub(super) fn acquire(layout: &Layout) -> Result<Self> {
        let mut file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(layout.lock())
            .map_err(|e| not_writable(layout, e))?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                let owner = owner(&mut file);
                return Err(Error::new(
                    ErrorKind::Busy,
                    format!("the dataset is being written by {owner}"),
                )
                .at(layout.root().display())
                .remedy("end that program first, or use another dataset"));
            }
            Err(TryLockError::Error(e)) => {
                return Err(Error::io("cannot lock the dataset", e).at(layout.lock().display()));
            }
        }
        // The owner's name only helps the message above; the lock itself holds without it.
        let _ = file.set_len(0).and_then(|()| file.rewind()).and_then(|()| {
            let command: Vec<String> = std::env::args_os()
                .map(|arg| arg.to_string_lossy().into_owned())
                .collect();
            writeln!(file, "{} {}", std::process::id(), command.join(" "))
        });
        Ok(Self { _file: file })
    }

    /// Who writes the dataset now, if anyone.
    pub(super) fn holder(layout: &Layout) -> Option<String> {
        let mut file = File::open(layout.lock()).ok()?;
        match file.try_lock_shared() {
            Err(TryLockError::WouldBlock) => Some(owner(&mut file)),
            Ok(()) | Err(TryLockError::Error(_)) => None,
        }
    }
}

fn owner(file: &mut File) -> String {
    let mut text = String::new();
    let read = file.take(4096).read_to_string(&mut text);
    match text.trim().split_once(' ') {
        Some((pid, command)) if read.is_ok() => format!("process {pid} (`{command}`)"),
        _ => "another process".to_owned(),
    }
}

fn not_writable(layout: &Layout, error: io::Error) -> Error {
    let root = layout.root().display().to_string();
    let remedy = match error.kind() {
        io::ErrorKind::ReadOnlyFilesystem => {
            "the disk is mounted read-only: mount it writable, or use another place"
        }
        io::ErrorKind::PermissionDenied => {
            "you may not write there: change the owner or the rights of the directory, or use \
             another place"
        }
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            "the disk is full: free some space, or use another disk"
        }
        _ => "check that the disk is still there and can be written",
    };
    Error::io("cannot write to the dataset", error)
        .at(root)
        .remedy(remedy)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_second_writer_learns_who_the_first_is() {
        let dir = tempfile::tempdir().unwrap();
        let layout = Layout::new(dir.path());
        assert_eq!(DatasetLock::holder(&layout), None);
        let first = DatasetLock::acquire(&layout).unwrap();
        let error = DatasetLock::acquire(&layout).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Busy);
        let pid = std::process::id().to_string();
        assert!(error.to_string().contains(&pid), "{error}");
        assert!(DatasetLock::holder(&layout).unwrap().contains(&pid));
        drop(first);
        assert_eq!(DatasetLock::holder(&layout), None);
        DatasetLock::acquire(&layout).unwrap();
    }
}
