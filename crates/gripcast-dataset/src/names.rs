//! Corrections of a grasp's names.

use std::fmt;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::grasp::GraspRecord;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{Label, ObjectName};

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
