//! Lock that admits one writer at a time.

use super::layout::Layout;
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::{NotLocked, OwnerLock};

/// The dataset's lock; released when dropped or when the process ends for any reason.
#[derive(Debug)]
pub(super) struct DatasetLock {
    _lock: OwnerLock,
}

impl DatasetLock {
    /// Takes the lock.
    ///
    /// # Errors
    /// `Busy` naming the process that holds it; `Permission` where the dataset is not writable.
    pub(super) fn acquire(layout: &Layout) -> Result<Self> {
        let lock = OwnerLock::acquire(&layout.lock()).map_err(|why| match why {
            NotLocked::Held(owner) => Error::new(
                ErrorKind::Busy,
                format!("the dataset is being written by {owner}"),
            )
            .at(layout.root().display())
            .remedy("quit that program first, or use another dataset"),
            NotLocked::Open(e) => layout.failed("cannot write to the dataset", e),
            NotLocked::Refused(e) | NotLocked::Lock(e) => {
                Layout::failed_at(&layout.lock(), "cannot lock the dataset", e)
            }
        })?;
        Ok(Self { _lock: lock })
    }

    /// Returns the process that is writing the dataset, if any.
    pub(super) fn holder(layout: &Layout) -> Option<String> {
        OwnerLock::holder(&layout.lock())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn second_lock_names_the_holder() {
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
