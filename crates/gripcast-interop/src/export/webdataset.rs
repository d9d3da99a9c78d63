//! Tar shards with one sample per grasp: `<id>.json`, `<id>.<stage>_<role>.jpg` or `.png`.
//!
//! Readers group consecutive files by the part of their names before the first dot.

use std::fs::File;
use std::io::{BufWriter, Write as _};

use tar::{Builder, EntryType, Header};

use super::format::{ExportContext, Writer};
use super::source::Grasp;
use super::staged::write_failed;
use gripcast_base::error::{Error, Result};

/// Size of a file's header and padding, bytes.
const OVERHEAD: usize = 1024;

/// Writes the shards.
pub(super) struct TarShards<'a> {
    context: ExportContext<'a>,
    split: String,
    /// Number of shards of the split so far.
    shards: usize,
    open: Option<(Builder<BufWriter<File>>, usize)>,
}

impl<'a> TarShards<'a> {
    pub(super) fn new(context: ExportContext<'a>) -> Self {
        Self {
            context,
            split: String::new(),
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

    /// Returns the open shard, or a new one if it is full.
    fn shard(&mut self, next: usize) -> Result<&mut Builder<BufWriter<File>>> {
        let max_bytes = self.context.plan.shard_bytes;
        if self
            .open
            .as_ref()
            .is_some_and(|(_, size)| size + next > max_bytes)
        {
            self.close()?;
        }
        let (builder, size) = match self.open.take() {
            Some(open) => open,
            None => {
                let name = format!("{}-{:06}.tar", self.split, self.shards);
                self.shards += 1;
                (Builder::new(self.context.folder.file(&name)?), 0)
            }
        };
        let (builder, _) = self.open.insert((builder, size + next));
        Ok(builder)
    }
}

impl Writer for TarShards<'_> {
    fn begin_split(&mut self, split: &str) -> Result<()> {
        self.close()?;
        split.clone_into(&mut self.split);
        self.shards = 0;
        Ok(())
    }

    fn push(&mut self, grasp: Grasp) -> Result<Option<Error>> {
        let id = &grasp.record.id;
        if id.contains('.') {
            let what = "WebDataset does not support ids with a dot";
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

/// Adds a file without owner and date, so that equal grasps give equal bytes.
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
