//! Problems of a dataset, and the report of a verification.

use std::collections::BTreeSet;

use serde::Serialize;

use gripcast_base::files::GraspId;

/// Kind of a problem.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum ProblemKind {
    /// `dataset.toml` is missing or unreadable.
    Descriptor,
    /// An unfinished save.
    Torn,
    /// An unreadable record.
    UnreadableRecord,
    /// A name that is not stored in its normal form: third-party programs take it for another one.
    Name,
    /// The record's id differs from the directory's name.
    IdMismatch,
    /// Two directories contain the same grasp.
    DuplicateId,
    /// A file listed in the record is missing.
    MissingFile,
    /// A file that is not listed in any record.
    ExtraFile,
    /// A file's size or sha256 differs from the record.
    Altered,
    /// An image is incomplete or not of the recorded size.
    DamagedImage,
    /// A field array is not the one that the record describes.
    DamagedField,
    /// Two files of the dataset are identical: a frozen camera or a copied grasp.
    DuplicateContent,
    /// A calibration is missing or altered.
    Calibration,
    /// A model card is altered.
    Model,
    /// `metadata.jsonl` differs from the records.
    Index,
    /// A split file is unreadable or lists missing grasps.
    Split,
    /// A group is in two splits.
    Leak,
}

impl ProblemKind {
    /// Remedy for problems of this kind.
    pub(super) fn remedy(self) -> &'static str {
        match self {
            Self::MissingFile | Self::Altered => {
                "restore it from a backup, or run `gripcast dataset recover`"
            }
            Self::DamagedImage => {
                "the camera sent a damaged image: move the grasp to trash/ to exclude it"
            }
            Self::DamagedField => "move the grasp to trash/ to exclude it",
            Self::DuplicateContent => "inspect both and move the invalid grasp to trash/",
            Self::Calibration | Self::Model => {
                "restore it from a backup: its name is the beginning of its sha256"
            }
            Self::Index => "run `gripcast dataset reindex`",
            Self::Split | Self::Leak => "make the split again with `gripcast dataset split`",
            _ => "run `gripcast dataset recover`",
        }
    }
}

/// A problem of a dataset.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct Problem {
    /// Kind of the problem.
    pub kind: ProblemKind,
    /// Affected grasp, if any.
    pub grasp: Option<GraspId>,
    /// Affected file, relative to the dataset.
    pub file: Option<String>,
    /// Description.
    pub detail: String,
    /// Remedy.
    pub remedy: String,
}

/// Number of examples in a [`ProblemSummary`].
const EXAMPLES: usize = 3;

/// Problems of one kind.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ProblemSummary {
    /// Kind of the problems.
    pub kind: ProblemKind,
    /// Number of problems.
    pub problems: usize,
    /// Number of affected grasps.
    pub grasps: usize,
    /// The first affected grasps, at most 3.
    pub examples: Vec<GraspId>,
}

/// Result of a verification.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct VerifyReport {
    /// Number of complete grasps.
    pub grasps: usize,
    /// Number of unlabelled grasps.
    pub unlabelled: usize,
    /// Number of pending initial frames.
    pub pending: usize,
    /// Notes that are not problems.
    pub notes: Vec<String>,
    /// Problems summed up by kind.
    pub by_kind: Vec<ProblemSummary>,
    /// All problems, sorted by kind, grasp and file.
    pub problems: Vec<Problem>,
}

/// Sums up sorted problems.
pub(super) fn by_kind(problems: &[Problem]) -> Vec<ProblemSummary> {
    let kinds = problems.chunk_by(|a, b| a.kind == b.kind);
    let summaries = kinds.filter_map(|problems| {
        let grasps: BTreeSet<&GraspId> = problems.iter().filter_map(|p| p.grasp.as_ref()).collect();
        Some(ProblemSummary {
            kind: problems.first()?.kind,
            problems: problems.len(),
            grasps: grasps.len(),
            examples: grasps.into_iter().take(EXAMPLES).cloned().collect(),
        })
    });
    summaries.collect()
}
