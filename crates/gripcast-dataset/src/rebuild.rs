//! Rebuilds a lost `grasp.json` from the images, the index and the rest of the old record.

use std::collections::BTreeMap;

use jiff::Timestamp;
use jiff::civil::DateTime;
use jiff::tz::TimeZone;
use serde::de::DeserializeOwned;
use serde_json::Value;

use super::descriptor::SOFTWARE;
use super::digest::FileDigest;
use super::digest::digest;
use super::grasp::{CameraRecord, GraspRecord, StageRecord};
use super::image_file;
use super::layout::{GRASP_JSON, PRE_GRASP_PREFIX, Stage};
use super::lift::{LiftCamera, LiftRecord};
use super::reader::entries;
use super::schema::SCHEMA_VERSION;
use super::stored_file::StoredFile;
use gripcast_base::files::{
    BeneathPath, FileKind, FileName, GraspId, Label, ObjectName, without_bom,
};
use gripcast_imaging::Role;

/// Whether the record is of a newer version of the format.
pub(super) fn is_newer(dir: &BeneathPath) -> bool {
    old_record(dir)
        .get("schema")
        .and_then(Value::as_u64)
        .is_some_and(|schema| schema > u64::from(SCHEMA_VERSION))
}

/// Rebuilds the record of `id`. `row`: its line of the index.
///
/// Needs complete images of both gels at both stages; otherwise returns what is missing.
pub(super) fn rebuild(
    dir: &BeneathPath,
    id: &GraspId,
    row: Option<&Value>,
) -> Result<GraspRecord, String> {
    let old = old_record(dir);
    let sources = Sources { old: &old, row };
    let mut files = BTreeMap::new();
    let captured_at = time_of(id);
    let mut stage = |stage: Stage| {
        let mut record: StageRecord = sources.field(stage.name()).unwrap_or_else(|| StageRecord {
            captured_at: captured_at.to_string(),
            trigger_time_ns: 0,
            trigger: "unknown".into(),
            skew_ms: 0.0,
            cameras: BTreeMap::new(),
            fields: BTreeMap::new(),
            shear: BTreeMap::new(),
            force: BTreeMap::new(),
        });
        record.cameras = cameras(dir, stage, &record.cameras, &mut files);
        for fields in record.fields.values_mut() {
            fields.retain(|_, field| keep(dir, &field.file, StoredFile::Field(field), &mut files));
        }
        record.fields.retain(|_, fields| !fields.is_empty());
        for role in [Role::Left, Role::Right] {
            if !record.cameras.contains_key(&role) {
                return Err(format!(
                    "cannot rebuild the record: no complete {} image of {role}",
                    stage.name()
                ));
            }
        }
        Ok(record)
    };
    let initial = stage(Stage::Initial)?;
    let grasp = stage(Stage::Grasp)?;
    let mut lift: Option<LiftRecord> = sources.field("lift");
    if let Some(lift) = &mut lift {
        let mut is_whole =
            |lift: &LiftCamera| keep(dir, &lift.file, StoredFile::Lift(lift), &mut files);
        lift.cameras.retain(|_, lift| is_whole(lift));
    }
    let text = |name: &str| {
        let found: Option<String> = sources.field(name);
        found.unwrap_or_else(|| "unknown".to_owned())
    };
    let from = match (old.is_object(), row.is_some()) {
        (true, _) => "the images and the rest of the old record",
        (false, true) => "the images and the index",
        (false, false) => "the images alone; object, scene and outcome are unknown",
    };
    Ok(GraspRecord {
        schema: SCHEMA_VERSION,
        id: id.clone(),
        // Older versions did not check names: make them valid.
        object: ObjectName::nearest(&text("object")),
        scene: Label::nearest(&text("scene")),
        operator: Label::nearest(&text("operator")),
        rig: text("rig"),
        software: SOFTWARE.to_owned(),
        outcome: sources.field("outcome").unwrap_or_default(),
        labelled_at: sources.field("labelled_at").unwrap_or_default(),
        initial,
        grasp,
        pre_grasp_frames: pre_grasp_frames(
            dir,
            sources.field("approach").unwrap_or_default(),
            &mut files,
        ),
        pose: sources.field("pose").unwrap_or_default(),
        boards: sources.field("boards").unwrap_or_default(),
        prediction: sources.field("prediction").unwrap_or_default(),
        overridden_guards: sources.field("overridden_guards").unwrap_or_default(),
        calibration: sources.field("calibration").unwrap_or_default(),
        lift: lift.filter(|lift| !lift.cameras.is_empty()),
        lift_verdict: sources.field("lift_verdict").unwrap_or_default(),
        files,
        note: format!("record rebuilt from {from}"),
        truth: sources.field("truth").unwrap_or_default(),
    })
}

