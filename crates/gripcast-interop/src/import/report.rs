//! What was imported, as it stands beside the shards.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::left_out::LeftOut;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{FileKind, Printable, Root};
use gripcast_dataset::shard::Split;

/// The file, beside `data/`.
const FILE: &str = "import.json";
const FORMAT: &str = "gripcast-import";
const VERSION: u32 = 1;

/// What is in an imported dataset, and what is not.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImportReport {
    format: String,
    version: u32,
    /// Whose dataset it is.
    pub from: String,
    /// Whether all shards are there.
    pub is_finished: bool,
    /// The files that were read.
    pub files: Vec<SourceFile>,
    /// The parts that were asked for.
    pub split: Split,
    /// What is in each part.
    pub parts: BTreeMap<String, ImportedPart>,
    /// Grasps that could not be read.
    pub left_out: Vec<LeftOut>,
}

/// A file that was read.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SourceFile {
    /// Its name.
    pub name: String,
    /// Its size.
    pub bytes: u64,
}

/// What is in a part.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImportedPart {
    /// Grasps that held.
    pub stable: usize,
    /// Grasps that were lost.
    pub slip: usize,
    /// Objects.
    pub objects: usize,
}

impl ImportReport {
    pub(super) fn new(from: &str, files: Vec<SourceFile>, split: &Split) -> Self {
        Self {
            format: FORMAT.to_owned(),
            version: VERSION,
            from: from.to_owned(),
            is_finished: false,
            files,
            split: split.clone(),
            parts: BTreeMap::new(),
            left_out: Vec::new(),
        }
    }

    /// What stands beside the shards.
    ///
    /// # Errors
    /// `NotFound` for a folder without an import; `Input` for facts of another kind or version.
    pub fn read(folder: &Path) -> Result<Self> {
        let place = Root::new(folder).top().join(FILE);
        let read = || {
            let bytes = place
                .read(FileKind::List)
                .map_err(|e| Error::io("cannot read the facts of the import", e))?;
            let found: Self = serde_json::from_slice(&bytes)
                .map_err(|e| Error::input(format!("these are no facts of an import: {e}")))?;
            if found.format == FORMAT && found.version == VERSION {
                return Ok(found);
            }
            let what = format!(
                "expected {FORMAT} version {VERSION}, found {:?} version {}",
                found.format, found.version
            );
            Err(Error::input(what))
        };
        read().map_err(|e: Error| {
            e.at(place.display())
                .remedy("give the folder that `gripcast dataset import --out` wrote")
        })
    }

    /// Takes a folder for this import: one that is new or empty, or has the beginning of the same
    /// import.
    ///
    /// # Errors
    /// `Input`: the folder holds something else; those of the operating system.
    pub(super) fn claim(&self, out: &Path) -> Result<()> {
        fs::create_dir_all(out)
            .map_err(|e| Error::io("cannot make the folder", e).at(out.display()))?;
        let refused = |what: &str| {
            let error = Error::input(what).at(out.display());
            Err(error.remedy("give a new folder"))
        };
        let top = Root::new(out).top();
        if top.join(FILE).is_taken() {
            let there = Self::read(out)?;
            if there.is_finished {
                return refused("the folder holds a finished import");
            }
            let begun = Self {
                parts: BTreeMap::new(),
                left_out: Vec::new(),
                ..there
            };
            if begun != *self {
                return refused("the folder holds the beginning of another import");
            }
            return Ok(());
        }
        let entries = top
            .entries()
            .map_err(|e| Error::io("cannot read the folder", e).at(out.display()))?;
        for entry in entries {
            let name = entry.name();
            // What a kill left of this file.
            if !(name.starts_with(".gripcast-") && name.ends_with(".partial")) {
                let name = Printable(&name);
                return refused(&format!("the folder holds something else: {name}"));
            }
        }
        self.save(out)
    }

    pub(super) fn save(&self, out: &Path) -> Result<()> {
        let text = serde_json::to_string_pretty(self)
            .map_err(|e| Error::internal("cannot write JSON").because(e))?;
        let place = Root::new(out).top().join(FILE);
        place
            .replace(format!("{text}\n").as_bytes())
            .map_err(|e| Error::io("cannot write the facts of the import", e).at(place.display()))
    }
}
