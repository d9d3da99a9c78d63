//! The facts of a grasp: the columns of Parquet beside the images, and the JSON of WebDataset.

use std::borrow::Cow;

use serde_json::{Map, Value, json};

use super::source::Grasp;
use gripcast_dataset::shard::{ColumnType, TableCell};
use gripcast_dataset::{GraspRecord, Outcome};
use gripcast_imaging::Role;
use gripcast_shear::FingerForce;

/// Names and types of the facts.
pub(super) const FACTS: [(&str, ColumnType); 30] = [
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
    ("force_left_n", ColumnType::Float64),
    ("force_left_std_n", ColumnType::Float64),
    ("force_left_shear_n", ColumnType::Float64List(2)),
    ("force_left_shear_std_n", ColumnType::Float64),
    ("force_left_is_calibrated", ColumnType::Int64),
    ("force_right_n", ColumnType::Float64),
    ("force_right_std_n", ColumnType::Float64),
    ("force_right_shear_n", ColumnType::Float64List(2)),
    ("force_right_shear_std_n", ColumnType::Float64),
    ("force_right_is_calibrated", ColumnType::Int64),
    ("record", ColumnType::Text),
];

/// Cells in the order of [`FACTS`].
pub(super) fn facts(grasp: &Grasp) -> Vec<TableCell<'static>> {
    let record = &grasp.record;
    let prediction = record.prediction.as_ref();
    let pose = record.pose.as_ref();
    let depth = record.grasp.cameras.get(&Role::Depth);
    let mut cells = vec![
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
    ];
    for role in [Role::Left, Role::Right] {
        cells.extend(force(record.grasp.force.get(&role)));
    }
    cells.push(text(&String::from_utf8_lossy(&grasp.json)));
    cells
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

/// Cells of the force on a gel.
fn force(force: Option<&FingerForce>) -> [TableCell<'static>; 5] {
    let shear = force.and_then(|force| force.shear_n);
    [
        optional(force.map(|force| force.normal_n)),
        optional(force.map(|force| force.normal_std_n)),
        shear.map_or(TableCell::Null, |n| TableCell::Numbers(n.to_vec())),
        optional(force.and_then(|force| force.shear_std_n)),
        force.map_or(TableCell::Null, |f| {
            TableCell::Integer(f.is_calibrated.into())
        }),
    ]
}

/// The facts as JSON with equal keys and types for all grasps, without null: a reader that infers
/// the types from some grasps can read the others. [`missing`] gives the value of an absent fact.
pub(super) fn typed_json(grasp: &Grasp) -> Map<String, Value> {
    let mut json: Map<String, Value> = FACTS
        .into_iter()
        .zip(facts(grasp))
        .map(|((name, kind), cell)| {
            (
                name.to_owned(),
                value(cell).unwrap_or_else(|| missing(kind)),
            )
        })
        .collect();
    json.insert("has_pose".to_owned(), grasp.record.pose.is_some().into());
    let has_prediction = grasp.record.prediction.is_some();
    json.insert("has_prediction".to_owned(), has_prediction.into());
    let has_force = !grasp.record.grasp.force.is_empty();
    json.insert("has_force".to_owned(), has_force.into());
    json
}

fn value(cell: TableCell<'_>) -> Option<Value> {
    match cell {
        TableCell::Text(text) => Some(json!(text)),
        TableCell::Integer(number) => Some(json!(number)),
        TableCell::Number(number) => Some(json!(number)),
        TableCell::Numbers(numbers) => Some(json!(numbers)),
        // Facts are none of these.
        TableCell::Image(_) | TableCell::Images(_) | TableCell::Array(_) | TableCell::Null => None,
    }
}

/// Value of an absent fact: an empty text, −1 (all numbers are positive), a list of zeros.
fn missing(kind: ColumnType) -> Value {
    match kind {
        ColumnType::Int64 | ColumnType::Bool => json!(-1),
        ColumnType::Float64 | ColumnType::Float32 => json!(-1.0),
        ColumnType::Float64List(length) | ColumnType::Float32List(length) => {
            json!(vec![0.0; length])
        }
        ColumnType::Text
        | ColumnType::TextList
        | ColumnType::Image
        | ColumnType::ImageList
        | ColumnType::Float32Array(_) => json!(""),
    }
}
