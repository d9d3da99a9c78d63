//! What a format is to the export.

use super::choice::Survey;
use super::plan::ExportPlan;
use super::source::Grasp;
use super::staged::StagedFolder;
use gripcast_base::error::{Error, Result};
use gripcast_dataset::{Descriptor, GraspId};

/// A format that is being written.
pub(super) trait Writer {
    /// All further grasps are of this part.
    fn begin_part(&mut self, part: &str) -> Result<()>;

    /// Adds a grasp, or says why the format cannot hold it; nothing of it is written then.
    ///
    /// # Errors
    /// The export cannot be written.
    fn push(&mut self, grasp: Grasp) -> Result<Option<Error>>;

    /// Writes the rest; what the format cannot hold of the grasps.
    ///
    /// # Errors
    /// The export cannot be written.
    fn finish(self: Box<Self>) -> Result<Vec<String>>;
}

/// What a writer is made from.
#[derive(Clone, Copy)]
pub(super) struct Setting<'a> {
    pub(super) folder: &'a StagedFolder,
    pub(super) plan: &'a ExportPlan,
    pub(super) survey: &'a Survey,
    pub(super) descriptor: &'a Descriptor,
    /// Names of the parts.
    pub(super) parts: &'a [(String, Vec<GraspId>)],
}
