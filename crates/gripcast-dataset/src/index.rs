//! `metadata.jsonl`: one line a grasp, derived from the records.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use serde::Serialize;
use serde_json::{Map, Value, json};

use super::disk::{Disk, SystemDisk, replace};
use super::grasp::{GraspRecord, Outcome, PoseRecord, PredictionRecord};
use super::layout::{Layout, METADATA_JSONL, Stage};
use super::lock::DatasetLock;
use super::reader::{Dataset, grasp_ids};
use super::record_file::read_grasp;
use gripcast_base::error::Result;
use gripcast_base::files::{FileKind, FileName, GraspId, Label, ObjectName};
use gripcast_imaging::Role;

/// What the index keeps of a grasp.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct IndexRow {
    pub(super) object: ObjectName,
    pub(super) scene: Label,
    pub(super) operator: Label,
    pub(super) outcome: Outcome,
    pub(super) labelled_at: Option<String>,
    pub(super) captured_at: String,
    pub(super) rig: String,
    pub(super) prediction: Option<PredictionRecord>,
    pub(super) pose: Option<PoseRecord>,
    pub(super) files: BTreeMap<(Stage, Role), FileName>,
}

impl IndexRow {
    pub(super) fn of(record: &GraspRecord) -> Self {
        let mut files = BTreeMap::new();
        for (stage, frames) in record.stages() {
            for (&role, camera) in &frames.cameras {
                files.insert((stage, role), camera.file.clone());
            }
        }
        Self {
            object: record.object.clone(),
            scene: record.scene.clone(),
            operator: record.operator.clone(),
            outcome: record.outcome,
            labelled_at: record.labelled_at.clone(),
            captured_at: record.grasp.captured_at.clone(),
            rig: record.rig.clone(),
            prediction: record.prediction.clone(),
            pose: record.pose.clone(),
            files,
        }
    }

    /// `images`: the image columns that every row of the index has.
    fn to_json(&self, id: &GraspId, images: &BTreeSet<(Stage, Role)>) -> Value {
        let prediction = self.prediction.as_ref();
        let mut row = Map::new();
        row.insert("id".into(), json!(id));
        row.insert("object".into(), json!(self.object));
        row.insert("scene".into(), json!(self.scene));
        row.insert("operator".into(), json!(self.operator));
        row.insert("outcome".into(), json!(self.outcome));
        row.insert("labelled_at".into(), json!(self.labelled_at));
        row.insert("captured_at".into(), json!(self.captured_at));
        row.insert("rig".into(), json!(self.rig));
        row.insert(
            "predicted_p_stable".into(),
            json!(prediction.map(|p| p.p_stable)),
        );
        row.insert(
            "predicted_threshold".into(),
            json!(prediction.map(|p| p.threshold)),
        );
        row.insert(
            "predicted_model".into(),
            json!(prediction.map(|p| &p.model)),
        );
        row.insert("pose_t_m".into(), json!(self.pose.as_ref().map(|p| p.t_m)));
        row.insert(
            "pose_q_wxyz".into(),
            json!(self.pose.as_ref().map(|p| p.q_wxyz)),
        );
        for &(stage, role) in images {
            let file = self
                .files
                .get(&(stage, role))
                .map(|name| format!("grasps/{id}/{name}"));
            row.insert(format!("{}_{role}_file_name", stage.name()), json!(file));
        }
        Value::Object(row)
    }
}

/// The whole index. Every row has the same columns: an image column is there when any grasp has
/// that image, and null where a grasp lacks it.
pub(super) fn to_jsonl(rows: &BTreeMap<GraspId, IndexRow>) -> String {
    let images: BTreeSet<(Stage, Role)> = rows
        .values()
        .flat_map(|row| row.files.keys().copied())
        .collect();
    rows.iter()
        .map(|(id, row)| format!("{}\n", row.to_json(id, &images)))
        .collect()
}

/// What writing the index again did.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct ReindexReport {
    /// Grasps in the index.
    pub grasps: usize,
    /// Directories whose record cannot be read; they are not in the index.
    pub skipped: Vec<String>,
    /// Whether the index was different before.
    pub changed: bool,
}

/// Writes `metadata.jsonl` again from the records.
///
/// # Errors
/// `NotFound` or `Input` when there is no dataset; `Busy` while it is written; `DiskFull`, `Io`, ….
pub fn reindex(path: impl AsRef<Path>) -> Result<ReindexReport> {
    let dataset = Dataset::open(path)?;
    let _lock = DatasetLock::acquire(dataset.layout())?;
    rewrite(&SystemDisk, dataset.layout())
}

/// Makes the index say what the records say.
pub(super) fn rewrite(disk: &dyn Disk, layout: &Layout) -> Result<ReindexReport> {
    let (rows, skipped) = read_rows(layout)?;
    let text = to_jsonl(&rows);
    let changed = !is_stored(layout, &text);
    if changed {
        replace(disk, &layout.top(), METADATA_JSONL, text.as_bytes())
            .map_err(|e| layout.failed("cannot write the index", e))?;
    }
    Ok(ReindexReport {
        grasps: rows.len(),
        skipped,
        changed,
    })
}

/// Whether the index is this text.
pub(super) fn is_stored(layout: &Layout, text: &str) -> bool {
    let found = layout.index().read(FileKind::List);
    found.is_ok_and(|found| found == text.as_bytes())
}

/// The lines of the index as they are, by grasp; those that cannot be read are left out.
pub(super) fn rows_by_id(layout: &Layout) -> BTreeMap<GraspId, Value> {
    let text = layout.index().read_to_string(FileKind::List);
    let text = text.unwrap_or_default();
    text.lines()
        .filter_map(|line| {
            let row: Value = serde_json::from_str(line).ok()?;
            let id = GraspId::parse(row.get("id")?.as_str()?).ok()?;
            Some((id, row))
        })
        .collect()
}

fn read_rows(layout: &Layout) -> Result<(BTreeMap<GraspId, IndexRow>, Vec<String>)> {
    let mut rows = BTreeMap::new();
    let mut skipped = Vec::new();
    for id in grasp_ids(layout)? {
        match read_grasp(&layout.grasp(&id)) {
            Ok(record) => {
                rows.insert(id, IndexRow::of(&record));
            }
            Err(_) => skipped.push(id.into()),
        }
    }
    Ok((rows, skipped))
}
