//! Interface of the export formats.

use std::path::Path;

use super::plan::ExportPlan;
use super::selection::Survey;
use super::source::Grasp;
use super::staged::StagedFolder;
use gripcast_base::error::{Error, Result};
use gripcast_dataset::{Descriptor, GraspId};

/// Writer of an export format.
pub(super) trait Writer {
    /// Starts a split, to which the following grasps belong.
    fn begin_split(&mut self, split: &str) -> Result<()>;

    /// Adds a grasp, or returns why the format cannot represent it; then nothing is written.
    ///
    /// # Errors
    /// The export cannot be written.
    fn push(&mut self, grasp: Grasp) -> Result<Option<Error>>;

    /// Completes the export; returns notes about data that the format cannot represent.
    ///
    /// # Errors
    /// The export cannot be written.
    fn finish(self: Box<Self>) -> Result<Vec<String>>;
}

/// Inputs of a writer.
#[derive(Clone, Copy)]
pub(super) struct ExportContext<'a> {
    pub(super) folder: &'a StagedFolder,
    pub(super) plan: &'a ExportPlan,
    pub(super) survey: &'a Survey,
    /// Folder of the dataset.
    pub(super) dataset: &'a Path,
    pub(super) descriptor: &'a Descriptor,
    /// Splits with their grasps.
    pub(super) splits: &'a [(String, Vec<GraspId>)],
}
