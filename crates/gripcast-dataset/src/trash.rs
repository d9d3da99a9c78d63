//! Nothing is deleted: undone, discarded and unusable items move to `trash/`.

use std::io;

use super::disk::{Disk, move_item};
use super::layout::Layout;
use gripcast_base::files::{BeneathPath, Component, FileName};

/// File that states why an item was moved to the trash.
const REASON: &str = "reason.txt";

/// Returns an unused path in `trash/`: `name`, `name.2`, `name.3`, …
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

/// Moves `path` into `trash/` and writes the reason into a file beside it.
pub(super) fn move_to_trash(
    disk: &dyn Disk,
    layout: &Layout,
    path: &BeneathPath,
    reason: &str,
) -> io::Result<BeneathPath> {
    let parent = path.parent();
    let name = path.name();
    let plain = name.trim_start_matches('.');
    // A link is moved as a link.
    let is_dir = path.is_dir() && !path.is_link();
    let slot = if is_dir {
        let slot = free_slot(layout, &FileName::nearest(plain));
        move_item(disk, path, &slot)?;
        slot
    } else {
        // A single file gets its own directory, named after the grasp it came from.
        let slot = free_slot(
            layout,
            &FileName::nearest(&format!("{}.{plain}", parent.name())),
        );
        disk.create_dir(&slot)?;
        move_item(disk, path, &path.moved_into(&slot))?;
        disk.sync_dir(&layout.trash())?;
        slot
    };
    // On a full disk the move succeeds even where the reason cannot be written.
    let _ = disk.write(&slot.join(REASON), format!("{reason}\n").as_bytes());
    Ok(slot)
}
