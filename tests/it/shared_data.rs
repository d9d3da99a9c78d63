//! Real data that is not part of the repository.

use std::path::PathBuf;

use crate::skip::{Needs, skip};

/// Path of an item of the shared folder (`GRIPCAST_SHARED`, else `../shared`); without it, the
/// calling test is skipped.
pub(crate) fn shared(item: &str) -> Option<PathBuf> {
    let root = std::env::var_os("GRIPCAST_SHARED").map_or_else(
        || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared"),
        PathBuf::from,
    );
    let path = root.join(item);
    if path.exists() {
        return Some(path);
    }
    skip(
        Needs::Shared,
        format_args!("{} is not there (set GRIPCAST_SHARED)", path.display()),
    );
    None
}
