//! Which printed boards the external camera sees.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use gripcast_base::error::{Error, Result};
use gripcast_base::files::{ObjectName, Root};
use gripcast_capture::calibration::BoardsConfig;
use gripcast_pose::BoardFile;
use gripcast_virtual_rig::VirtualHand;

/// The gripper's tags and the sheets of objects.
pub struct Boards {
    /// The tags.
    pub tags: BoardFile,
    sheets: Sheets,
}

enum Sheets {
    /// One for all objects.
    One(Box<BoardFile>),
    /// By name of the object.
    ByObject(BTreeMap<ObjectName, BoardFile>),
    /// That of the object on the virtual table.
    Virtual(Arc<VirtualHand>),
}

impl Boards {
    /// Reads the files of a rig.
    ///
    /// # Errors
    /// `NotFound`, `Io`, or `Config`, `Input` for a file that is no board.
    pub fn read(config: &BoardsConfig) -> Result<Self> {
        Ok(Self {
            tags: BoardFile::load(&config.tags)?,
            sheets: if config.sheets.is_dir() {
                Sheets::ByObject(read_sheets(&config.sheets)?)
            } else {
                Sheets::One(Box::new(BoardFile::load(&config.sheets)?))
            },
        })
    }

    /// Those of the virtual rig.
    ///
    /// # Errors
    /// None; a test reads the file.
    pub fn of_virtual_rig(hand: Arc<VirtualHand>) -> Result<Self> {
        Ok(Self {
            tags: BoardFile::gripper_umi()?,
            sheets: Sheets::Virtual(hand),
        })
    }

    /// The sheet that an object of this name stands on.
    ///
    /// # Errors
    /// `Input` for a damaged film.
    pub fn sheet(&self, object: &str) -> Result<Option<BoardFile>> {
        match &self.sheets {
            Sheets::One(sheet) => Ok(Some((**sheet).clone())),
            Sheets::ByObject(sheets) => Ok(sheets.get(object).cloned()),
            Sheets::Virtual(hand) => hand.film().sheet().map(Some),
        }
    }
}

/// Board files of a folder by the names of the files, which are those of the objects.
///
/// # Errors
/// `NotFound`, `Io`, or those of a file that is no board.
pub fn read_sheets(folder: &Path) -> Result<BTreeMap<ObjectName, BoardFile>> {
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