/// Sources of fields: the old record first, then the index.
struct Sources<'a> {
    old: &'a Value,
    row: Option<&'a Value>,
}

impl Sources<'_> {
    fn field<T: DeserializeOwned>(&self, name: &str) -> Option<T> {
        [Some(self.old), self.row]
            .into_iter()
            .flatten()
            .filter_map(|source| source.get(name))
            .find_map(|value| serde_json::from_value(value.clone()).ok())
    }
}

/// The old record if it is valid JSON; null otherwise.
fn old_record(dir: &BeneathPath) -> Value {
    dir.join(GRASP_JSON)
        .read(FileKind::Record)
        .ok()
        .and_then(|bytes| serde_json::from_slice(without_bom(&bytes)).ok())
        .unwrap_or_default()
}

/// Cameras with a complete image of a stage; adds the digests of those files.
fn cameras(
    dir: &BeneathPath,
    stage: Stage,
    old: &BTreeMap<Role, CameraRecord>,
    files: &mut BTreeMap<FileName, FileDigest>,
) -> BTreeMap<Role, CameraRecord> {
    let mut cameras = BTreeMap::new();
    for role in Role::ALL {
        let found = ["jpg", "png"].iter().find_map(|extension| {
            let file = FileName::from_words(&[stage.name(), role.name(), extension]);
            complete_image(dir, file, old.get(&role), files)
        });
        cameras.extend(found.map(|camera| (role, camera)));
    }
    cameras
}

/// Complete pre-grasp frames; adds the digests of their files.
fn pre_grasp_frames(
    dir: &BeneathPath,
    old: Vec<CameraRecord>,
    files: &mut BTreeMap<FileName, FileDigest>,
) -> Vec<CameraRecord> {
    let names = entries(dir)
        .into_iter()
        .flatten()
        .filter_map(|entry| FileName::parse(&entry.name()).ok())
        .filter(|name| name.starts_with(PRE_GRASP_PREFIX));
    let found = names.into_iter().filter_map(|name| {
        let old = old.iter().find(|camera| camera.file == name);
        complete_image(dir, name, old, files)
    });
    found.collect()
}

/// Whether a file is still what the old record says; adds its digest. Without the record nothing
/// tells what a field or a lift is.
fn keep(
    dir: &BeneathPath,
    name: &FileName,
    file: StoredFile<'_>,
    files: &mut BTreeMap<FileName, FileDigest>,
) -> bool {
    let Ok(bytes) = dir.join(name).read(FileKind::Image) else {
        return false;
    };
    let is_whole = file.defect(&bytes).is_none();
    if is_whole {
        files.insert(name.clone(), digest(&bytes));
    }
    is_whole
}

/// Record of an image, the old one where it still fits; adds the file's digest. `None` where the
/// file is not a complete image.
fn complete_image(
    dir: &BeneathPath,
    file: FileName,
    old: Option<&CameraRecord>,
    files: &mut BTreeMap<FileName, FileDigest>,
) -> Option<CameraRecord> {
    let bytes = dir.join(&file).read(FileKind::Image).ok()?;
    let (format, width, height) = image_file::recognise(&bytes)?;
    files.insert(file.clone(), digest(&bytes));
    let fits = |camera: &&CameraRecord| {
        camera.file == file && StoredFile::Image(camera).defect(&bytes).is_none()
    };
    Some(old.filter(fits).cloned().unwrap_or_else(|| CameraRecord {
        file,
        product: "unknown".into(),
        serial: String::new(),
        interface: 0,
        port: String::new(),
        format,
        width,
        height,
        driver_time_ns: 0,
        sequence: 0,
        age_ms: 0.0,
        controls: BTreeMap::new(),
        crop_profile: None,
        depth_unit_m: None,
        valid_fraction: None,
        repairs: None,
    }))
}

/// Time in an id; the epoch where it has none.
fn time_of(id: &GraspId) -> Timestamp {
    let text = id.get(..20).unwrap_or_default();
    DateTime::strptime("%Y-%m-%dT%H-%M-%SZ", text)
        .and_then(|time| time.to_zoned(TimeZone::UTC))
        .map_or(Timestamp::UNIX_EPOCH, |time| time.timestamp())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_is_read_from_id() {
        let id = GraspId::parse("2026-11-20T10-15-03Z-7f3a").unwrap();
        assert_eq!(time_of(&id).to_string(), "2026-11-20T10:15:03Z");
        assert_eq!(
            time_of(&GraspId::parse("my-grasp").unwrap()),
            Timestamp::UNIX_EPOCH
        );
    }
}
