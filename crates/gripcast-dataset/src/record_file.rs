//! Reads and writes `grasp.json` and `initial.json`.

use std::collections::BTreeMap;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::digest::FileDigest;
use super::digest::digest;
use super::grasp::{GraspRecord, OverriddenGuard, StageRecord};
use super::layout::{GRASP_JSON, INITIAL_JSON, Layout};
use super::schema::check_schema;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{BeneathPath, FileKind, FileName, GraspId, without_bom};

/// A durable initial frame whose grasp is not saved yet; the contents of `initial.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PendingInitial {
    /// Version of the format.
    pub schema: u32,
    /// Id of the future grasp.
    pub id: GraspId,
    /// `gripcast <version>` that wrote the record.
    pub software: String,
    /// The initial frames.
    pub stage: StageRecord,
    /// Guards that were overridden at the initial trigger.
    pub overridden_guards: Vec<OverriddenGuard>,
    /// Digest of each image file, by file name.
    pub files: BTreeMap<FileName, FileDigest>,
    /// The undone grasp whose initial frame this is. Valid only while that grasp stays undone.
    pub reopened_from: Option<GraspId>,
}

/// Contents of a directory `.tmp-<id>`.
#[derive(Debug)]
pub(super) enum Pending {
    /// A durable initial frame.
    Initial(Box<PendingInitial>),
    /// A complete grasp whose directory was not renamed.
    Grasp,
    /// An incomplete save, never acknowledged; holds the reason.
    Torn(String),
}

impl Pending {
    /// Inspects the directory of `id`.
    pub(super) fn inspect(dir: &BeneathPath, id: &GraspId) -> Self {
        let grasp = read_grasp(dir).and_then(|record| {
            check_files(dir, &record.files)?;
            check_id(&record.id, id)
        });
        let grasp_error = match grasp {
            Ok(()) => return Self::Grasp,
            Err(error) => error,
        };
        let initial = read_initial(dir).and_then(|pending| {
            check_files(dir, &pending.files)?;
            check_id(&pending.id, id)?;
            Ok(pending)
        });
        match initial {
            Ok(pending) => Self::Initial(Box::new(pending)),
            Err(_) if dir.join(GRASP_JSON).is_taken() => Self::Torn(grasp_error.to_string()),
            Err(error) => Self::Torn(error.to_string()),
        }
    }
}

pub(super) fn check_id(found: &GraspId, expected: &GraspId) -> Result<()> {
    if found == expected {
        Ok(())
    } else {
        let what = format!("the record belongs to {found}: the folder is a copy, or was renamed");
        Err(Error::input(what))
    }
}

/// Reads `grasp.json`.
///
/// # Errors
/// `NotFound`, or `Input` when it is not a valid record of this version.
pub(super) fn read_grasp(dir: &BeneathPath) -> Result<GraspRecord> {
    read(&dir.join(GRASP_JSON))
}

/// Returns the names of a record that are not stored in their normal form, as `field`, stored and
/// normal name. Earlier versions stored names as typed.
pub(super) fn names_to_normalise(
    dir: &BeneathPath,
    record: &GraspRecord,
) -> Vec<(&'static str, String, String)> {
    #[derive(Deserialize)]
    struct Stored {
        object: String,
        scene: String,
        operator: String,
    }
    let bytes = dir.join(GRASP_JSON).read(FileKind::Record).ok();
    let stored = bytes.and_then(|bytes| serde_json::from_slice::<Stored>(&bytes).ok());
    let Some(stored) = stored else {
        return Vec::new();
    };
    let names = [
        ("object", stored.object, record.object.as_str()),
        ("scene", stored.scene, record.scene.as_str()),
        ("operator", stored.operator, record.operator.as_str()),
    ];
    names
        .into_iter()
        .filter(|(_, stored, normal)| stored != normal)
        .map(|(field, stored, normal)| (field, stored, normal.to_owned()))
        .collect()
}

/// Reads the record of a complete grasp.
///
/// # Errors
/// As [`read_grasp`]; `Input` for the record of another grasp.
pub(super) fn read_grasp_of(layout: &Layout, id: &GraspId) -> Result<GraspRecord> {
    let dir = layout.grasp(id);
    let record = read_grasp(&dir)?;
    check_id(&record.id, id).map_err(|e| e.at(dir.join(GRASP_JSON).display()))?;
    Ok(record)
}

/// Reads `initial.json`.
pub(super) fn read_initial(dir: &BeneathPath) -> Result<PendingInitial> {
    read(&dir.join(INITIAL_JSON))
}

fn read<T: DeserializeOwned>(path: &BeneathPath) -> Result<T> {
    let bytes = path
        .read(FileKind::Record)
        .map_err(|e| Error::io("cannot read the record", e).at(path.display()))?;
    from_json(&bytes).map_err(|e| e.at(path.display()))
}

/// Parses a record, with or without a byte-order mark.
///
/// # Errors
/// `Input` when it is not a valid record of this version.
pub(super) fn from_json<T: DeserializeOwned>(bytes: &[u8]) -> Result<T> {
    let bytes = without_bom(bytes);
    #[derive(Deserialize)]
    struct Schema {
        schema: i64,
    }
    let Schema { schema } = serde_json::from_slice(bytes).map_err(unreadable)?;
    check_schema(schema)?;
    serde_json::from_slice(bytes).map_err(unreadable)
}

fn unreadable(error: serde_json::Error) -> Error {
    let text = error.to_string();
    let key = text
        .strip_prefix("unknown field `")
        .and_then(|rest| rest.split_once('`'));
    match key {
        Some((key, _)) => {
            let line = error.line();
            Error::input(format!("unknown key `{key}` in line {line} of the record"))
                .remedy("remove the key; remarks belong into `note`")
        }
        None => Error::input("cannot read the record").because(error),
    }
}

/// Serialises a record as pretty JSON with sorted keys and a final newline; checked to parse again.
///
/// # Errors
/// `Internal` for values that JSON cannot represent (NaN, infinity).
pub(super) fn to_json<T: Serialize + DeserializeOwned>(record: &T) -> Result<Vec<u8>> {
    let unwritable = |e: serde_json::Error| {
        Error::internal("the record contains a value that JSON cannot represent").because(e)
    };
    let value = serde_json::to_value(record).map_err(unwritable)?;
    let mut bytes = serde_json::to_vec_pretty(&value).map_err(unwritable)?;
    bytes.push(b'\n');
    serde_json::from_slice::<T>(&bytes).map_err(unwritable)?;
    Ok(bytes)
}

/// Compares every file with its digest.
///
/// # Errors
/// `NotFound` or `Input` for the first file that is missing or altered.
pub(super) fn check_files(dir: &BeneathPath, files: &BTreeMap<FileName, FileDigest>) -> Result<()> {
    for (name, expected) in files {
        let path = dir.join(name);
        let bytes = path
            .read(FileKind::Image)
            .map_err(|e| Error::io("cannot read the file", e).at(path.display()))?;
        if digest(&bytes) != *expected {
            return Err(Error::input("size or sha256 differ from the record").at(path.display()));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_base::error::ErrorKind;

    #[test]
    fn json_is_sorted_and_refuses_nan() {
        #[derive(Serialize, Deserialize)]
        struct Sample {
            z: f64,
            a: u8,
        }
        let text = String::from_utf8(to_json(&Sample { z: 0.1, a: 1 }).unwrap()).unwrap();
        assert_eq!(text, "{\n  \"a\": 1,\n  \"z\": 0.1\n}\n");
        let error = to_json(&Sample { z: f64::NAN, a: 1 }).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Internal);
    }
}
