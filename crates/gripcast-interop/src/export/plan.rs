//! What is to be exported, and how.

use std::fmt;

/// Size of a shard unless another is asked for, bytes: what Hugging Face and WebDataset users
/// stream at a time.
const SHARD_BYTES: usize = 256 << 20;
/// What the models of this program see, width and height in pixels: the size of images in shards
/// for them, and in Zarr unless another is asked for.
pub(super) const SIZE: (u32, u32) = (320, 240);

/// Formats that others read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExportFormat {
    /// Parquet shards with embedded images, for Hugging Face `datasets` and pandas.
    Parquet,
    /// Tar shards, for `webdataset`.
    WebDataset,
    /// LeRobot's format, version 3: a grasp is an episode of two frames.
    LeRobot,
    /// Zarr arrays, version 2, laid out as the replay buffer of UMI and Diffusion Policy.
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

    /// Name of the part that all grasps are in without a split: what Hugging Face calls it, and
    /// what `eval` measures.
    pub(super) fn whole(self) -> &'static str {
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

/// Which grasps go where.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ExportPlan {
    /// The format.
    pub format: ExportFormat,
    /// Name of a split: its parts are kept apart, grasps of no part left out.
    pub split: Option<String>,
    /// Only this part, of the split or of the only one there is.
    pub part: Option<String>,
    /// Leave out what is not labelled; LeRobot and Training always do.
    pub only_labelled: bool,
    /// Width and height of images in Zarr, pixels.
    pub size: (u32, u32),
    /// Most bytes of a shard (Parquet, WebDataset, Training); only a single grasp may be larger.
    pub shard_bytes: usize,
}

impl ExportPlan {
    /// All grasps in one part.
    #[must_use]
    pub fn new(format: ExportFormat) -> Self {
        Self {
            format,
            split: None,
            part: None,
            only_labelled: false,
            size: SIZE,
            shard_bytes: SHARD_BYTES,
        }
    }

    /// Whether grasps without a label are left out.
    pub(super) fn wants_labels(&self) -> bool {
        let always = [ExportFormat::LeRobot, ExportFormat::Training];
        self.only_labelled || always.contains(&self.format)
    }
}
