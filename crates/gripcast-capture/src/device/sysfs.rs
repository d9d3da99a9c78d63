//! Reads device attributes of the kernel.

use std::fs;
use std::path::{Path, PathBuf};

/// Roots of the kernel's file systems; replaced in tests.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SystemRoot {
    /// `/sys`.
    pub sys: PathBuf,
    /// `/dev`.
    pub dev: PathBuf,
    /// `/proc`.
    pub proc: PathBuf,
}

impl Default for SystemRoot {
    fn default() -> Self {
        Self {
            sys: "/sys".into(),
            dev: "/dev".into(),
            proc: "/proc".into(),
        }
    }
}

impl SystemRoot {
    /// Whether this is the running system.
    #[must_use]
    pub fn is_live(&self) -> bool {
        self.sys == Path::new("/sys")
    }
}

/// One attribute file without surrounding white space; `None` when it is absent, unreadable or
/// empty.
pub(super) fn attribute(directory: &Path, name: &str) -> Option<String> {
    let bytes = fs::read(directory.join(name)).ok()?;
    let text = String::from_utf8_lossy(&bytes).trim().to_owned();
    (!text.is_empty()).then_some(text)
}

/// A hexadecimal attribute (`idVendor`, `bInterfaceNumber`).
pub(super) fn hex_attribute(directory: &Path, name: &str) -> Option<u16> {
    u16::from_str_radix(&attribute(directory, name)?, 16).ok()
}

/// Name of the last part of a path.
pub(super) fn file_name(path: &Path) -> String {
    path.file_name()
        .map(|name| name.to_string_lossy().into_owned())
        .unwrap_or_default()
}
