//! Report of an export.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::Serialize;

use crate::left_out::LeftOut;
use gripcast_dataset::Outcome;

/// Result of an export.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ExportReport {
    /// Name of the format.
    pub format: String,
    /// Path of the export.
    pub out: PathBuf,
    /// Number of exported grasps.
    pub grasps: usize,
    /// Exported grasps by split.
    pub splits: BTreeMap<String, usize>,
    /// Exported grasps by outcome.
    pub outcomes: BTreeMap<Outcome, usize>,
    /// Number of files.
    pub files: usize,
    /// Total size of the files, bytes.
    pub bytes: u64,
    /// Number of grasps left out because they are unlabelled.
    pub unlabelled: usize,
    /// Number of grasps left out because they are not in the split.
    pub not_in_split: usize,
    /// Data that the format cannot represent.
    pub notes: Vec<String>,
    /// Damaged grasps, and those that the format cannot represent.
    pub left_out: Vec<LeftOut>,
}
