//! A file that is written incrementally and renamed when complete.

use std::fs::File;
use std::io::{self, Write};

use gripcast_base::files::BeneathPath;

/// A file under a hidden temporary name; removed when dropped before
/// [`commit`](Self::commit).
#[derive(Debug)]
pub(super) struct StagedShard {
    file: File,
    partial: BeneathPath,
    target: BeneathPath,
}

impl StagedShard {
    /// # Errors
    /// Those of the operating system; `IsADirectory` for a directory.
    pub(super) fn create(target: &BeneathPath) -> io::Result<Self> {
        if target.is_dir() {
            return Err(io::ErrorKind::IsADirectory.into());
        }
        let partial = target.partial();
        Ok(Self {
            file: partial.create_new()?,
            partial,
            target: target.clone(),
        })
    }

    /// Flushes the file and renames it to its target; a link is replaced.
    ///
    /// # Errors
    /// Those of the operating system; the target is then unchanged.
    pub(super) fn commit(self) -> io::Result<()> {
        self.file.sync_all()?;
        self.partial.rename(&self.target)?;
        // Not every file system can flush a directory, and the file itself is safe.
        let _ = self.target.parent().sync_dir();
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
        // Fails after the rename, as intended.
        let _ = self.partial.remove_file();
    }
}
