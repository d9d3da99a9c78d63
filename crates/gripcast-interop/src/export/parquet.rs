//! Parquet shards with one row per grasp: the columns of `metadata.jsonl`, and the images.

use std::borrow::Cow;

use serde_json::json;

use super::format::{ExportContext, Writer};
use super::shard_files::ShardFiles;
use super::source::Grasp;
use gripcast_base::error::{Error, Result};
use gripcast_dataset::shard::{ColumnType, EXPORT, TableCell, TableWriter};
use gripcast_dataset::{GraspRecord, Outcome, Stage};
use gripcast_imaging::Role;

/// Version of the columns.
const VERSION: u32 = 1;
/// Columns other than the images.
const FACTS: [(&str, ColumnType); 20] = [
    ("id", ColumnType::Text),
    ("object", ColumnType::Text),
    ("scene", ColumnType::Text),
    ("operator", ColumnType::Text),
    ("outcome", ColumnType::Text),
    ("label", ColumnType::Int64),
    ("labelled_at", ColumnType::Text),
    ("captured_at", ColumnType::Text),
    ("rig", ColumnType::Text),
    ("note", ColumnType::Text),
    ("predicted_p_stable", ColumnType::Float64),
    ("predicted_threshold", ColumnType::Float64),
    ("predicted_model", ColumnType::Text),
    ("predicted_model_sha256", ColumnType::Text),
    ("pose_t_m", ColumnType::Float64List(3)),
    ("pose_q_wxyz", ColumnType::Float64List(4)),
    ("crop_profile_left", ColumnType::Text),
    ("crop_profile_right", ColumnType::Text),
    ("depth_unit_m", ColumnType::Float64),
    ("record", ColumnType::Text),
];

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

/// Cells in the order of [`FACTS`].
fn facts(grasp: &Grasp) -> Vec<TableCell<'static>> {
    let record = &grasp.record;
    let prediction = record.prediction.as_ref();
    let pose = record.pose.as_ref();
    let depth = record.grasp.cameras.get(&Role::Depth);
    vec![
        text(&record.id),
        text(&record.object),
        text(&record.scene),
        text(&record.operator),
        text(&record.outcome.to_string()),
        label(record.outcome).map_or(TableCell::Null, TableCell::Integer),
        optional_text(record.labelled_at.as_deref()),
        text(&record.grasp.captured_at),
        text(&record.rig),
        text(&record.note),
        optional(prediction.map(|p| p.p_stable)),
        optional(prediction.map(|p| p.threshold)),
        optional_text(prediction.map(|p| p.model.as_str())),
        optional_text(prediction.map(|p| p.model_sha256.as_str())),
        pose.map_or(TableCell::Null, |p| TableCell::Numbers(p.t_m.to_vec())),
        pose.map_or(TableCell::Null, |p| TableCell::Numbers(p.q_wxyz.to_vec())),
        optional_text(crop_profile(record, Role::Left)),
        optional_text(crop_profile(record, Role::Right)),
        optional(depth.and_then(|camera| camera.depth_unit_m)),
        text(&String::from_utf8_lossy(&grasp.json)),
    ]
}

/// Label: 0 slip, 1 stable.
pub(super) fn label(outcome: Outcome) -> Option<i64> {
    match outcome {
        Outcome::Slip => Some(0),
        Outcome::Stable => Some(1),
        Outcome::Unlabelled => None,
    }
}

fn crop_profile(record: &GraspRecord, role: Role) -> Option<&str> {
    record.grasp.cameras.get(&role)?.crop_profile.as_deref()
}

fn text(text: &str) -> TableCell<'static> {
    TableCell::Text(Cow::Owned(text.to_owned()))
}

fn optional_text(value: Option<&str>) -> TableCell<'static> {
    value.map_or(TableCell::Null, text)
}

fn optional(number: Option<f64>) -> TableCell<'static> {
    number.map_or(TableCell::Null, TableCell::Number)
}
