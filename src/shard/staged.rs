//! A file that is written piece by piece and gets its name last.

use std::fs::{self, File, OpenOptions};
use std::hash::{BuildHasher as _, RandomState};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// A file under a hidden name in the folder of its own; removed when dropped before
/// [`commit`](Self::commit).
#[derive(Debug)]
pub(super) struct StagedShard {
    file: File,
    partial: PathBuf,
    target: PathBuf,
}

impl StagedShard {
    /// # Errors
    /// Those of the operating system; the target being a folder.
    pub(super) fn create(target: &Path) -> io::Result<Self> {
        if target.is_dir() {
            return Err(io::ErrorKind::IsADirectory.into());
        }
        // By chance: a number of the process comes again, and with it what a kill left behind.
        let name = format!(".gripcast-{:016x}.partial", RandomState::new().hash_one(()));
        let partial = target.with_file_name(name);
        let file = OpenOptions::new()
            .write(true)
            .create_new(true)
            .open(&partial)?;
        Ok(Self {
            file,
            partial,
            target: target.to_owned(),
        })
    }

    /// Gives the file its name once its contents are on the disk.
    ///
    /// # Errors
    /// Those of the operating system; what had the name before is then as it was.
    pub(super) fn commit(self) -> io::Result<()> {
        self.file.sync_all()?;
        fs::rename(&self.partial, &self.target)?;
        // Not every file system can do this to a folder, and the file itself is safe.
        let folder = self.target.parent().filter(|f| !f.as_os_str().is_empty());
        if let Ok(folder) = File::open(folder.unwrap_or(Path::new("."))) {
            let _ = folder.sync_all();
        }
        Ok(())
    }
}

impl Write for StagedShard {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Drop for StagedShard {
    fn drop(&mut self) {
        // After the renaming there is none any more; the cause is what the caller reports.
        let _ = fs::remove_file(&self.partial);
    }
}
