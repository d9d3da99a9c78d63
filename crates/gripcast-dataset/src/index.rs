//! `metadata.jsonl`: one line per grasp, derived from the records.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use serde::Serialize;
use serde_json::{Value, json};

use super::disk::{Disk, SystemDisk, replace};
use super::grasp::{GraspRecord, Outcome};
use super::layout::{Layout, METADATA_JSONL, Stage};
use super::lock::DatasetLock;
use super::reader::{Dataset, grasp_ids};
use super::record_file::read_grasp;
use gripcast_base::error::Result;
use gripcast_base::files::{FileKind, FileName, GraspId, ObjectName};
use gripcast_imaging::Role;

/// A grasp in the index.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct IndexRow {
    pub(super) object: ObjectName,
    pub(super) outcome: Outcome,
    /// Size of the image files.
    pub(super) bytes: u64,
    /// Columns other than the images.
    columns: Value,
    files: BTreeMap<(Stage, Role), FileName>,
}

impl IndexRow {
    pub(super) fn new(record: &GraspRecord) -> Self {
        let mut files = BTreeMap::new();
        for (stage, frames) in record.stages() {
            for (&role, camera) in &frames.cameras {
                files.insert((stage, role), camera.file.clone());
            }
        }
        let prediction = record.prediction.as_ref();
        let pose = record.pose.as_ref();
        Self {
            object: record.object.clone(),
            outcome: record.outcome,
            bytes: record.files.values().map(|file| file.bytes).sum(),
            columns: json!({
                "id": record.id,
                "object": record.object,
                "scene": record.scene,
                "operator": record.operator,
                "outcome": record.outcome,
                "labelled_at": record.labelled_at,
                "captured_at": record.grasp.captured_at,
                "rig": record.rig,
                "predicted_p_stable": prediction.map(|p| p.p_stable),
                "predicted_threshold": prediction.map(|p| p.threshold),
                "predicted_model": prediction.map(|p| &p.model),
                "pose_t_m": pose.map(|p| p.t_m),
                "pose_q_wxyz": pose.map(|p| p.q_wxyz),
            }),
            files,
        }
    }

    /// The line of the grasp in directory `id`. `images`: the image columns of every row.
    fn to_json(&self, id: &GraspId, images: &BTreeSet<(Stage, Role)>) -> Value {
        let mut row = self.columns.clone();
        row["id"] = json!(id);
        for &(stage, role) in images {
            let file = self.files.get(&(stage, role));
            row[format!("{}_{role}_file_name", stage.name())] =
                json!(file.map(|name| format!("grasps/{id}/{name}")));
        }
        row
    }
}

/// Serialises the index. All rows have the same columns: one for each image that any grasp has,
/// null where a grasp lacks it.
pub(super) fn to_jsonl(rows: &BTreeMap<GraspId, IndexRow>) -> String {
    let images: BTreeSet<(Stage, Role)> = rows
        .values()
        .flat_map(|row| row.files.keys().copied())
        .collect();
    rows.iter()
        .map(|(id, row)| format!("{}\n", row.to_json(id, &images)))
        .collect()
}

/// Result of rebuilding the index.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct ReindexReport {
    /// Grasps in the index.
    pub grasps: usize,
    /// Directories whose record is unreadable; they are not in the index.
    pub skipped: Vec<String>,
    /// Whether the index changed.
    pub changed: bool,
}

/// Rebuilds `metadata.jsonl` from the records.
///
/// # Errors
/// `NotFound` or `Input` without a dataset; `Busy` while it is written; `DiskFull`, `Io`, ….
pub fn reindex(path: impl AsRef<Path>) -> Result<ReindexReport> {
    let dataset = Dataset::open(path)?;
    let _lock = DatasetLock::acquire(dataset.layout())?;
    rewrite(&SystemDisk, dataset.layout())
}

/// Rewrites the index where it differs from the records.
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

/// Whether the stored index equals `text`.
pub(super) fn is_stored(layout: &Layout, text: &str) -> bool {
    let found = layout.index().read(FileKind::List);
    found.is_ok_and(|found| found == text.as_bytes())
}

/// Parsed lines of the stored index, by grasp; invalid lines are skipped.
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
                rows.insert(id, IndexRow::new(&record));
            }
            Err(_) => skipped.push(id.into()),
        }
    }
    Ok((rows, skipped))
}
