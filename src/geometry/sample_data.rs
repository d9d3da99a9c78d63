//! Where tests find sample data that is not part of the repository.

use std::io::Write as _;
use std::path::PathBuf;

/// The folder with the sample meshes, by `GRIPCAST_SHARED` or beside the repository. Without it,
/// says past the test harness's capture that the test is skipped.
pub(crate) fn egad_folder() -> Option<PathBuf> {
    let shared = std::env::var_os("GRIPCAST_SHARED").map_or("../shared".into(), PathBuf::from);
    let folder = shared.join("data/egad_eval");
    if folder.is_dir() {
        return Some(folder);
    }
    let test = std::thread::current();
    let _ = writeln!(
        std::io::stderr(),
        "SKIPPED {}: no sample data in {} (set GRIPCAST_SHARED)",
        test.name().unwrap_or("a test"),
        folder.display()
    );
    None
}
