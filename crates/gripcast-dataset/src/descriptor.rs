//! `dataset.toml`: what a dataset says about itself.

use std::io;

use serde::{Deserialize, Serialize};

use super::layout::Layout;
use super::schema::{SCHEMA_VERSION, check_schema};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::FileKind;

/// What a new dataset is to say about itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NewDataset {
    /// Name.
    pub name: String,
    /// Id of the rig that it is collected with.
    pub rig: String,
    /// Licence of the data, an SPDX expression where there is one.
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
    /// Name.
    pub name: String,
    /// Id of the rig that it was begun with; each grasp names its own.
    pub rig: String,
    /// Licence of the data.
    pub licence: String,
    /// What `stable` and `slip` mean here.
    pub label_definition: String,
    /// `gripcast <version>` that made the dataset.
    pub software: String,
}

/// `gripcast <version>`, as stored in every record.
pub(super) const SOFTWARE: &str = concat!("gripcast ", env!("CARGO_PKG_VERSION"));

impl Descriptor {
    /// The description of a new dataset.
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
    /// `NotFound` without a dataset there, `Input` when it is unreadable or of a newer version.
    pub(super) fn read(layout: &Layout) -> Result<Self> {
        let path = layout.dataset_toml();
        let text = path
            .read_to_string(FileKind::Record)
            .map_err(|e| not_readable(layout, e))?;
        Self::parse(&text).map_err(|e| e.at(path.display()))
    }

    fn parse(text: &str) -> Result<Self> {
        let unreadable = |e: toml::de::Error| {
            Error::input("cannot read the dataset's description")
                .because(e)
                .remedy("correct the line that is named, or restore the file from a copy")
        };
        let table: toml::Table = text.parse().map_err(unreadable)?;
        // The version decides whether the other keys mean what we think.
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
            Error::not_found("there is no such dataset")
                .remedy("check the path; `gripcast collect --dataset DIR` begins a new one")
        } else if layout.grasps().is_dir() {
            Error::not_found("the dataset lacks its dataset.toml").remedy(format!(
                "`gripcast dataset recover {}` writes it again",
                root.display()
            ))
        } else {
            Error::not_found("this is not a dataset: it has no dataset.toml")
                .remedy("give the directory that holds dataset.toml and grasps/")
        }
        .at(root.display());
    }
    if error.kind() == io::ErrorKind::NotADirectory {
        return Error::input("this is a file, not a dataset's directory").at(root.display());
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
            label_definition: "stable = still held 3 s after the lift".into(),
        })
    }

    #[test]
    fn reads_what_it_writes() {
        let text = descriptor().to_toml().unwrap();
        assert_eq!(Descriptor::parse(&text).unwrap(), descriptor());
    }

    #[test]
    fn a_newer_version_is_explained_before_its_unknown_keys() {
        let text = "schema = 2\nsurprise = true\n";
        let error = Descriptor::parse(text).unwrap_err().to_string();
        assert!(
            error.contains("version 2") && error.contains("update gripcast"),
            "{error}"
        );
    }

    #[test]
    fn unknown_keys_and_nonsense_are_refused() {
        let text = descriptor().to_toml().unwrap() + "colour = \"red\"\n";
        let error = Descriptor::parse(&text).unwrap_err().to_string();
        assert!(error.contains("colour"), "{error}");
        assert!(Descriptor::parse("schema = [").is_err());
        assert!(Descriptor::parse("schema = 0").is_err());
    }
}
