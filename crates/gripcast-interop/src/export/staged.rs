//! An export directory that is renamed when complete.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use rustix::fs::{FlockOperation, flock, syncfs};
use rustix::io::Errno;

use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::{BeneathPath, Root};

/// A hidden directory beside the target, removed when dropped before the commit. Leftovers of a
/// kill are removed by the next export to the same target.
#[derive(Debug)]
pub(super) struct StagedFolder {
    root: Root,
    target: PathBuf,
    /// Holds the directory's lock, so that two exports cannot write the same target.
    folder: File,
}

impl StagedFolder {
    /// Starts an export to `target`, which must be missing or an empty directory.
    ///
    /// # Errors
    /// `Usage`: the target has no name. `Input`: the target exists. `Busy`: another export is
    /// writing it. `Permission`, `DiskFull`, `Io`: the directory.
    pub(super) fn create(target: &Path) -> Result<Self> {
        let Some(name) = target.file_name() else {
            let what = "the path of the export has no file name";
            return Err(Error::usage(what).at(target.display()));
        };
        check_free(target)?;
        let parent = Root::beside(target).shown();
        let failed = |e| Error::io("cannot create the directory", e).at(target.display());
        fs::create_dir_all(&parent).map_err(failed)?;
        let mut hidden = OsString::from(".");
        hidden.push(name);
        hidden.push(".gripcast-partial");
        let root = parent.join(hidden);
        match fs::create_dir(&root) {
            Err(error) if error.kind() != io::ErrorKind::AlreadyExists => {
                return Err(failed(error));
            }
            _ => {}
        }
        if !fs::symlink_metadata(&root).map_err(failed)?.is_dir() {
            return Err(occupied(&root));
        }
        let folder = File::open(&root).map_err(failed)?;
        // Some network file systems do not support locks.
        if let Err(Errno::WOULDBLOCK) = flock(&folder, FlockOperation::NonBlockingLockExclusive) {
            let what = "another export to this path is in progress";
            return Err(Error::new(ErrorKind::Busy, what)
                .at(target.display())
                .remedy("wait for it, or choose another `--out`"));
        }
        let staged = Self {
            root: Root::new(root),
            target: target.to_owned(),
            folder,
        };
        staged.clear().map_err(failed)?;
        Ok(staged)
    }

    /// Hidden directory with the files of the export.
    pub(super) fn root(&self) -> &Root {
        &self.root
    }

    /// Final path of the export.
    pub(super) fn target(&self) -> &Path {
        &self.target
    }

    /// Creates a file and its parent directories.
    ///
    /// # Errors
    /// Those of the operating system.
    pub(super) fn file(&self, name: &str) -> Result<BufWriter<File>> {
        let create = || {
            let path = self.root.resolve(name)?;
            path.parent().create_dir_all()?;
            path.create_new()
        };
        create().map(BufWriter::new).map_err(write_failed)
    }

    /// Creates a directory of the export.
    ///
    /// # Errors
    /// Those of the operating system.
    pub(super) fn folder(&self, path: BeneathPath) -> Result<BeneathPath> {
        path.create_dir_all().map_err(write_failed)?;
        Ok(path)
    }

    /// Writes a new file.
    ///
    /// # Errors
    /// Those of the operating system.
    pub(super) fn write(&self, name: &str, bytes: &[u8]) -> Result<()> {
        let mut file = self.file(name)?;
        let written = file.write_all(bytes).and_then(|()| file.flush());
        written.map_err(write_failed)
    }

    /// Returns the number and the total size of the files.
    ///
    /// # Errors
    /// Those of the operating system.
    pub(super) fn size(&self) -> Result<(usize, u64)> {
        let (mut files, mut bytes) = (0, 0);
        let mut folders = vec![self.root.top()];
        while let Some(folder) = folders.pop() {
            for entry in folder.entries().map_err(write_failed)? {
                let found = entry.metadata().map_err(write_failed)?;
                if found.is_dir {
                    folders.push(entry);
                } else {
                    files += 1;
                    bytes += found.bytes;
                }
            }
        }
        Ok((files, bytes))
    }

    /// Flushes the export and renames it to its target. `file`: the name of the only file, if the
    /// export is a file.
    ///
    /// # Errors
    /// `Input`: the target was created meanwhile. Those of the operating system.
    pub(super) fn commit(self, file: Option<&'static str>) -> Result<()> {
        let taken = |e: io::Error| match e.kind() {
            io::ErrorKind::AlreadyExists | io::ErrorKind::DirectoryNotEmpty => {
                occupied(&self.target)
            }
            _ => write_failed(e),
        };
        // One call for all files: an export may have many small ones.
        syncfs(&self.folder).map_err(|e| write_failed(e.into()))?;
        match file {
            None => fs::rename(self.root.path(), &self.target),
            Some(name) => {
                let file = self.root.top().join(name);
                file.rename_new(&BeneathPath::from_user_path(&self.target))
            }
        }
        .map_err(taken)?;
        // Not every file system can flush a directory, and the files themselves are safe.
        let _ = Root::beside(&self.target).sync_dir();
        Ok(())
    }

