//! Settings of an export.

use std::fmt;
use std::path::PathBuf;
use std::time::Duration;

/// Default size of a shard, bytes, common with Hugging Face and WebDataset.
const SHARD_BYTES: usize = 256 << 20;
/// Input size of the models, width and height in pixels: the size of images in training shards, and
/// the default in Zarr.
pub(super) const SIZE: (u32, u32) = (320, 240);

/// Default time of a sequence after the grasp.
const LIFT: Duration = Duration::from_secs(3);

/// Formats of an export.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExportFormat {
    /// Parquet shards with embedded images, for Hugging Face `datasets` and pandas.
    Parquet,
    /// Tar shards, for `webdataset`.
    WebDataset,
    /// LeRobot version 3; a grasp is an episode of two frames, or of a sequence.
    LeRobot,
    /// Zarr version 2 with the replay-buffer layout of UMI and Diffusion Policy.
    Zarr,
    /// Shards of labelled samples at the models' size, for `train` and `eval`.
    Training,
}

impl ExportFormat {
    /// Name on the command line and in reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Parquet => "parquet",
            Self::WebDataset => "webdataset",
            Self::LeRobot => "lerobot",
            Self::Zarr => "zarr",
            Self::Training => "training",
        }
    }

    /// Whether it has the lift frames.
    pub(super) fn carries_lifts(self) -> bool {
        matches!(self, Self::Parquet | Self::WebDataset)
    }

    /// Name of the split of all grasps without a split file.
    pub(super) fn default_split(self) -> &'static str {
        match self {
            Self::Training => "test",
            _ => "train",
        }
    }
}

impl fmt::Display for ExportFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// Settings of an export.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ExportPlan {
    /// Format of the export.
    pub format: ExportFormat,
    /// Name of a split file; grasps that are not in it are left out.
    pub split_file: Option<String>,
    /// Exports only this split, of `split_file` or of the only split file.
    pub only_split: Option<String>,
    /// Leaves out unlabelled grasps; LeRobot and Training always do.
    pub only_labelled: bool,
    /// LeRobot: exports sequences from the black box instead of two frames per grasp.
    pub sequences: Option<SequencePlan>,
    /// Width and height of images in Zarr, pixels.
    pub size: (u32, u32),
    /// Maximum size of a shard (Parquet, WebDataset, Training), bytes; only a single grasp may be
    /// larger.
    pub shard_bytes: usize,
}

/// How sequences are cut from the black box.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SequencePlan {
    /// Directory of the black box; `None`: `blackbox` in the dataset.
    pub black_box: Option<PathBuf>,
    /// Frames per second; `None`: the rate of the slowest camera.
    pub fps: Option<u32>,
    /// Maximum time before the grasp; `None`: from the initial trigger.
    pub approach: Option<Duration>,
    /// Time after the grasp; a sequence ends earlier where the label was given earlier.
    pub lift: Duration,
}

impl Default for SequencePlan {
    fn default() -> Self {
        Self {
            black_box: None,
            fps: None,
            approach: None,
            lift: LIFT,
        }
    }
}

impl ExportPlan {
    /// Exports all grasps as one split.
    #[must_use]
    pub fn new(format: ExportFormat) -> Self {
        Self {
            format,
            split_file: None,
            only_split: None,
            only_labelled: false,
            sequences: None,
            size: SIZE,
            shard_bytes: SHARD_BYTES,
        }
    }

    /// Whether unlabelled grasps are left out.
    pub(super) fn requires_labels(&self) -> bool {
        let always = [ExportFormat::LeRobot, ExportFormat::Training];
        self.only_labelled || always.contains(&self.format)
    }
}
