//! An export that gets its name when it is whole.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use rustix::fs::{CWD, FlockOperation, RenameFlags, flock, renameat_with, syncfs};
use rustix::io::Errno;

use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::{BeneathPath, Root};

/// A hidden folder beside the target. It is removed when dropped before the commit; what a kill
/// leaves behind is removed by the next export to the same target.
#[derive(Debug)]
pub(super) struct StagedFolder {
    root: Root,
    target: PathBuf,
    /// Holds the folder's lock, so that two exports do not write one target.
    folder: File,
}

impl StagedFolder {
    /// Begins an export to `target`, which must not be there or be an empty folder.
    ///
    /// # Errors
    /// `Usage`: the target has no name. `Input`: something is there. `Busy`: another export is
    /// writing it. `Permission`, `DiskFull`, `Io`: the folder.
    pub(super) fn create(target: &Path) -> Result<Self> {
        let Some(name) = target.file_name() else {
            let what = "the export needs a name of its own";
            return Err(Error::usage(what).at(target.display()));
        };
        check_free(target)?;
        let parent = parent(target);
        let failed = |e| Error::io("cannot make the folder", e).at(target.display());
        fs::create_dir_all(parent).map_err(failed)?;
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
        // Some network file systems have no locks.
        if let Err(Errno::WOULDBLOCK) = flock(&folder, FlockOperation::NonBlockingLockExclusive) {
            let what = "another export to this place is under way";
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

    /// Where the files of the export are until the commit.
    pub(super) fn root(&self) -> &Root {
        &self.root
    }

    /// The name that the export will have.
    pub(super) fn target(&self) -> &Path {
        &self.target
    }

    /// A new file, and the folders on the way to it.
    ///
    /// # Errors
    /// Those of the operating system.
    pub(super) fn file(&self, name: &str) -> Result<BufWriter<File>> {
        let create = || {
            let place = self.root.resolve(name)?;
            place.parent().create_dir_all()?;
            place.create_new()
        };
        create().map(BufWriter::new).map_err(write_failed)
    }

    /// A folder of the export, which is made.
    ///
    /// # Errors
    /// Those of the operating system.
    pub(super) fn folder(&self, place: BeneathPath) -> Result<BeneathPath> {
        place.create_dir_all().map_err(write_failed)?;
        Ok(place)
    }

    /// A new file with its contents.
    ///
    /// # Errors
    /// Those of the operating system.
    pub(super) fn write(&self, name: &str, bytes: &[u8]) -> Result<()> {
        let mut file = self.file(name)?;
        let written = file.write_all(bytes).and_then(|()| file.flush());
        written.map_err(write_failed)
    }

    /// Number and size of the files.
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

    /// Gives the export its name, once all of it is on the disk. `file`: the only file in it, if
    /// the export is that file and no folder.
    ///
    /// # Errors
    /// `Input`: something has appeared there. Those of the operating system.
    pub(super) fn commit(self, file: Option<&'static str>) -> Result<()> {
        let taken = |e: io::Error| match e.kind() {
            io::ErrorKind::AlreadyExists | io::ErrorKind::DirectoryNotEmpty => {
                occupied(&self.target)
            }
            _ => write_failed(e),
        };
        // One call for all files: an export may have very many small ones.
        syncfs(&self.folder).map_err(|e| write_failed(e.into()))?;
        match file {
            None => fs::rename(self.root.path(), &self.target).map_err(taken)?,
            Some(name) => {
                rename_new(&self.root.path().join(name), &self.target).map_err(taken)?;
            }
        }
        // Not every file system can do this to a folder, and the files themselves are safe.
        if let Ok(parent) = File::open(parent(&self.target)) {
            let _ = parent.sync_all();
        }
        Ok(())
    }

    fn clear(&self) -> io::Result<()> {
        for entry in fs::read_dir(self.root.path())? {
            let entry = entry?;
            // Of a link the link.
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
        // After the renaming there is none any more; the cause is what the caller reports.
        let _ = fs::remove_dir_all(self.root.path());
    }
}

/// `DiskFull`, `Io`, …: the export cannot be written.
pub(super) fn write_failed(error: io::Error) -> Error {
    Error::io("cannot write the export", error)
}

fn check_free(target: &Path) -> Result<()> {
    match fs::symlink_metadata(target) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        Err(error) => Err(Error::io("cannot look at the target", error).at(target.display())),
        Ok(found) if found.is_dir() => {
            let mut entries = fs::read_dir(target)
                .map_err(|e| Error::io("cannot look at the target", e).at(target.display()))?;
            match entries.next() {
                None => Ok(()),
                Some(_) => Err(occupied(target)),
            }
        }
        Ok(_) => Err(occupied(target)),
    }
}

fn occupied(target: &Path) -> Error {
    let what = "there is something already; an export never replaces anything";
    Error::input(what)
        .at(target.display())
        .remedy("choose another `--out`, or remove what is there")
}

/// Renames; fails with `AlreadyExists` where the new name is taken.
fn rename_new(from: &Path, to: &Path) -> io::Result<()> {
    match renameat_with(CWD, from, CWD, to, RenameFlags::NOREPLACE) {
        // Some network and FAT file systems lack the flag: looking first is the best there.
        Err(Errno::INVAL | Errno::NOSYS) => {
            if to.symlink_metadata().is_ok() {
                return Err(io::ErrorKind::AlreadyExists.into());
            }
            fs::rename(from, to)
        }
        other => other.map_err(io::Error::from),
    }
}

/// The folder of a path; of a bare name the present one.
fn parent(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;

    use super::*;

    #[test]
    fn an_export_has_its_name_when_it_is_whole() {
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
    fn an_empty_folder_may_be_there_and_nothing_else() {
        let dir = tempfile::tempdir().unwrap();
        let target = dir.path().join("export");
        fs::create_dir(&target).unwrap();
        let staged = StagedFolder::create(&target).unwrap();
        staged.write("a", b"1").unwrap();
        staged.commit(None).unwrap();
        let error = StagedFolder::create(&target).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Input);
        assert!(error.remedy_text().is_some());
        // It appears while the export is written.
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
    fn no_file_is_written_outside_and_no_link_is_followed() {
        let dir = tempfile::tempdir().unwrap();
        let [target, secret] = ["made", "secret"].map(|name| dir.path().join(name));
        fs::create_dir(&secret).unwrap();
        fs::write(secret.join("file"), "secret").unwrap();
        // What a kill, or somebody else, left.
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
        let place = staged.root().top().join("data").join("chunk");
        assert!(staged.folder(place).is_err());
        assert_eq!(fs::read(secret.join("file")).unwrap(), b"secret");
        assert_eq!(fs::read_dir(&secret).unwrap().count(), 1);
    }

    #[test]
    fn what_a_kill_left_is_gone_with_the_next_attempt() {
        let dir = tempfile::tempdir().unwrap();
        let target = dir.path().join("export");
        let staged = StagedFolder::create(&target).unwrap();
        staged.write("data/old", b"1").unwrap();
        let root = staged.root().path().to_owned();
        // As a kill does: the lock goes, the files stay.
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
