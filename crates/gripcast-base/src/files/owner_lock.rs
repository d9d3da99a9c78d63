//! A lock file that names its holder.

use std::fs::{File, TryLockError};
use std::io::{self, Read as _, Seek as _, Write as _};
use std::path::Path;

use rustix::fs::CWD;

use super::opening::open_lock;
use crate::error::Refused;

/// Maximum length of the owner line, bytes.
const MAX_OWNER: u64 = 4096;

/// A locked file; released when dropped or when the process ends for any reason.
#[derive(Debug)]
pub struct OwnerLock {
    _file: File,
}

/// Reason why a lock was not acquired.
#[derive(Debug)]
pub enum NotLocked {
    /// Another process holds it; its description.
    Held(String),
    /// It is a link, has other hard links, or is not a regular file: writing would change another
    /// file.
    Refused(io::Error),
    /// The file cannot be opened.
    Open(io::Error),
    /// The file cannot be locked.
    Lock(io::Error),
}

impl OwnerLock {
    /// Acquires the lock and writes this process into it.
    ///
    /// # Errors
    /// [`NotLocked`] with the reason.
    pub fn acquire(path: &Path) -> Result<Self, NotLocked> {
        let mut file = open_lock(CWD, path, true).map_err(not_opened)?;
        lock(&mut file)?;
        // The owner is only for messages; the lock works without it.
        let _ = file.set_len(0).and_then(|()| file.rewind()).and_then(|()| {
            let command: Vec<String> = std::env::args_os()
                .map(|arg| arg.to_string_lossy().into_owned())
                .collect();
            writeln!(file, "{} {}", std::process::id(), command.join(" "))
        });
        Ok(Self { _file: file })
    }

    /// Acquires a lock file of another user without write permission.
    ///
    /// # Errors
    /// [`NotLocked`] with the reason.
    pub fn acquire_foreign(path: &Path) -> Result<Self, NotLocked> {
        let mut file = open_lock(CWD, path, false).map_err(not_opened)?;
        lock(&mut file)?;
        Ok(Self { _file: file })
    }

    /// Description of the current holder, if any.
    #[must_use]
    pub fn holder(path: &Path) -> Option<String> {
        let mut file = open_lock(CWD, path, false).ok()?;
        match file.try_lock_shared() {
            Err(TryLockError::WouldBlock) => Some(owner(&mut file)),
            Ok(()) | Err(TryLockError::Error(_)) => None,
        }
    }
}

fn not_opened(error: io::Error) -> NotLocked {
    if error.get_ref().is_some_and(|e| e.is::<Refused>()) {
        NotLocked::Refused(error)
    } else {
        NotLocked::Open(error)
    }
}

fn lock(file: &mut File) -> Result<(), NotLocked> {
    match file.try_lock() {
        Ok(()) => Ok(()),
        Err(TryLockError::WouldBlock) => Err(NotLocked::Held(owner(file))),
        Err(TryLockError::Error(e)) => Err(NotLocked::Lock(e)),
    }
}

fn owner(file: &mut File) -> String {
    let mut text = String::new();
    let read = file.take(MAX_OWNER).read_to_string(&mut text);
    match text.trim().split_once(' ') {
        Some((pid, command)) if read.is_ok() => format!("process {pid} (`{command}`)"),
        _ => "another process".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn linked_lock_file_is_refused_and_unchanged() {
        use std::os::unix::fs::symlink;
        let dir = tempfile::tempdir().unwrap();
        let [target, lock] = ["target", "lock"].map(|name| dir.path().join(name));
        std::fs::write(&target, "precious").unwrap();
        let is_refused = || {
            [OwnerLock::acquire(&lock), OwnerLock::acquire_foreign(&lock)]
                .iter()
                .all(|locked| matches!(locked, Err(NotLocked::Refused(_))))
        };
        symlink(&target, &lock).unwrap();
        assert!(is_refused());
        std::fs::remove_file(&lock).unwrap();
        std::fs::hard_link(&target, &lock).unwrap();
        assert!(is_refused());
        assert_eq!(std::fs::read(&target).unwrap(), b"precious");
        std::fs::remove_file(&lock).unwrap();
        symlink(dir.path().join("none"), &lock).unwrap();
        assert!(is_refused());
        assert!(!dir.path().join("none").exists());
    }

    #[test]
    fn second_lock_names_the_holder() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("lock");
        assert_eq!(OwnerLock::holder(&path), None);
        let first = OwnerLock::acquire(&path).unwrap();
        let pid = std::process::id().to_string();
        for again in [OwnerLock::acquire(&path), OwnerLock::acquire_foreign(&path)] {
            let Err(NotLocked::Held(owner)) = again else {
                panic!("locked twice: {again:?}");
            };
            assert!(owner.contains(&pid), "{owner}");
        }
        assert!(OwnerLock::holder(&path).unwrap().contains(&pid));
        drop(first);
        assert_eq!(OwnerLock::holder(&path), None);
        OwnerLock::acquire_foreign(&path).unwrap();
    }
}
