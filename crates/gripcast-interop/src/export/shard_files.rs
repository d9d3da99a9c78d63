//! Shards of a split, whose names contain their number.

use super::staged::{StagedFolder, write_failed};
use gripcast_base::error::Result;
use gripcast_base::files::{BeneathPath, FileName};
use gripcast_dataset::shard::shard_path;

/// Names the shards of one split after the other.
#[derive(Debug)]
pub(super) struct ShardFiles<'a> {
    folder: &'a StagedFolder,
    split: String,
    /// Shards of the split so far, under temporary names.
    written: Vec<BeneathPath>,
}

impl<'a> ShardFiles<'a> {
    pub(super) fn new(folder: &'a StagedFolder) -> Self {
        Self {
            folder,
            split: String::new(),
            written: Vec::new(),
        }
    }

    /// Temporary path of the next shard of the split.
    ///
    /// # Errors
    /// Those of the operating system.
    pub(super) fn next(&mut self) -> Result<BeneathPath> {
        let data = self.folder.folder(self.folder.root().top().join("data"))?;
        let name = format!("{}-{:05}", self.split, self.written.len());
        let path = data.join(&FileName::parse(&name)?);
        self.written.push(path.clone());
        Ok(path)
    }

    /// Renames the written shards of the split to their final names.
    ///
    /// # Errors
    /// Those of the operating system.
    pub(super) fn end_split(&mut self) -> Result<()> {
        let shards = std::mem::take(&mut self.written);
        for (index, written) in shards.iter().enumerate() {
            let path = shard_path(self.folder.root(), &self.split, index, shards.len())?;
            written.rename(&path).map_err(write_failed)?;
        }
        Ok(())
    }

    /// Starts a split, to which the following shards belong.
    pub(super) fn begin_split(&mut self, split: &str) {
        split.clone_into(&mut self.split);
    }
}
