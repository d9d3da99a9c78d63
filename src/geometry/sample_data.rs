//! Where tests find sample data that is not part of the repository.

use std::path::PathBuf;

use crate::skip::{Needs, skip};

/// The folder with the sample meshes, by `GRIPCAST_SHARED` or beside the repository. Without it,
/// the calling test is skipped.
pub(crate) fn egad_folder() -> Option<PathBuf> {
    let shared = std::env::var_os("GRIPCAST_SHARED").map_or("../shared".into(), PathBuf::from);
    let folder = shared.join("data/egad_eval");
    if folder.is_dir() {
        return Some(folder);
    }
    skip(
        Needs::Shared,
        format_args!("{} is not there (set GRIPCAST_SHARED)", folder.display()),
    );
    None
}
