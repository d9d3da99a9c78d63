//! Brings a dataset of an earlier version of the format to this one.

use std::path::Path;

use serde::Serialize;

use super::descriptor::Descriptor;
use super::disk::{Disk, SystemDisk, replace};
use super::layout::{DATASET_TOML, Layout};
use super::lock::DatasetLock;
use super::schema::SCHEMA_VERSION;
use super::writer::DatasetWriter;
use gripcast_base::error::Result;
use gripcast_base::files::FileKind;

/// Result of a migration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct MigrateReport {
    /// Version of the format before.
    pub from: u32,
    /// Version of the format now.
    pub to: u32,
}

/// Brings a dataset to this version of the format. Any change of it does the same.
///
/// # Errors
/// `NotFound` or `Input` without a dataset, or for one of a newer version; `Busy` while it is
/// written; `DiskFull`, `Io`, … with the dataset as before.
pub fn migrate(path: impl AsRef<Path>) -> Result<MigrateReport> {
    let layout = Layout::new(path.as_ref());
    Descriptor::read(&layout)?;
    let _lock = DatasetLock::acquire(&layout)?;
    // Again: another process may have written it until it was locked.
    let mut descriptor = Descriptor::read(&layout)?;
    let from = descriptor.schema;
    raise(&SystemDisk, &layout, &mut descriptor)?;
    Ok(MigrateReport {
        from,
        to: descriptor.schema,
    })
}

impl DatasetWriter {
    /// Brings the dataset to this version of the format, before the first record of this version:
    /// an earlier gripcast then refuses the dataset as a whole, instead of single grasps.
    pub(super) fn migrate(&mut self) -> Result<()> {
        raise(self.disk.as_ref(), &self.layout, &mut self.descriptor)
    }
}

/// Replaces `dataset.toml` where it is of an earlier version: the only file that needs it.
pub(super) fn raise(disk: &dyn Disk, layout: &Layout, descriptor: &mut Descriptor) -> Result<()> {
    if descriptor.schema == SCHEMA_VERSION {
        return Ok(());
    }
    let raised = Descriptor {
        schema: SCHEMA_VERSION,
        ..descriptor.clone()
    };
    let text = raised_text(layout, descriptor.schema, &raised)?;
    replace(disk, &layout.top(), DATASET_TOML, text.as_bytes()).map_err(|e| {
        let what = format!("cannot bring the dataset to version {SCHEMA_VERSION} of the format");
        layout.failed(&what, e)
    })?;
    *descriptor = raised;
    Ok(())
}

/// The file with the new version; comments and order of its lines stay where possible.
fn raised_text(layout: &Layout, from: u32, raised: &Descriptor) -> Result<String> {
    let stored = layout.dataset_toml().read_to_string(FileKind::Record);
    let stored = stored.unwrap_or_default();
    let edited = stored.replacen(
        &format!("schema = {from}"),
        &format!("schema = {SCHEMA_VERSION}"),
        1,
    );
    if Descriptor::parse(&edited).is_ok_and(|found| found == *raised) {
        Ok(edited)
    } else {
        raised.to_toml()
    }
}
