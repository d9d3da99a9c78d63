//! Corrections of a grasp's names.

use std::fmt;
use std::path::Path;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::grasp::GraspRecord;
use super::reader::Dataset;
use super::writer::DatasetWriter;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{GraspId, Label, ObjectName};

/// New names of a saved grasp. An absent name stays; an empty scene or operator removes the name.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NameChange {
    /// Object.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<String>, min_length = 1, max_length = 120)]
    pub object: Option<ObjectName>,
    /// Scene.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<String>, max_length = 120)]
    pub scene: Option<Label>,
    /// Operator of the gripper.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<String>, max_length = 120)]
    pub operator: Option<Label>,
}

impl NameChange {
    /// Whether it names nothing.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// Parses `object NAME`, `scene NAME` or `operator NAME`.
    ///
    /// # Errors
    /// `Input` for another field, a missing or an invalid name.
    pub fn parse(text: &str) -> Result<Self> {
        let (field, name) = text.split_once(char::is_whitespace).unwrap_or((text, ""));
        if !matches!(field, "object" | "scene" | "operator") {
            return Err(Error::input(format!(
                "expected object NAME, scene NAME or operator NAME, found {text:.80?}"
            )));
        }
        if name.trim().is_empty() {
            return Err(Error::input(format!("expected a name after `{field}`")));
        }
        let mut change = Self::default();
        match field {
            "object" => change.object = Some(name.parse()?),
            "scene" => change.scene = Some(name.parse()?),
            _ => change.operator = Some(name.parse()?),
        }
        Ok(change)
    }

    /// Changes a record; returns the previous names of the fields that differ.
    pub(super) fn apply(&self, record: &mut GraspRecord) -> Self {
        Self {
            object: replace(&mut record.object, self.object.as_ref()),
            scene: replace(&mut record.scene, self.scene.as_ref()),
            operator: replace(&mut record.operator, self.operator.as_ref()),
        }
    }
}

fn replace<T: Clone + PartialEq>(found: &mut T, new: Option<&T>) -> Option<T> {
    let new = new.filter(|new| *new != found)?;
    Some(std::mem::replace(found, new.clone()))
}

impl DatasetWriter {
    /// Changes object, scene or operator of a grasp; returns the previous names of the fields that
    /// differ.
    ///
    /// # Errors
    /// `NotFound` without that grasp; `DiskFull`, `Io`, … with the names as before.
    pub fn set_names(
        &mut self,
        id: &GraspId,
        names: &NameChange,
    ) -> Result<(GraspRecord, NameChange)> {
        let mut before = NameChange::default();
        let record = self.change(id, &format!("cannot change the names of {id}"), |record| {
            before = names.apply(record);
            Ok(())
        })?;
        Ok((record, before))
    }
}

/// Which grasps to edit.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Selection {
    /// These grasps.
    Ids(Vec<GraspId>),
    /// All grasps of an object.
    Object(ObjectName),
}

/// A grasp whose names differ from the requested ones.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct EditedGrasp {
    /// Id.
    pub id: GraspId,
    /// Previous names of the fields that differ.
    pub before: NameChange,
}

/// Result of an edit.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct EditReport {
    /// Whether nothing was changed.
    pub dry_run: bool,
    /// New names.
    pub names: NameChange,
    /// Grasps that were changed, or would be changed.
    pub changed: Vec<EditedGrasp>,
    /// Number of selected grasps that had these names before.
    pub unchanged: usize,
}

