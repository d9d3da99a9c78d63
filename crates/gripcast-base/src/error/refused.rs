//! Files that are refused regardless of their contents.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

/// Why a file was refused; the cause inside an [`io::Error`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Refused {
    /// A symbolic link or `..` leads out of the directory.
    Outside {
        /// The directory.
        root: PathBuf,
        /// Its target, if known.
        target: Option<PathBuf>,
    },
    /// It is a device, a pipe, a socket, a directory or a symbolic link.
    NotRegular(&'static str),
    /// It exceeds the size limit of its kind.
    TooLarge {
        /// Size, bytes.
        bytes: u64,
        /// Limit, bytes.
        limit: u64,
    },
    /// It has other hard links, so that writing would change another file.
    Linked,
}

impl Refused {
    /// Remedy for the user.
    #[must_use]
    pub fn remedy(&self) -> String {
        match self {
            Self::Outside { target, .. } => {
                let folder = target.as_deref().unwrap_or(Path::new("/FOLDER"));
                format!(
                    "remove it if the data come from a third party; if you linked another disk on \
                     purpose, set GRIPCAST__FILES__LINKED_FOLDERS={} or use a bind mount \
                     (docs/explanation/security.md)",
                    folder.display()
                )
            }
            Self::NotRegular(_) => "replace it with a regular file".to_owned(),
            Self::TooLarge { .. } => "check that it is the intended file".to_owned(),
            Self::Linked => "replace it with a copy, or remove it".to_owned(),
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
