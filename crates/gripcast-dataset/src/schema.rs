//! Versions of the files of a dataset.
//!
//! | version | added |
//! | --- | --- |
//! | 1 | |
//! | 2 | `fields`, `shear` and `force` of a stage, `lift` of a grasp |
//!
//! A record of an earlier version is a valid one of this version, so records are not rewritten; only
//! `dataset.toml` is, before the first record of this version.

use std::ops::RangeInclusive;

use gripcast_base::error::{Error, Result};

/// Version of the dataset format that this build writes: `dataset.toml`, `initial.json` and
/// `grasp.json`.
pub const SCHEMA_VERSION: u32 = 2;
/// Versions of these files that this build reads.
pub(super) const READABLE: RangeInclusive<u32> = 1..=SCHEMA_VERSION;
/// Version of the files in `splits/`.
pub(super) const SPLIT_VERSION: u32 = 1;

/// Refuses unsupported versions of the format.
pub(super) fn check_schema(schema: i64) -> Result<()> {
    check_version(schema, READABLE)
}

/// Refuses versions other than those of `readable`.
pub(super) fn check_version(found: i64, readable: RangeInclusive<u32>) -> Result<()> {
    if u32::try_from(found).is_ok_and(|version| readable.contains(&version)) {
        return Ok(());
    }
    let newest = *readable.end();
    let error = Error::input(format!(
        "unsupported dataset format version {found}, expected {}",
        match readable.start() {
            oldest if *oldest == newest => newest.to_string(),
            oldest => format!("{oldest} to {newest}"),
        }
    ));
    Err(if found > i64::from(newest) {
        error.remedy("update gripcast")
    } else {
        error.remedy("restore the file from a backup")
    })
}
