//! The `gripcast` key of a file's metadata.

use serde::{Deserialize, Serialize};

use gripcast_base::error::{Error, Result};

/// Key of our own metadata.
pub(super) const KEY: &str = "gripcast";
/// Key that Hugging Face `datasets` reads the features from.
pub(super) const HUGGINGFACE_KEY: &str = "huggingface";
/// Who wrote the file. Others keep our key when they write rows of theirs, so the hashes count
/// only with this.
pub(super) const CREATED_BY: &str = "gripcast-shard version 1.0.0";
/// Name of the format.
const FORMAT: &str = "gripcast-shard";
/// Name of the format of `dataset export --to parquet`.
pub const EXPORT: &str = "gripcast-export";
/// Version of the format.
const VERSION: u32 = 1;

/// What the key holds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct ShardMetadata {
    format: String,
    version: u32,
    /// JSON of the caller, as it was given.
    pub(super) info: String,
    /// One a row group, in their order.
    pub(super) row_groups: Vec<GroupHash>,
}

/// Hashes of a row group.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct GroupHash {
    /// Number of rows.
    pub rows: usize,
    /// Of the facts, row by row.
    pub(super) facts_sha256: String,
    /// Of the images, row by row.
    pub(super) images_sha256: String,
}

impl ShardMetadata {
    pub(super) fn new(info: String, row_groups: Vec<GroupHash>) -> Self {
        Self {
            format: FORMAT.to_owned(),
            version: VERSION,
            info,
            row_groups,
        }
    }

    pub(super) fn to_json(&self) -> Result<String> {
        serde_json::to_string(self)
            .map_err(|e| Error::internal("cannot write the metadata").because(e))
    }

    /// # Errors
    /// `Input`: it is not ours, or of a version that is not known here.
    pub(super) fn parse(text: &str) -> Result<Self> {
        #[derive(Deserialize)]
        struct Header {
            format: String,
            version: u32,
        }
        let wrong = |e: serde_json::Error| {
            Error::input("the `gripcast` metadata cannot be read").because(e)
        };
        let Header { format, version } = serde_json::from_str(text).map_err(wrong)?;
        if format != FORMAT {
            let what = format!("this is a file of the format {format:?}, not {FORMAT:?}");
            let error = Error::input(what);
            return Err(match &*format {
                EXPORT => error.remedy(
                    "this export is for other programs; make one for `train` and `eval` with \
                     `gripcast dataset export DATASET --to training`",
                ),
                _ => error,
            });
        }
        if version != VERSION {
            let what = format!("the shard has version {version}; known is {VERSION}");
            let error = Error::input(what);
            return Err(error.remedy("read it with the release of gripcast that wrote it"));
        }
        serde_json::from_str(text).map_err(wrong)
    }
}
