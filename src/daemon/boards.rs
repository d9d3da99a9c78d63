//! Printed boards in view of the external camera.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use gripcast_base::error::{Error, Result};
use gripcast_base::files::{ObjectName, Root};
use gripcast_capture::calibration::BoardsConfig;
use gripcast_pose::BoardFile;
use gripcast_virtual_rig::VirtualHand;

/// Tags of the gripper and sheets of the objects.
pub struct Boards {
    /// Tags of the gripper.
    pub tags: BoardFile,
    sheets: Sheets,
}

enum Sheets {
    /// One sheet for all objects.
    One(Box<BoardFile>),
    /// Sheets by object name.
    ByObject(BTreeMap<ObjectName, BoardFile>),
    /// The sheet of the virtual rig's current object.
    Virtual(Arc<VirtualHand>),
}

impl Boards {
    /// Reads the board files of a rig.
    ///
    /// # Errors
    /// `NotFound`, `Io`; `Config`, `Input` for an invalid board file.
    pub fn read(config: &BoardsConfig) -> Result<Self> {
        Ok(Self {
            tags: BoardFile::load(&config.tags)?,
            sheets: if config.sheets.is_dir() {
                Sheets::ByObject(read_object_boards(&config.sheets)?)
            } else {
                Sheets::One(Box::new(BoardFile::load(&config.sheets)?))
            },
        })
    }

    /// Returns the boards of a virtual rig.
    ///
    /// # Errors
    /// None; a test reads the built-in file.
    pub fn from_virtual_hand(hand: Arc<VirtualHand>) -> Result<Self> {
        Ok(Self {
            tags: BoardFile::gripper_umi()?,
            sheets: Sheets::Virtual(hand),
        })
    }

    /// Returns the sheet of an object.
    ///
    /// # Errors
    /// `Input` for a damaged clip.
    pub fn sheet(&self, object: &str) -> Result<Option<BoardFile>> {
        match &self.sheets {
            Sheets::One(sheet) => Ok(Some((**sheet).clone())),
            Sheets::ByObject(sheets) => Ok(sheets.get(object).cloned()),
            Sheets::Virtual(hand) => hand.clip().sheet().map(Some),
        }
    }
}

/// Reads the board files `OBJECT.toml` in a folder.
///
/// # Errors
/// `NotFound`, `Io`; errors of an invalid board file.
pub fn read_object_boards(folder: &Path) -> Result<BTreeMap<ObjectName, BoardFile>> {
    let unreadable = |e| Error::io("cannot read the sheets", e).at(folder.display());
    let mut sheets = BTreeMap::new();
    for entry in Root::new(folder).top().entries().map_err(unreadable)? {
        let name = entry.name();
        if let Some(name) = name.strip_suffix(".toml")
            && let Ok(name) = ObjectName::parse(name)
        {
            sheets.insert(name, BoardFile::load(&entry.shown())?);
        }
    }
    Ok(sheets)
}
