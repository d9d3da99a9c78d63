//! Nothing is deleted: what is undone, discarded or unusable moves to `trash/`.

use std::io;

use super::disk::Disk;
use super::layout::Layout;
use gripcast_base::files::{BeneathPath, Component, FileName};

/// File beside what recovery has set aside.
const REASON: &str = "reason.txt";

/// A name in `trash/` that is free: `name`, `name.2`, `name.3`, …
pub(super) fn free_slot(layout: &Layout, name: &impl Component) -> BeneathPath {
    let first = layout.trash().join(name);
    let mut slot = first.clone();
    let mut number = 2;
    while slot.is_taken() {
        slot = first.numbered(number);
        number += 1;
    }
    slot
}

/// Moves `path` into `trash/` and says why in a file beside it.
pub(super) fn set_aside(
    disk: &dyn Disk,
    layout: &Layout,
    path: &BeneathPath,
    reason: &str,
) -> io::Result<BeneathPath> {
    let parent = path.parent();
    let name = path.name();
    let plain = name.trim_start_matches('.');
    // A link is moved as the link that it is.
    let is_dir = path.is_dir() && !path.is_link();
    let slot = if is_dir {
        let slot = free_slot(layout, &FileName::nearest(plain));
        disk.rename_new(path, &slot)?;
        slot
    } else {
        // A loose file gets a directory of its own, named after the grasp it came from.
        let slot = free_slot(
            layout,
            &FileName::nearest(&format!("{}.{plain}", parent.name())),
        );
        disk.create_dir(&slot)?;
        disk.rename_new(path, &path.moved_into(&slot))?;
        slot
    };
    disk.sync_dir(&layout.trash())?;
    disk.sync_dir(&parent)?;
    // The move is what matters; on a full disk it succeeds where the explanation cannot be written.
    let _ = disk.write(&slot.join(REASON), format!("{reason}\n").as_bytes());
    Ok(slot)
}
