//! Version of the dataset format.

use gripcast_base::error::{Error, Result};

/// Version of the dataset format that this build writes.
pub const SCHEMA_VERSION: u32 = 1;

/// Refuses unsupported versions of the format.
pub(super) fn check_schema(schema: i64) -> Result<()> {
    if schema == i64::from(SCHEMA_VERSION) {
        return Ok(());
    }
    let error = Error::input(format!(
        "unsupported dataset format version {schema}, expected {SCHEMA_VERSION}"
    ));
    Err(if schema > i64::from(SCHEMA_VERSION) {
        error.remedy("update gripcast")
    } else {
        error.remedy("restore the file from a backup")
    })
}
