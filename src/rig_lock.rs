//! Lock of a rig, so that only one program uses its cameras.

use std::path::{Path, PathBuf};

use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::{NotLocked, OwnerLock};
use gripcast_capture::calibration::{RigFile, SourceKind};

/// Folder of locks of all users.
const LOCKS: &str = "/run/lock";

/// The lock of a rig.
#[derive(Debug)]
pub(crate) struct RigLock {
    _lock: OwnerLock,
}

impl RigLock {
    /// Locks a rig with real cameras. Returns none if no lock file can be created; a camera in use
    /// is then reported when it is opened.
    ///
    /// # Errors
    /// `Busy`, naming the process that uses the rig.
    pub(crate) fn acquire(rig: &RigFile) -> Result<Option<Self>> {
        let mut cameras = rig.cameras.values();
        if !cameras.any(|camera| camera.source == SourceKind::V4l2) {
            return Ok(None);
        }
        let shared = Path::new(LOCKS);
        let folder = if shared.is_dir() {
            shared.to_owned()
        } else {
            std::env::temp_dir()
        };
        Self::acquire_in(&folder, &rig.id)
    }

    fn acquire_in(folder: &Path, rig: &str) -> Result<Option<Self>> {
        let path = lock_file(folder, rig);
        let locked = match OwnerLock::acquire(&path) {
            Err(NotLocked::Open(_)) => OwnerLock::acquire_foreign(&path),
            other => other,
        };
        match locked {
            Ok(lock) => Ok(Some(Self { _lock: lock })),
            Err(NotLocked::Held(owner)) => Err(Error::new(
                ErrorKind::Busy,
                format!("the rig `{rig}` is used by {owner}"),
            )
            .at(path.display())
            .remedy("end that program first; `gripcast collect --attach` shows a running daemon")),
            Err(NotLocked::Refused(e)) => {
                Err(Error::io("cannot lock the rig", e).at(path.display()))
            }
            Err(NotLocked::Open(_) | NotLocked::Lock(_)) => Ok(None),
        }
    }
}

fn lock_file(folder: &Path, rig: &str) -> PathBuf {
    let name: String = rig
        .chars()
        .map(|c| if c.is_ascii_alphanumeric() { c } else { '-' })
        .collect();
    folder.join(format!("gripcast-rig-{name}.lock"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn second_program_sees_lock_owner() {
        let dir = tempfile::tempdir().unwrap();
        let first = RigLock::acquire_in(dir.path(), "bench/a").unwrap();
        assert!(first.is_some());
        let error = RigLock::acquire_in(dir.path(), "bench/a").unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Busy);
        assert!(error.to_string().contains(&std::process::id().to_string()));
        assert!(
            RigLock::acquire_in(dir.path(), "bench/b")
                .unwrap()
                .is_some()
        );
        drop(first);
        assert!(
            RigLock::acquire_in(dir.path(), "bench/a")
                .unwrap()
                .is_some()
        );
        let nowhere = dir.path().join("absent");
        assert!(RigLock::acquire_in(&nowhere, "bench/a").unwrap().is_none());
    }

    #[test]
    fn virtual_rig_needs_no_lock() {
        assert!(RigLock::acquire(&RigFile::virtual_rig()).unwrap().is_none());
    }
}
