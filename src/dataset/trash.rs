//! Nothing is deleted: what is undone, discarded or unusable moves to `trash/`.

use std::io;
use std::path::{Path, PathBuf};

use super::disk::Disk;
use super::layout::Layout;

/// File beside what recovery has set aside.
const REASON: &str = "reason.txt";

/// A name in `trash/` that is free: `name`, `name.2`, `name.3`, …
pub(super) fn free_slot(layout: &Layout, name: &str) -> PathBuf {
    let trash = layout.trash();
    let mut slot = trash.join(name);
    let mut number = 2;
    while slot.symlink_metadata().is_ok() {
        slot = trash.join(format!("{name}.{number}"));
        number += 1;
    }
    slot
}

/// Moves `path`, which lies in `parent`, into `trash/` and says why in a file beside it.
pub(super) fn set_aside(
    disk: &dyn Disk,
    layout: &Layout,
    path: &Path,
    reason: &str,
) -> io::Result<PathBuf> {
    let name = path.file_name().unwrap_or_default();
    let parent = path.parent().unwrap_or_else(|| layout.root());
    let plain = name.to_string_lossy();
    let plain = plain.trim_start_matches('.');
    let slot = if path.is_dir() {
        let slot = free_slot(layout, plain);
        disk.rename_new(path, &slot)?;
        slot
    } else {
        // A loose file gets a directory of its own, named after the grasp it came from.
        let from = parent.file_name().unwrap_or_default().to_string_lossy();
        let slot = free_slot(layout, &format!("{from}.{plain}"));
        disk.create_dir(&slot)?;
        disk.rename_new(path, &slot.join(name))?;
        slot
    };
    disk.sync_dir(&layout.trash())?;
    disk.sync_dir(parent)?;
    // The move is what matters; on a full disk it succeeds where the explanation cannot be written.
    let _ = disk.write(&slot.join(REASON), format!("{reason}\n").as_bytes());
    Ok(slot)
}