/// Changes names of saved grasps. All grasps are read before the first one is changed.
///
/// # Errors
/// `NotFound` without the dataset, a grasp or any grasp of the object; `Input` for an unreadable
/// record; `Busy` while the dataset is written; `DiskFull`, `Io`, … with the number of grasps that
/// were changed: each change is durable.
pub fn edit(
    path: impl AsRef<Path>,
    selection: &Selection,
    names: &NameChange,
    dry_run: bool,
) -> Result<EditReport> {
    let path = path.as_ref();
    // With the lock, the records do not change between reading and writing.
    let writer = (!dry_run).then(|| DatasetWriter::open(path)).transpose()?;
    let mut report = EditReport {
        dry_run,
        names: names.clone(),
        ..EditReport::default()
    };
    for mut record in selected(&Dataset::open(path)?, selection)? {
        let before = names.apply(&mut record);
        if before.is_empty() {
            report.unchanged += 1;
        } else {
            let id = record.id;
            report.changed.push(EditedGrasp { id, before });
        }
    }
    if let Some((mut writer, _)) = writer {
        for (done, grasp) in report.changed.iter().enumerate() {
            writer.set_names(&grasp.id, names).map_err(|e| {
                let all = report.changed.len();
                e.remedy(format!("{done} of {all} grasps were changed; run it again"))
            })?;
        }
        writer.flush_index()?;
    }
    Ok(report)
}

fn selected(dataset: &Dataset, selection: &Selection) -> Result<Vec<GraspRecord>> {
    let object = match selection {
        Selection::Ids(ids) => return ids.iter().map(|id| dataset.grasp(id)).collect(),
        Selection::Object(object) => object,
    };
    let records: Vec<GraspRecord> = dataset
        .grasps()?
        // An unreadable record has no object.
        .filter_map(Result::ok)
        .filter(|record| record.object == *object)
        .collect();
    if records.is_empty() {
        return Err(Error::not_found(format!("no grasp of object `{object}`"))
            .at(dataset.path().display())
            .remedy("`gripcast dataset info` lists the objects"));
    }
    Ok(records)
}

