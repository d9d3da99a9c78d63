//! Report of an import, stored beside the shards.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::left_out::LeftOut;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{FileKind, Printable, Root};
use gripcast_dataset::shard::SplitFractions;

/// File name of the report.
const FILE: &str = "import.json";
const FORMAT: &str = "gripcast-import";
const VERSION: u32 = 1;

/// Report of an import.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImportReport {
    format: String,
    version: u32,
    /// Name of the imported dataset.
    pub from: String,
    /// Whether all shards are written.
    pub is_finished: bool,
    /// Imported files.
    pub files: Vec<SourceFile>,
    /// Requested fractions of the splits.
    pub fractions: SplitFractions,
    /// Imported splits.
    pub splits: BTreeMap<String, ImportedSplit>,
    /// Unreadable grasps.
    pub left_out: Vec<LeftOut>,
}

/// An imported file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SourceFile {
    /// File name.
    pub name: String,
    /// Size, bytes.
    pub bytes: u64,
}

/// Numbers of an imported split.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImportedSplit {
    /// Number of stable grasps.
    pub stable: usize,
    /// Number of slipped grasps.
    pub slip: usize,
    /// Number of objects.
    pub objects: usize,
}

impl ImportReport {
    pub(super) fn new(from: &str, files: Vec<SourceFile>, fractions: &SplitFractions) -> Self {
        Self {
            format: FORMAT.to_owned(),
            version: VERSION,
            from: from.to_owned(),
            is_finished: false,
            files,
            fractions: fractions.clone(),
            splits: BTreeMap::new(),
            left_out: Vec::new(),
        }
    }

    /// Reads the report of an import.
    ///
    /// # Errors
    /// `NotFound` without an import; `Input` for another format or version.
    pub fn read(folder: &Path) -> Result<Self> {
        let path = Root::new(folder).top().join(FILE);
        let read = || {
            let bytes = path
                .read(FileKind::List)
                .map_err(|e| Error::io("cannot read the report of the import", e))?;
            let found: Self = serde_json::from_slice(&bytes)
                .map_err(|e| Error::input(format!("invalid report of an import: {e}")))?;
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
            e.at(path.display())
                .remedy("give a directory written by `gripcast dataset import --out`")
        })
    }

    /// Claims a directory for this import: it must be new, empty, or contain the same unfinished
    /// import.
    ///
    /// # Errors
    /// `Input`: the directory has other contents; those of the operating system.
    pub(super) fn claim(&self, out: &Path) -> Result<()> {
        fs::create_dir_all(out)
            .map_err(|e| Error::io("cannot create the directory", e).at(out.display()))?;
        let refused = |what: &str| {
            let error = Error::input(what).at(out.display());
            Err(error.remedy("give a new directory"))
        };
        let top = Root::new(out).top();
        if top.join(FILE).is_taken() {
            let existing = Self::read(out)?;
            if existing.is_finished {
                return refused("the directory contains a finished import");
            }
            let started = Self {
                splits: BTreeMap::new(),
                left_out: Vec::new(),
                ..existing
            };
            if started != *self {
                return refused("the directory contains another unfinished import");
            }
            return Ok(());
        }
        let entries = top
            .entries()
            .map_err(|e| Error::io("cannot read the directory", e).at(out.display()))?;
        for entry in entries {
            let name = entry.name();
            // Leftovers of a kill are allowed.
            if !(name.starts_with(".gripcast-") && name.ends_with(".partial")) {
                let name = Printable(&name);
                return refused(&format!("the directory contains {name}"));
            }
        }
        self.save(out)
    }

    pub(super) fn save(&self, out: &Path) -> Result<()> {
        let text = serde_json::to_string_pretty(self)
            .map_err(|e| Error::internal("cannot write JSON").because(e))?;
        let path = Root::new(out).top().join(FILE);
        path.replace(format!("{text}\n").as_bytes())
            .map_err(|e| Error::io("cannot write the report of the import", e).at(path.display()))
    }
}
