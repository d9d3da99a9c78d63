//! What became of an export.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::Serialize;

use crate::left_out::LeftOut;
use gripcast_dataset::Outcome;

/// What was written, and what was not.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ExportReport {
    /// Name of the format.
    pub format: String,
    /// Where it is.
    pub out: PathBuf,
    /// Grasps that were written.
    pub grasps: usize,
    /// Of these, by part.
    pub parts: BTreeMap<String, usize>,
    /// Of these, by outcome.
    pub outcomes: BTreeMap<Outcome, usize>,
    /// Files of the export.
    pub files: usize,
    /// Their size.
    pub bytes: u64,
    /// Grasps left out because they are not labelled.
    pub unlabelled: usize,
    /// Grasps left out because the split does not name them.
    pub not_in_split: usize,
    /// What the format cannot hold of these grasps.
    pub notes: Vec<String>,
    /// Damaged grasps, and those that the format cannot hold.
    pub left_out: Vec<LeftOut>,
}