/// As in a command: `object NAME`; several names are separated by commas.
impl fmt::Display for NameChange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names = [
            ("object", self.object.as_deref()),
            ("scene", self.scene.as_deref()),
            ("operator", self.operator.as_deref()),
        ];
        let given = names
            .iter()
            .filter_map(|(field, name)| Some((field, (*name)?)));
        for (index, (field, name)) in given.enumerate() {
            let separator = if index == 0 { "" } else { ", " };
            write!(f, "{separator}{field} {name}")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::{capture, meta, new_dataset};
    use gripcast_base::error::ErrorKind;

    #[test]
    fn change_names_one_field() {
        let change = NameChange::parse("object blue mug").unwrap();
        assert_eq!(change.object.as_deref(), Some("blue mug"));
        assert_eq!(change.to_string(), "object blue mug");
        for text in [
            "",
            "object",
            "object  ",
            "object ../mug",
            "colour blue",
            "scene",
        ] {
            assert!(NameChange::parse(text).is_err(), "{text:?}");
        }
    }

    #[test]
    fn edit_changes_all_grasps_of_an_object_and_the_index() {
        let dir = tempfile::tempdir().unwrap();
        let (mut writer, _) = DatasetWriter::open_or_create(dir.path(), &new_dataset()).unwrap();
        for (number, object) in [(1, "object"), (3, "cup"), (5, "object")] {
            let pending = writer.save_initial(&capture(number), Vec::new()).unwrap();
            writer
                .save_grasp(&pending, &capture(number + 1), meta(object))
                .unwrap();
        }
        let names = NameChange {
            object: Some("cup".parse().unwrap()),
            operator: Some("Bo".parse().unwrap()),
            ..NameChange::default()
        };
        let of_object = Selection::Object("object".parse().unwrap());
        let error = edit(dir.path(), &of_object, &names, false).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Busy);
        drop(writer);

        let planned = edit(dir.path(), &of_object, &names, true).unwrap();
        assert_eq!((planned.changed.len(), planned.dry_run), (2, true));
        let done = edit(dir.path(), &of_object, &names, false).unwrap();
        assert_eq!(done.changed, planned.changed);
        assert_eq!(done.changed[0].before.object.as_deref(), Some("object"));
        let dataset = Dataset::open(dir.path()).unwrap();
        let records: Vec<_> = dataset.grasps().unwrap().map(Result::unwrap).collect();
        assert!(records.iter().all(|record| record.object == "cup"));
        let verified = crate::verify(dir.path(), &|_, _| {}).unwrap();
        assert_eq!(verified.problems, [], "the index follows");

        let error = edit(dir.path(), &of_object, &names, false).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::NotFound, "no grasp of it is left");
        let ids = Selection::Ids(vec![records[0].id.clone(), "missing".parse().unwrap()]);
        let scene = NameChange::parse("scene lab").unwrap();
        let error = edit(dir.path(), &ids, &scene, false).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::NotFound);
        let untouched = dataset.grasp(&records[0].id).unwrap();
        assert_eq!(
            untouched.scene, "table",
            "nothing changes if one is missing"
        );
    }

    /// A dataset of an earlier version, which stored names as typed.
    #[test]
    fn composed_and_decomposed_names_are_one_object() {
        let dir = tempfile::tempdir().unwrap();
        let (mut writer, _) = DatasetWriter::open_or_create(dir.path(), &new_dataset()).unwrap();
        let mut ids = Vec::new();
        for (number, object) in [(1, "Gr\u{f6}\u{df}e"), (3, "Gr\u{f6}\u{df}e"), (5, "mug")] {
            let pending = writer.save_initial(&capture(number), Vec::new()).unwrap();
            let record = writer.save_grasp(&pending, &capture(number + 1), meta(object));
            ids.push(record.unwrap().id);
        }
        drop(writer);
        let path = dir.path().join("grasps").join(&*ids[1]).join("grasp.json");
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(
            &path,
            text.replace("Gr\u{f6}\u{df}e", "  Gro\u{308}\u{df}e"),
        )
        .unwrap();

        let dataset = Dataset::open(dir.path()).unwrap();
        let objects = crate::summary(&dataset).unwrap().objects;
        assert_eq!(objects.len(), 2, "{objects:?}");
        let plan = crate::SplitPlan {
            name: "a".into(),
            by: crate::GroupKey::Object,
            seed: 0,
            fractions: [("fit".to_owned(), 0.5), ("rest".to_owned(), 0.5)].into(),
        };
        let file = crate::split(&dataset, &plan).unwrap();
        let splits: Vec<_> = file.splits.values().collect();
        let together = splits
            .iter()
            .any(|set| set.grasps.contains(&ids[0]) && set.grasps.contains(&ids[1]));
        assert!(together, "{splits:?}");

        let kinds = || {
            let report = crate::verify(dir.path(), &|_, _| {}).unwrap();
            report.problems.iter().map(|p| p.kind).collect::<Vec<_>>()
        };
        assert_eq!(kinds(), [crate::ProblemKind::Name]);
        let planned = crate::recover(dir.path(), true).unwrap();
        assert_eq!(planned.actions.len(), 1, "{planned:?}");
        crate::recover(dir.path(), false).unwrap();
        assert_eq!(kinds(), []);
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.contains("\"Gr\u{f6}\u{df}e\""), "{text}");
    }

    #[test]
    fn objects_that_differ_only_in_case_are_noted() {
        let dir = tempfile::tempdir().unwrap();
        let (mut writer, _) = DatasetWriter::open_or_create(dir.path(), &new_dataset()).unwrap();
        for (number, object) in [(1, "Mug"), (3, "mug")] {
            let pending = writer.save_initial(&capture(number), Vec::new()).unwrap();
            writer
                .save_grasp(&pending, &capture(number + 1), meta(object))
                .unwrap();
        }
        drop(writer);
        let report = crate::verify(dir.path(), &|_, _| {}).unwrap();
        assert_eq!(report.problems, []);
        let notes = report.notes.join("\n");
        assert!(
            notes.contains("`Mug` and `mug` are easily confused"),
            "{notes}"
        );
    }

    #[test]
    fn several_names_are_printed() {
        let change = NameChange {
            scene: Some("lab".parse().unwrap()),
            operator: Some("Ada".parse().unwrap()),
            ..NameChange::default()
        };
        assert_eq!(change.to_string(), "scene lab, operator Ada");
        assert!(!change.is_empty() && NameChange::default().is_empty());
    }
}