    fn clear(&self) -> io::Result<()> {
        for entry in fs::read_dir(self.root.path())? {
            let entry = entry?;
            // Links are removed, not followed.
            if entry.file_type()?.is_dir() {
                fs::remove_dir_all(entry.path())?;
            } else {
                fs::remove_file(entry.path())?;
            }
        }
        Ok(())
    }
}

impl Drop for StagedFolder {
    fn drop(&mut self) {
        // Fails after the rename, as intended.
        let _ = fs::remove_dir_all(self.root.path());
    }
}

/// Error of the operating system while writing the export.
pub(super) fn write_failed(error: io::Error) -> Error {
    Error::io("cannot write the export", error)
}

fn check_free(target: &Path) -> Result<()> {
    let is_empty_dir = || -> io::Result<bool> {
        Ok(fs::symlink_metadata(target)?.is_dir() && fs::read_dir(target)?.next().is_none())
    };
    match is_empty_dir() {
        Ok(true) => Ok(()),
        Ok(false) => Err(occupied(target)),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        Err(error) => Err(Error::io("cannot read the target", error).at(target.display())),
    }
}

fn occupied(target: &Path) -> Error {
    let what = "the target exists; an export never overwrites";
    Error::input(what)
        .at(target.display())
        .remedy("choose another `--out`, or remove it")
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;

    use super::*;

    #[test]
    fn export_is_renamed_when_complete() {
        let dir = tempfile::tempdir().unwrap();
        let target = dir.path().join("made/export");
        let staged = StagedFolder::create(&target).unwrap();
        staged.write("data/a.bin", b"abc").unwrap();
        assert!(!target.exists());
        assert_eq!(staged.size().unwrap(), (1, 3));
        let busy = StagedFolder::create(&target).unwrap_err();
        assert_eq!(busy.kind(), ErrorKind::Busy);
        staged.commit(None).unwrap();
        assert_eq!(fs::read(target.join("data/a.bin")).unwrap(), b"abc");
        assert_eq!(fs::read_dir(dir.path().join("made")).unwrap().count(), 1);
    }

    #[test]
    fn only_an_empty_directory_is_replaced() {
        let dir = tempfile::tempdir().unwrap();
        let target = dir.path().join("export");
        fs::create_dir(&target).unwrap();
        let staged = StagedFolder::create(&target).unwrap();
        staged.write("a", b"1").unwrap();
        staged.commit(None).unwrap();
        let error = StagedFolder::create(&target).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Input);
        assert!(error.remedy_text().is_some());
        // The target is created while the export is written.
        let target = dir.path().join("other.zip");
        let staged = StagedFolder::create(&target).unwrap();
        staged.write("export.zip", b"1").unwrap();
        fs::write(&target, b"mine").unwrap();
        assert_eq!(
            staged.commit(Some("export.zip")).unwrap_err().kind(),
            ErrorKind::Input
        );
        assert_eq!(fs::read(&target).unwrap(), b"mine");
    }

    #[test]
    fn links_are_not_followed() {
        let dir = tempfile::tempdir().unwrap();
        let [target, secret] = ["made", "secret"].map(|name| dir.path().join(name));
        fs::create_dir(&secret).unwrap();
        fs::write(secret.join("file"), "secret").unwrap();
        // A leftover of a kill or of a third party.
        let partial = dir.path().join(".made.gripcast-partial");
        fs::create_dir(&partial).unwrap();
        symlink(&secret, partial.join("data")).unwrap();
        let staged = StagedFolder::create(&target).unwrap();
        assert_eq!(fs::read_dir(&partial).unwrap().count(), 0);
        for name in ["../out", "/tmp/out", "data/../../out"] {
            assert!(staged.write(name, b"x").is_err(), "{name}");
        }
        symlink(&secret, partial.join("data")).unwrap();
        symlink(secret.join("file"), partial.join("file")).unwrap();
        assert!(staged.write("data/new", b"x").is_err());
        assert!(staged.write("file", b"x").is_err());
        let chunk = staged.root().top().join("data").join("chunk");
        assert!(staged.folder(chunk).is_err());
        assert_eq!(fs::read(secret.join("file")).unwrap(), b"secret");
        assert_eq!(fs::read_dir(&secret).unwrap().count(), 1);
    }

    #[test]
    fn next_export_removes_leftovers_of_a_kill() {
        let dir = tempfile::tempdir().unwrap();
        let target = dir.path().join("export");
        let staged = StagedFolder::create(&target).unwrap();
        staged.write("data/old", b"1").unwrap();
        let root = staged.root().path().to_owned();
        // As after a kill: the lock is released, the files remain.
        drop(staged);
        fs::create_dir_all(root.join("data")).unwrap();
        fs::write(root.join("data/old"), b"1").unwrap();
        let staged = StagedFolder::create(&target).unwrap();
        staged.write("new", b"2").unwrap();
        staged.commit(None).unwrap();
        let names: Vec<_> = fs::read_dir(&target)
            .unwrap()
            .map(|entry| entry.unwrap().file_name())
            .collect();
        assert_eq!(names, ["new"]);
        drop(StagedFolder::create(&dir.path().join("given-up")).unwrap());
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
    }
}
