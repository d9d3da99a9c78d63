//! Parquet shards with one row per grasp: the columns of `metadata.jsonl`, and the images.

use std::borrow::Cow;

use serde_json::json;

use super::facts::{FACTS, facts};
use super::format::{ExportContext, Writer};
use super::shard_files::ShardFiles;
use super::source::Grasp;
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_dataset::shard::{ColumnType, EXPORT, TableCell, TableWriter};
use gripcast_dataset::{FieldName, Stage};
use gripcast_imaging::jpeg::whole_file;
use gripcast_imaging::{PixelFormat, Role};

/// Version of the columns.
const VERSION: u32 = 1;

/// Writes the shards.
pub(super) struct ParquetShards<'a> {
    context: ExportContext<'a>,
    images: Vec<(Stage, Role)>,
    fields: Vec<(Stage, Role, FieldName, usize)>,
    lifts: Vec<Role>,
    notes: Vec<String>,
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
        let (mut fields, mut notes) = (Vec::new(), Vec::new());
        for ((role, name), counts) in context.survey.fields.iter() {
            let Some(dimensions) = counts.dimensions() else {
                notes.push(format!(
                    "field {name} of {role} left out: its arrays have different dimensions"
                ));
                continue;
            };
            let column = |stage: &Stage| (*stage, *role, name.clone(), dimensions);
            fields.extend(counts.grasps.keys().map(column));
        }
        Self {
            fields,
            lifts: context.survey.lifts.keys().copied().collect(),
            notes,
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
        let fields = self.fields.iter().map(|(stage, role, name, dimensions)| {
            let name = format!("{}_{role}_{name}", stage.name());
            (name, ColumnType::Float32Array(*dimensions))
        });
        let lifts = self.lifts.iter();
        let lifts = lifts.map(|role| (format!("lift_{role}"), ColumnType::ImageList));
        let columns = facts.chain(images).chain(fields).chain(lifts).collect();
        let metadata = [("gripcast", self.metadata.clone())];
        TableWriter::create(path, columns, &metadata)
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
        for (stage, role, name, _) in &self.fields {
            let array = grasp.fields.remove(&(*stage, *role, name.clone()));
            cells.push(array.map_or(TableCell::Null, TableCell::Array));
        }
        for role in &self.lifts {
            cells.push(match lift_images(&grasp, *role) {
                Ok(images) if images.is_empty() => TableCell::Null,
                Ok(images) => TableCell::Images(images),
                Err(error) => return Ok(Some(error)),
            });
        }
        match self.shard(size)?.push(cells) {
            // Too large for a row, which is then not written.
            Err(error) if error.kind() == ErrorKind::Input => Ok(Some(error)),
            pushed => pushed.map(|()| None),
        }
    }

    fn finish(mut self: Box<Self>) -> Result<Vec<String>> {
        self.end_split()?;
        Ok(self.notes)
    }
}

/// The lift frames of a gel as images that any decoder reads; none where it has none.
///
/// # Errors
/// A frame is damaged.
fn lift_images(grasp: &Grasp, role: Role) -> Result<Vec<Vec<u8>>> {
    let lift = grasp.record.lift.as_ref();
    let camera = lift.and_then(|lift| lift.cameras.get(&role));
    let (Some(camera), Some(bytes)) = (camera, grasp.lifts.get(&role)) else {
        return Ok(Vec::new());
    };
    let frames = camera.split(bytes)?.into_iter();
    let whole = frames.map(|(_, image)| match camera.format {
        PixelFormat::Mjpg => Ok(whole_file(image)?.0.into_owned()),
        _ => Ok(image.to_vec()),
    });
    whole.collect()
}
