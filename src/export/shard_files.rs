//! Parquet files of a part, whose names say how many there are.

use std::fs;
use std::path::PathBuf;

use super::staged::{StagedFolder, write_failed};
use crate::error::Result;
use crate::shard::shard_name;

/// Names for the shards of one part after the other.
#[derive(Debug)]
pub(super) struct ShardFiles<'a> {
    folder: &'a StagedFolder,
    part: String,
    /// Those of the part so far, under names for the meantime.
    written: Vec<PathBuf>,
}

impl<'a> ShardFiles<'a> {
    pub(super) fn new(folder: &'a StagedFolder) -> Self {
        Self {
            folder,
            part: String::new(),
            written: Vec::new(),
        }
    }

    /// Path of the part's next shard for the meantime.
    ///
    /// # Errors
    /// Those of the operating system.
    pub(super) fn next(&mut self) -> Result<PathBuf> {
        let data = self.folder.root().join("data");
        fs::create_dir_all(&data).map_err(write_failed)?;
        let path = data.join(format!("{}-{:05}", self.part, self.written.len()));
        self.written.push(path.clone());
        Ok(path)
    }

    /// Names the shards of the part, all of which are written.
    ///
    /// # Errors
    /// Those of the operating system.
    pub(super) fn end_part(&mut self) -> Result<()> {
        let shards = std::mem::take(&mut self.written);
        for (index, path) in shards.iter().enumerate() {
            let name = shard_name(&self.part, index, shards.len())?;
            fs::rename(path, self.folder.root().join(name)).map_err(write_failed)?;
        }
        Ok(())
    }

    /// All further shards are of this part.
    pub(super) fn begin_part(&mut self, part: &str) {
        part.clone_into(&mut self.part);
    }
}
