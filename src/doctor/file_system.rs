//! What the file system of the dataset can do, of the operations that the writer uses.

use std::fs::File;
use std::io;
use std::os::unix::fs::MetadataExt as _;
use std::path::Path;

use super::{CheckStatus, Finding};
use gripcast_base::error::Error;
use gripcast_base::files::{BeneathPath, NotLocked, OwnerLock, Root, disk_remedy};

/// Result of each operation.
#[derive(Debug)]
struct Abilities {
    /// Whether directories are flushed.
    flush: io::Result<bool>,
    hard_link: io::Result<()>,
    /// Renames a directory, and refuses to where the new name exists.
    rename: io::Result<()>,
    /// Locks a file against a second writer.
    lock: io::Result<()>,
}

impl Abilities {
    /// Tries the operations in an empty directory.
    fn try_in(dir: &Path) -> Self {
        let top = Root::new(dir).top();
        Self {
            flush: top.can_sync_dir(),
            hard_link: hard_link(&top),
            rename: rename(&top),
            lock: lock(&dir.join("lock")),
        }
    }

    fn findings(self) -> Vec<Finding> {
        let mut findings = Vec::new();
        match self.flush {
            Ok(true) => {}
            Ok(false) => findings.push(
                Finding::new(
                    "disk",
                    "flush",
                    CheckStatus::Warn,
                    "this file system cannot flush directories: a power failure can lose the \
                     grasps of the last seconds",
                )
                .remedy("use a local disk (ext4, XFS, Btrfs), or a computer with a battery"),
            ),
            Err(error) => findings.push(failed("flush", "cannot flush a directory", error)),
        }
        if let Err(error) = self.rename {
            findings.push(failed("rename", "cannot rename a directory", error));
        }
        if let Err(error) = self.lock {
            findings.push(failed("lock", "cannot lock a file", error));
        }
        let links = match self.hard_link {
            Ok(()) => "hard links".to_owned(),
            Err(error) => format!("no hard links ({error}), an undo copies the images"),
        };
        if findings.is_empty() {
            let found = format!("flushing directories, renaming and locks work; {links}");
            findings.push(Finding::new("disk", "operations", CheckStatus::Ok, found));
        }
        findings
    }
}

fn failed(name: &str, what: &str, error: io::Error) -> Finding {
    let remedy = disk_remedy(&error);
    let error = Error::io(what, error);
    let error = error.remedy(remedy.unwrap_or("choose a dataset on another disk"));
    Finding::failed("disk", name, &error)
}

fn hard_link(top: &BeneathPath) -> io::Result<()> {
    let file = top.join("file");
    file.write(b"x")?;
    file.hard_link(&top.join("link"))
}

fn rename(top: &BeneathPath) -> io::Result<()> {
    let [old, new, other] = ["old", "new", "other"].map(|name| top.join(name));
    old.create_dir()?;
    old.rename_new(&new)?;
    other.create_dir()?;
    match other.rename_new(&new) {
        Err(e) if e.kind() == io::ErrorKind::AlreadyExists => Ok(()),
        Err(e) => Err(e),
        Ok(()) => Err(io::Error::other("a rename replaced a directory")),
    }
}

fn lock(path: &Path) -> io::Result<()> {
    let io_error = |why| match why {
        NotLocked::Held(owner) => io::Error::other(format!("it is held by {owner}")),
        NotLocked::Refused(e) | NotLocked::Open(e) | NotLocked::Lock(e) => e,
    };
    let _held = OwnerLock::acquire(path).map_err(io_error)?;
    match OwnerLock::acquire(path) {
        Err(NotLocked::Held(_)) => Ok(()),
        Err(why) => Err(io_error(why)),
        Ok(_) => Err(io::Error::other("a locked file was locked again")),
    }
}

/// Tries the writer's operations in `dir`, an empty directory on the dataset's disk.
pub(super) fn findings(dir: &Path) -> Vec<Finding> {
    Abilities::try_in(dir).findings()
}

/// Says whether `trash/` of an existing dataset is on another disk than `grasps/`.
pub(super) fn trash_finding(dataset: &Path) -> Option<Finding> {
    let device = |folder: &str| {
        let dir = File::open(dataset.join(folder)).ok()?;
        Some(dir.metadata().ok()?.dev())
    };
    (device("grasps")? != device("trash")?).then(|| {
        let found = "grasps/ and trash/ are on different disks: undo and discard copy the files";
        Finding::new("disk", "trash", CheckStatus::Ok, found)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustix::io::Errno;

    fn able() -> Abilities {
        Abilities {
            flush: Ok(true),
            hard_link: Ok(()),
            rename: Ok(()),
            lock: Ok(()),
        }
    }

    #[test]
    fn local_disk_passes() {
        let dir = tempfile::tempdir().unwrap();
        let found = findings(dir.path());
        assert_eq!(found.len(), 1, "{found:?}");
        assert_eq!(found[0].status, CheckStatus::Ok, "{found:?}");
        assert!(found[0].message.contains("locks work; hard links"));
    }

    #[test]
    fn each_missing_operation_is_named_with_its_cause() {
        let error = |errno: Errno| io::Error::from(errno);
        let cannot_flush = Abilities {
            flush: Ok(false),
            ..able()
        };
        let cannot_lock = Abilities {
            lock: Err(error(Errno::NOLCK)),
            ..able()
        };
        let cannot_rename = Abilities {
            rename: Err(error(Errno::OPNOTSUPP)),
            ..able()
        };
        for (abilities, name, status, remedy) in [
            (cannot_flush, "flush", CheckStatus::Warn, "local disk"),
            (cannot_lock, "lock", CheckStatus::Fail, "lock service"),
            (cannot_rename, "rename", CheckStatus::Fail, "local disk"),
        ] {
            let found = abilities.findings();
            assert_eq!(found.len(), 1, "{found:?}");
            assert_eq!((found[0].name.as_str(), found[0].status), (name, status));
            let text = found[0].remedy.as_deref().unwrap_or_default();
            assert!(text.contains(remedy), "{found:?}");
        }
        let cannot_link = Abilities {
            hard_link: Err(error(Errno::PERM)),
            ..able()
        };
        let found = cannot_link.findings();
        assert_eq!(found[0].status, CheckStatus::Ok);
        assert!(found[0].message.contains("an undo copies the images"));
    }
}
