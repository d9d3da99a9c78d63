//! `metadata.jsonl`: one line per grasp, derived from the records.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use jiff::Timestamp;
use serde::Serialize;
use serde_json::{Value, json};

use super::disk::{Disk, SystemDisk, replace};
use super::grasp::{GraspRecord, Outcome};
use super::layout::{Layout, METADATA_JSONL, Stage};
use super::lock::DatasetLock;
use super::prediction::PredictionRecord;
use super::reader::{Dataset, grasp_ids};
use super::record_file::read_grasp_of;
use gripcast_base::error::Result;
use gripcast_base::files::{FileKind, FileName, GraspId, Label, ObjectName};
use gripcast_imaging::Role;

/// A grasp in the index.
#[derive(Clone, Debug, PartialEq)]
pub struct IndexRow {
    /// Object to grasp.
    pub object: ObjectName,
    /// Where it was grasped.
    pub scene: Label,
    /// Who collected it.
    pub operator: Label,
    /// The label.
    pub outcome: Outcome,
    /// Time of the label, RFC 3339.
    pub labelled_at: Option<String>,
    /// Time of the grasp frame, RFC 3339.
    pub captured_at: String,
    /// [`captured_at`](Self::captured_at), parsed.
    pub time: Option<Timestamp>,
    /// Id of the rig.
    pub rig: String,
    /// Prediction before the lift.
    pub prediction: Option<PredictionRecord>,
    /// Translation, m, and quaternion (w, x, y, z) of the gripper in the object's frame.
    pose: Option<([f64; 3], [f64; 4])>,
    /// Size of the files, bytes.
    pub bytes: u64,
    /// Whether it has lift frames.
    pub has_lift: bool,
    /// Whether a virtual rig took it.
    pub is_simulated: bool,
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
        Self {
            object: record.object.clone(),
            scene: record.scene.clone(),
            operator: record.operator.clone(),
            outcome: record.outcome,
            labelled_at: record.labelled_at.clone(),
            captured_at: record.grasp.captured_at.clone(),
            time: record.grasp.captured_at.parse().ok(),
            rig: record.rig.clone(),
            prediction: record.prediction.clone(),
            pose: record.pose.as_ref().map(|pose| (pose.t_m, pose.q_wxyz)),
            bytes: record.files.values().map(|file| file.bytes).sum(),
            has_lift: record.lift.is_some(),
            is_simulated: record.is_simulated(),
            files,
        }
    }

    /// Cameras with a grasp frame.
    #[must_use]
    pub fn roles(&self) -> Vec<Role> {
        let of_grasp = self
            .files
            .keys()
            .filter(|(stage, _)| *stage == Stage::Grasp);
        of_grasp.map(|(_, role)| *role).collect()
    }

    /// The line of the grasp in directory `id`. `images`: the image columns of every row.
    fn to_json(&self, id: &GraspId, images: &BTreeSet<(Stage, Role)>) -> Value {
        let prediction = self.prediction.as_ref();
        let mut row = json!({
            "id": id,
            "object": self.object,
            "scene": self.scene,
            "operator": self.operator,
            "outcome": self.outcome,
            "labelled_at": self.labelled_at,
            "captured_at": self.captured_at,
            "rig": self.rig,
            "predicted_p_stable": prediction.map(|p| p.p_stable),
            "predicted_threshold": prediction.map(|p| p.threshold),
            "predicted_model": prediction.map(|p| &p.model),
            "pose_t_m": self.pose.map(|(t_m, _)| t_m),
            "pose_q_wxyz": self.pose.map(|(_, q_wxyz)| q_wxyz),
        });
        for &(stage, role) in images {
            let file = self.files.get(&(stage, role));
            row[format!("{}_{role}_file_name", stage.name())] =
                json!(file.map(|name| format!("grasps/{id}/{name}")));
        }
        row
    }
}

impl AsRef<IndexRow> for IndexRow {
    fn as_ref(&self) -> &IndexRow {
        self
    }
}

/// The lines of `metadata.jsonl` for some grasps, sorted by id.
#[must_use]
pub fn metadata_jsonl<'a>(records: impl IntoIterator<Item = &'a GraspRecord>) -> String {
    let records = records.into_iter();
    let rows = records.map(|record| (record.id.clone(), IndexRow::new(record)));
    to_jsonl(&rows.collect())
}

/// Serialises the index. All rows have the same columns: one for each image that any grasp has,
/// null where a grasp lacks it.
pub(super) fn to_jsonl<R: AsRef<IndexRow>>(rows: &BTreeMap<GraspId, R>) -> String {
    let images: BTreeSet<(Stage, Role)> = rows
        .values()
        .flat_map(|row| row.as_ref().files.keys().copied())
        .collect();
    rows.iter()
        .map(|(id, row)| format!("{}\n", row.as_ref().to_json(id, &images)))
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
        match read_grasp_of(layout, &id) {
            Ok(record) => {
                rows.insert(id, IndexRow::new(&record));
            }
            Err(_) => skipped.push(id.into()),
        }
    }
    Ok((rows, skipped))
}
