//! Files that are refused whatever they hold.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

/// Why a file was refused; the cause inside an [`io::Error`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Refused {
    /// A symbolic link or `..` leads out of the folder.
    Outside {
        /// The folder.
        root: PathBuf,
        /// Where it leads, as far as known.
        target: Option<PathBuf>,
    },
    /// It is a device, a pipe, a socket, a folder or a symbolic link.
    NotRegular(&'static str),
    /// It is larger than files of its kind can be.
    TooLarge {
        /// Its size, bytes.
        bytes: u64,
        /// The limit, bytes.
        limit: u64,
    },
    /// It has other names (hard links), through which something else would change.
    Linked,
}

impl Refused {
    /// What the user can do about it.
    #[must_use]
    pub fn remedy(&self) -> String {
        match self {
            Self::Outside { target, .. } => {
                let folder = target.as_deref().unwrap_or(Path::new("/FOLDER"));
                format!(
                    "remove it if the data come from somebody else; if you linked another disk on \
                     purpose, set GRIPCAST__FILES__LINKED_FOLDERS={} or use a bind mount \
                     (docs/security.md)",
                    folder.display()
                )
            }
            Self::NotRegular(_) => "put a regular file in its place".to_owned(),
            Self::TooLarge { .. } => "check that it is the right file".to_owned(),
            Self::Linked => "copy it to a file of its own, or remove it".to_owned(),
        }
    }
}

impl fmt::Display for Refused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Outside { root, target } => {
                f.write_str("the path or a symbolic link in it leads out of ")?;
                write!(f, "{}", root.display())?;
                match target {
                    Some(target) => write!(f, " to {}", target.display()),
                    None => Ok(()),
                }
            }
            Self::NotRegular(found) => write!(f, "expected a regular file, found {found}"),
            Self::TooLarge { bytes, limit } => {
                write!(f, "expected at most {limit} bytes, found {bytes}")
            }
            Self::Linked => f.write_str("expected a file with one name, found hard links to it"),
        }
    }
}

impl std::error::Error for Refused {}

impl From<Refused> for io::Error {
    fn from(refused: Refused) -> Self {
        Self::new(io::ErrorKind::InvalidInput, refused)
    }
}
