//! Version of the dataset format.

use gripcast_base::error::{Error, Result};

/// Version of the dataset format that this build writes.
pub const SCHEMA_VERSION: u32 = 1;

/// Refuses versions of the format that this build does not know.
pub(super) fn check_schema(schema: i64) -> Result<()> {
    if schema == i64::from(SCHEMA_VERSION) {
        return Ok(());
    }
    let error = Error::input(format!(
        "format version {schema}, but this gripcast reads version {SCHEMA_VERSION}"
    ));
    Err(if schema > i64::from(SCHEMA_VERSION) {
        error.remedy("update gripcast")
    } else {
        error.remedy("the version is not a valid one; restore the file from a copy")
    })
}
