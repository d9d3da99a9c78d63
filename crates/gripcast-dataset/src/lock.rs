//! One writer at a time.

use std::io;

use super::layout::Layout;
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::{NotLocked, OwnerLock};

/// The dataset's lock; released when dropped or when the process ends, however it ends.
#[derive(Debug)]
pub(super) struct DatasetLock {
    _lock: OwnerLock,
}

impl DatasetLock {
    /// Takes the lock.
    ///
    /// # Errors
    /// `Busy` naming the process that has it; `Permission` where the dataset cannot be written.
    pub(super) fn acquire(layout: &Layout) -> Result<Self> {
        let lock = OwnerLock::acquire(&layout.lock()).map_err(|why| match why {
            NotLocked::Held(owner) => Error::new(
                ErrorKind::Busy,
                format!("the dataset is being written by {owner}"),
            )
            .at(layout.root().display())
            .remedy("end that program first, or use another dataset"),
            NotLocked::Refused(e) => {
                Error::io("cannot lock the dataset", e).at(layout.lock().display())
            }
            NotLocked::Open(e) => not_writable(layout, e),
            NotLocked::Lock(e) => {
                Error::io("cannot lock the dataset", e).at(layout.lock().display())
            }
        })?;
        Ok(Self { _lock: lock })
    }

    /// Who writes the dataset now, if anyone.
    pub(super) fn holder(layout: &Layout) -> Option<String> {
        OwnerLock::holder(&layout.lock())
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
