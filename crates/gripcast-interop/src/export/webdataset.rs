//! Tar shards, a sample a grasp: `<id>.json`, `<id>.<stage>_<role>.jpg` or `.png`.
//!
//! Readers group neighbouring files by what precedes the first dot of their names.

use std::fs::File;
use std::io::{BufWriter, Write as _};

use tar::{Builder, EntryType, Header};

use super::format::{Setting, Writer};
use super::source::Grasp;
use super::staged::write_failed;
use gripcast_base::error::{Error, Result};

/// A file's header, the padding after its contents.
const OVERHEAD: usize = 1024;

/// Writes the shards.
pub(super) struct TarShards<'a> {
    setting: Setting<'a>,
    part: String,
    /// Shards of the part so far.
    shards: usize,
    open: Option<(Builder<BufWriter<File>>, usize)>,
}

impl<'a> TarShards<'a> {
    pub(super) fn new(setting: Setting<'a>) -> Self {
        Self {
            setting,
            part: String::new(),
            shards: 0,
            open: None,
        }
    }

    fn close(&mut self) -> Result<()> {
        let Some((builder, _)) = self.open.take() else {
            return Ok(());
        };
        let closed = builder.into_inner().and_then(|mut file| file.flush());
        closed.map_err(write_failed)
    }

    /// The open shard, a new one where the last is full.
    fn shard(&mut self, next: usize) -> Result<&mut Builder<BufWriter<File>>> {
        let most = self.setting.plan.shard_bytes;
        if self
            .open
            .as_ref()
            .is_some_and(|(_, size)| size + next > most)
        {
            self.close()?;
        }
        let (builder, size) = match self.open.take() {
            Some(open) => open,
            None => {
                let name = format!("{}-{:06}.tar", self.part, self.shards);
                self.shards += 1;
                (Builder::new(self.setting.folder.file(&name)?), 0)
            }
        };
        let (builder, _) = self.open.insert((builder, size + next));
        Ok(builder)
    }
}

impl Writer for TarShards<'_> {
    fn begin_part(&mut self, part: &str) -> Result<()> {
        self.close()?;
        part.clone_into(&mut self.part);
        self.shards = 0;
        Ok(())
    }

    fn push(&mut self, grasp: Grasp) -> Result<Option<Error>> {
        let id = &grasp.record.id;
        if id.contains('.') {
            let what = "the id has a dot, by which WebDataset would cut it";
            return Ok(Some(Error::input(what)));
        }
        let size = grasp.bytes() + OVERHEAD * (1 + grasp.images.len());
        let builder = self.shard(size)?;
        append(builder, &format!("{id}.json"), &grasp.json)?;
        for ((stage, role), image) in &grasp.images {
            let name = format!("{id}.{}_{role}.{}", stage.name(), image.extension());
            append(builder, &name, &image.bytes)?;
        }
        Ok(None)
    }

    fn finish(mut self: Box<Self>) -> Result<Vec<String>> {
        self.close()?;
        Ok(Vec::new())
    }
}

/// Adds a file that belongs to nobody and has no date, so that the same grasps are the same bytes.
fn append(builder: &mut Builder<BufWriter<File>>, name: &str, bytes: &[u8]) -> Result<()> {
    let mut header = Header::new_ustar();
    header.set_entry_type(EntryType::Regular);
    header.set_size(bytes.len() as u64);
    header.set_mode(0o644);
    header.set_mtime(0);
    header.set_uid(0);
    header.set_gid(0);
    let appended = builder.append_data(&mut header, name, bytes);
    appended.map_err(write_failed)
}
