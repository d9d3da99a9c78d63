//! A file that is written piece by piece and gets its name last.

use std::fs::File;
use std::io::{self, Write};

use gripcast_base::files::BeneathPath;

/// A file under a hidden name in the folder of its own; removed when dropped before
/// [`commit`](Self::commit).
#[derive(Debug)]
pub(super) struct StagedShard {
    file: File,
    partial: BeneathPath,
    target: BeneathPath,
}

impl StagedShard {
    /// # Errors
    /// Those of the operating system; the target being a folder.
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

    /// Gives the file its name once its contents are on the disk; a link is replaced.
    ///
    /// # Errors
    /// Those of the operating system; what had the name before is then as it was.
    pub(super) fn commit(self) -> io::Result<()> {
        self.file.sync_all()?;
        self.partial.rename(&self.target)?;
        // Not every file system can do this to a folder, and the file itself is safe.
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
        // After the renaming there is none any more; the cause is what the caller reports.
        let _ = self.partial.remove_file();
    }
}
