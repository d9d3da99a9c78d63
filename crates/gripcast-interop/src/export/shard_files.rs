//! Parquet files of a part, whose names say how many there are.

use super::staged::{StagedFolder, write_failed};
use gripcast_base::error::Result;
use gripcast_base::files::{BeneathPath, FileName};
use gripcast_dataset::shard::shard_place;

/// Names for the shards of one part after the other.
#[derive(Debug)]
pub(super) struct ShardFiles<'a> {
    folder: &'a StagedFolder,
    part: String,
    /// Those of the part so far, under names for the meantime.
    written: Vec<BeneathPath>,
}

impl<'a> ShardFiles<'a> {
    pub(super) fn new(folder: &'a StagedFolder) -> Self {
        Self {
            folder,
            part: String::new(),
            written: Vec::new(),
        }
    }

    /// Place of the part's next shard for the meantime.
    ///
    /// # Errors
    /// Those of the operating system.
    pub(super) fn next(&mut self) -> Result<BeneathPath> {
        let data = self.folder.folder(self.folder.root().top().join("data"))?;
        let name = format!("{}-{:05}", self.part, self.written.len());
        let place = data.join(&FileName::parse(&name)?);
        self.written.push(place.clone());
        Ok(place)
    }

    /// Names the shards of the part, all of which are written.
    ///
    /// # Errors
    /// Those of the operating system.
    pub(super) fn end_part(&mut self) -> Result<()> {
        let shards = std::mem::take(&mut self.written);
        for (index, written) in shards.iter().enumerate() {
            let place = shard_place(self.folder.root(), &self.part, index, shards.len())?;
            written.rename(&place).map_err(write_failed)?;
        }
        Ok(())
    }

    /// All further shards are of this part.
    pub(super) fn begin_part(&mut self, part: &str) {
        part.clone_into(&mut self.part);
    }
}
