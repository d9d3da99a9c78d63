//! Finds the process that has opened a device node.

use std::fmt;
use std::fs;
use std::path::{Path, PathBuf};

use super::sysfs::{SystemRoot, attribute, file_name};

/// Another process that has opened a device node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NodeOwner {
    /// Process id.
    pub pid: u32,
    /// Name of the program.
    pub name: String,
}

impl NodeOwner {
    /// Searches the accessible processes; those of other users need privileges.
    #[must_use]
    pub fn find(root: &SystemRoot, node: &Path) -> Option<Self> {
        let own = std::process::id();
        let mut processes: Vec<(u32, PathBuf)> = fs::read_dir(&root.proc)
            .ok()?
            .flatten()
            .filter_map(|entry| Some((file_name(&entry.path()).parse().ok()?, entry.path())))
            .filter(|(pid, _)| *pid != own)
            .collect();
        processes.sort();
        processes.into_iter().find_map(|(pid, directory)| {
            let is_owner = fs::read_dir(directory.join("fd"))
                .ok()?
                .flatten()
                .any(|fd| fs::read_link(fd.path()).is_ok_and(|target| target == node));
            is_owner.then(|| Self {
                pid,
                name: attribute(&directory, "comm").unwrap_or_else(|| "unknown".to_owned()),
            })
        })
    }
}

impl fmt::Display for NodeOwner {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} (process {})", self.name, self.pid)
    }
}
