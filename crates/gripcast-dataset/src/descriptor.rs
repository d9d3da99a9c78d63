//! `dataset.toml`: the description of a dataset.

use std::io;

use serde::{Deserialize, Serialize};

use super::layout::Layout;
use super::schema::{SCHEMA_VERSION, check_schema};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::FileKind;

/// Description of a new dataset.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NewDataset {
    /// Name of the dataset.
    pub name: String,
    /// Id of the rig that collects it.
    pub rig: String,
    /// Licence of the data, an SPDX expression if possible.
    pub licence: String,
    /// What `stable` and `slip` mean here.
    pub label_definition: String,
}

/// `dataset.toml`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Descriptor {
    /// Version of the dataset format.
    pub schema: u32,
    /// Name of the dataset.
    pub name: String,
    /// Id of the rig that created it; each grasp names its own.
    pub rig: String,
    /// Licence of the data.
    pub licence: String,
    /// What `stable` and `slip` mean here.
    pub label_definition: String,
    /// `gripcast <version>` that created the dataset.
    pub software: String,
}

/// `gripcast <version>`, as stored in every record.
pub(super) const SOFTWARE: &str = concat!("gripcast ", env!("CARGO_PKG_VERSION"));

impl Descriptor {
    /// Adds schema and software to the description of a new dataset.
    pub(super) fn new(new: &NewDataset) -> Self {
        Self {
            schema: SCHEMA_VERSION,
            name: new.name.clone(),
            rig: new.rig.clone(),
            licence: new.licence.clone(),
            label_definition: new.label_definition.clone(),
            software: SOFTWARE.to_owned(),
        }
    }

    pub(super) fn to_toml(&self) -> Result<String> {
        toml::to_string_pretty(self)
            .map_err(|e| Error::internal("cannot write the description as TOML").because(e))
    }

    /// Reads the description.
    ///
    /// # Errors
    /// `NotFound` where there is no dataset, `Input` when it is unreadable or of a newer version.
    pub(super) fn read(layout: &Layout) -> Result<Self> {
        let path = layout.dataset_toml();
        let text = path
            .read_to_string(FileKind::Record)
            .map_err(|e| not_readable(layout, e))?;
        Self::parse(&text).map_err(|e| e.at(path.display()))
    }

    pub(super) fn parse(text: &str) -> Result<Self> {
        let unreadable = |e: toml::de::Error| {
            Error::input("cannot read the dataset's description")
                .because(e)
                .remedy("correct the line, or restore the file from a backup")
        };
        let table: toml::Table = text.parse().map_err(unreadable)?;
        // The version is checked first: other versions may have other keys.
        if let Some(schema) = table.get("schema").and_then(toml::Value::as_integer) {
            check_schema(schema)?;
        }
        table.try_into().map_err(unreadable)
    }
}

fn not_readable(layout: &Layout, error: io::Error) -> Error {
    let root = layout.root();
    if error.kind() == io::ErrorKind::NotFound {
        return if !root.exists() {
            Error::not_found("dataset not found")
                .remedy("check the path; `gripcast collect --dataset DIR` creates a new one")
        } else if layout.grasps().is_dir() {
            Error::not_found("dataset.toml is missing").remedy(format!(
                "run `gripcast dataset recover {}` to write it again",
                root.display()
            ))
        } else {
            Error::not_found("not a dataset: dataset.toml not found")
                .remedy("give the directory that contains dataset.toml and grasps/")
        }
        .at(root.display());
    }
    if error.kind() == io::ErrorKind::NotADirectory {
        return Error::input("expected a dataset directory, found a file").at(root.display());
    }
    Error::io("cannot read the dataset's description", error).at(layout.dataset_toml().display())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn descriptor() -> Descriptor {
        Descriptor::new(&NewDataset {
            name: "kitchen".into(),
            rig: "bench-1".into(),
            licence: "CC-BY-4.0".into(),
            label_definition: "stable = still in the gripper 3 s after the lift".into(),
        })
    }

    #[test]
    fn descriptor_round_trips() {
        let text = descriptor().to_toml().unwrap();
        assert_eq!(Descriptor::parse(&text).unwrap(), descriptor());
    }

    #[test]
    fn newer_version_is_reported_before_unknown_keys() {
        let text = "schema = 3\nsurprise = true\n";
        let error = Descriptor::parse(text).unwrap_err().to_string();
        assert!(
            error.contains("version 3, expected 1 to 2") && error.contains("update gripcast"),
            "{error}"
        );
    }

    #[test]
    fn unknown_keys_and_invalid_toml_are_refused() {
        let text = descriptor().to_toml().unwrap() + "colour = \"red\"\n";
        let error = Descriptor::parse(&text).unwrap_err().to_string();
        assert!(error.contains("colour"), "{error}");
        assert!(Descriptor::parse("schema = [").is_err());
        assert!(Descriptor::parse("schema = 0").is_err());
    }
}
