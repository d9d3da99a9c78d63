//! The `gripcast` key in the metadata of a shard.

use serde::{Deserialize, Serialize};

use gripcast_base::error::{Error, Result};

/// Key of gripcast's metadata.
pub(super) const KEY: &str = "gripcast";
/// Key that Hugging Face `datasets` reads the features from.
pub(super) const HUGGINGFACE_KEY: &str = "huggingface";
/// Writer of the file. Other writers may keep our key with different rows, so the hashes are valid
/// only with this writer.
pub(super) const CREATED_BY: &str = "gripcast-shard version 1.0.0";
/// Name of the format.
const FORMAT: &str = "gripcast-shard";
/// Name of the format of `dataset export --to parquet`.
pub const EXPORT: &str = "gripcast-export";
/// Version of the format.
const VERSION: u32 = 4;
/// Oldest version that can be read: there, lists of `lift_motion` are padded with NaN. Files of
/// version 2 have no column `object_motion`, those of version 3 no `contact_map_m`.
const OLDEST_VERSION: u32 = 1;

/// Value of the key.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct ShardMetadata {
    format: String,
    version: u32,
    /// JSON of the caller, unchanged.
    pub(super) info: String,
    /// One per row group, in order.
    pub(super) row_groups: Vec<GroupHash>,
}

/// Hashes of a row group.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct GroupHash {
    /// Number of rows.
    pub rows: usize,
    /// Hash of the facts, row by row.
    pub(super) facts_sha256: String,
    /// Hash of the images, row by row.
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
    /// `Input`: another format or an unsupported version.
    pub(super) fn parse(text: &str) -> Result<Self> {
        #[derive(Deserialize)]
        struct Header {
            format: String,
            version: u32,
        }
        let unreadable =
            |e: serde_json::Error| Error::input("cannot read the `gripcast` metadata").because(e);
        let Header { format, version } = serde_json::from_str(text).map_err(unreadable)?;
        if format != FORMAT {
            let what = format!("expected a file of format {FORMAT:?}, found {format:?}");
            let error = Error::input(what);
            return Err(match &*format {
                EXPORT => error.remedy(
                    "this export is for other programs; for `train` and `eval` run \
                     `gripcast dataset export DATASET --to training`",
                ),
                _ => error,
            });
        }
        if !(OLDEST_VERSION..=VERSION).contains(&version) {
            let what = format!(
                "unsupported shard version {version}, expected {OLDEST_VERSION} to {VERSION}"
            );
            let error = Error::input(what);
            return Err(error.remedy("read it with the gripcast release that wrote it"));
        }
        serde_json::from_str(text).map_err(unreadable)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_of_the_last_version_are_read_and_newer_ones_refused() {
        let written = ShardMetadata::new("{}".into(), Vec::new());
        let text = |version: u32| {
            let current = format!("\"version\":{VERSION}");
            let json = written.to_json().unwrap();
            assert!(json.contains(&current), "{json}");
            json.replace(&current, &format!("\"version\":{version}"))
        };
        for version in [OLDEST_VERSION, VERSION] {
            assert_eq!(
                ShardMetadata::parse(&text(version)).unwrap().version,
                version
            );
        }
        for version in [OLDEST_VERSION - 1, VERSION + 1] {
            let error = ShardMetadata::parse(&text(version))
                .unwrap_err()
                .to_string();
            assert!(error.contains("expected 1 to 4"), "{error}");
        }
    }
}
