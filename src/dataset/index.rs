//! `metadata.jsonl`: one line a grasp, derived from the records.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::{Map, Value, json};

use super::grasp::{GraspId, GraspRecord, Outcome, PoseRecord, PredictionRecord};
use super::layout::Stage;
use crate::imaging::Role;

/// What the index keeps of a grasp.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct IndexRow {
    pub(super) object: String,
    pub(super) scene: String,
    pub(super) operator: String,
    pub(super) outcome: Outcome,
    pub(super) labelled_at: Option<String>,
    pub(super) captured_at: String,
    pub(super) rig: String,
    pub(super) prediction: Option<PredictionRecord>,
    pub(super) pose: Option<PoseRecord>,
    pub(super) files: BTreeMap<(Stage, Role), String>,
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
