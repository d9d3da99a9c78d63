//! Parquet shards, a grasp a row: the columns of `metadata.jsonl`, and the images themselves.

use std::borrow::Cow;

use serde_json::json;

use super::format::{Setting, Writer};
use super::shard_files::ShardFiles;
use super::source::Grasp;
use gripcast_base::error::{Error, Result};
use gripcast_dataset::shard::{EXPORT, TableCell, TableKind, TableWriter};
use gripcast_dataset::{GraspRecord, Outcome, Stage};
use gripcast_imaging::Role;

/// Version of the columns.
const VERSION: u32 = 1;
/// Columns beside the images.
const FACTS: [(&str, TableKind); 20] = [
    ("id", TableKind::Text),
    ("object", TableKind::Text),
    ("scene", TableKind::Text),
    ("operator", TableKind::Text),
    ("outcome", TableKind::Text),
    ("label", TableKind::Integer),
    ("labelled_at", TableKind::Text),
    ("captured_at", TableKind::Text),
    ("rig", TableKind::Text),
    ("note", TableKind::Text),
    ("predicted_p_stable", TableKind::Number),
    ("predicted_threshold", TableKind::Number),
    ("predicted_model", TableKind::Text),
    ("predicted_model_sha256", TableKind::Text),
    ("pose_t_m", TableKind::Numbers),
    ("pose_q_wxyz", TableKind::Numbers),
    ("crop_profile_left", TableKind::Text),
    ("crop_profile_right", TableKind::Text),
    ("depth_unit_m", TableKind::Number),
    ("record", TableKind::Text),
];

/// Writes the shards.
pub(super) struct ParquetShards<'a> {
    setting: Setting<'a>,
    images: Vec<(Stage, Role)>,
    metadata: String,
    files: ShardFiles<'a>,
    open: Option<TableWriter>,
}

impl<'a> ParquetShards<'a> {
    pub(super) fn new(setting: Setting<'a>) -> Self {
        let descriptor = setting.descriptor;
        let metadata = json!({
            "format": EXPORT,
            "version": VERSION,
            "dataset": descriptor.name,
            "licence": descriptor.licence,
            "label_definition": descriptor.label_definition,
        });
        Self {
            setting,
            images: setting.survey.cameras.keys().copied().collect(),
            metadata: metadata.to_string(),
            files: ShardFiles::new(setting.folder),
            open: None,
        }
    }

    /// The open shard, a new one where the last is full.
    fn shard(&mut self, next: usize) -> Result<&mut TableWriter> {
        let most = self.setting.plan.shard_bytes;
        let open = match self.open.take() {
            Some(full) if full.bytes() + next > most => {
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
            (name, TableKind::Image)
        });
        let metadata = [("gripcast", self.metadata.clone())];
        TableWriter::create(path, facts.chain(images).collect(), &metadata)
    }

    fn end_part(&mut self) -> Result<()> {
        if let Some(open) = self.open.take() {
            open.finish()?;
        }
        self.files.end_part()
    }
}

impl Writer for ParquetShards<'_> {
    fn begin_part(&mut self, part: &str) -> Result<()> {
        self.end_part()?;
        self.files.begin_part(part);
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
        self.end_part()?;
        Ok(Vec::new())
    }
}

/// In the order of [`FACTS`].
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

/// 0 slip, 1 stable.
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
