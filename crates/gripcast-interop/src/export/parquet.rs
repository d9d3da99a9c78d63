//! Parquet shards with one row per grasp: the columns of `metadata.jsonl`, and the images.

use std::borrow::Cow;

use serde_json::json;

use super::facts::{FACTS, facts};
use super::format::{ExportContext, Writer};
use super::shard_files::ShardFiles;
use super::source::Grasp;
use gripcast_base::error::{Error, Result};
use gripcast_dataset::Stage;
use gripcast_dataset::shard::{ColumnType, EXPORT, TableCell, TableWriter};
use gripcast_imaging::Role;

/// Version of the columns.
const VERSION: u32 = 1;
/// Writes the shards.
pub(super) struct ParquetShards<'a> {
    context: ExportContext<'a>,
    images: Vec<(Stage, Role)>,
    metadata: String,
    files: ShardFiles<'a>,
    open: Option<TableWriter>,
}

impl<'a> ParquetShards<'a> {
    pub(super) fn new(context: ExportContext<'a>) -> Self {
        let descriptor = context.descriptor;
        let metadata = json!({
            "format": EXPORT,
            "version": VERSION,
            "dataset": descriptor.name,
            "licence": descriptor.licence,
            "label_definition": descriptor.label_definition,
        });
        Self {
            context,
            images: context.survey.cameras.keys().copied().collect(),
            metadata: metadata.to_string(),
            files: ShardFiles::new(context.folder),
            open: None,
        }
    }

    /// Returns the open shard, or a new one if it is full.
    fn shard(&mut self, next: usize) -> Result<&mut TableWriter> {
        let max_bytes = self.context.plan.shard_bytes;
        let open = match self.open.take() {
            Some(full) if full.bytes() + next > max_bytes => {
                full.finish()?;
                self.create()?
            }
            Some(open) => open,
            None => self.create()?,
        };
        Ok(self.open.insert(open))
    }

    fn create(&mut self) -> Result<TableWriter> {
        let path = self.files.next()?;
        let facts = FACTS.iter().map(|(name, kind)| ((*name).to_owned(), *kind));
        let images = self.images.iter().map(|(stage, role)| {
            let name = format!("{}_{role}", stage.name());
            (name, ColumnType::Image)
        });
        let metadata = [("gripcast", self.metadata.clone())];
        TableWriter::create(path, facts.chain(images).collect(), &metadata)
    }

    fn end_split(&mut self) -> Result<()> {
        if let Some(open) = self.open.take() {
            open.finish()?;
        }
        self.files.end_split()
    }
}

impl Writer for ParquetShards<'_> {
    fn begin_split(&mut self, split: &str) -> Result<()> {
        self.end_split()?;
        self.files.begin_split(split);
        Ok(())
    }

    fn push(&mut self, mut grasp: Grasp) -> Result<Option<Error>> {
        let size = grasp.bytes();
        let mut cells = facts(&grasp);
        for kind in &self.images {
            cells.push(match grasp.images.remove(kind) {
                Some(image) => TableCell::Image(Cow::Owned(image.bytes)),
                None => TableCell::Null,
            });
        }
        self.shard(size)?.push(cells)?;
        Ok(None)
    }

    fn finish(mut self: Box<Self>) -> Result<Vec<String>> {
        self.end_split()?;
        Ok(Vec::new())
    }
}
