//! Directory of the black box: file names, sizes, free space.

use std::fs;
use std::io::{self, Seek, Write};
use std::path::{Path, PathBuf};

use jiff::Timestamp;

use crate::daemon::status::disk_free_bytes;

use gripcast_base::files::{self, BeneathPath, Root};

/// Suffix of closed files.
const CLOSED: &str = ".mcap";
/// Suffix of files that are open, or were when the program was killed.
const OPEN: &str = ".partial.mcap";

/// A log file open for writing.
pub(super) trait LogFile: Write + Seek + Send {}

impl<T: Write + Seek + Send> LogFile for T {}

/// Operations of the black box on its directory; tests replace them.
pub(super) trait LogDir: Send {
    /// Creates a new file.
    fn create(&mut self, name: &str) -> io::Result<Box<dyn LogFile>>;
    /// Renames a file.
    fn rename(&mut self, from: &str, to: &str) -> io::Result<()>;
    /// Lists the names and sizes of all files; creates the directory if missing.
    fn list(&mut self) -> io::Result<Vec<(String, u64)>>;
    /// Removes a file.
    fn remove(&mut self, name: &str) -> io::Result<()>;
    /// Returns the minimum free space of the disks of log and dataset, bytes, if known.
    fn free_bytes(&mut self) -> Option<u64>;
}

/// A directory on disk.
#[derive(Debug)]
pub(super) struct DiskLogDir {
    directory: BeneathPath,
    dataset: PathBuf,
}

impl DiskLogDir {
    /// Opens `directory`. Inside `dataset`, symbolic links must not lead out of the dataset.
    pub(super) fn new(directory: PathBuf, dataset: PathBuf) -> Self {
        let inside = directory.strip_prefix(&dataset).ok().and_then(Path::to_str);
        let beneath = inside.and_then(|inside| Root::new(&dataset).resolve(inside).ok());
        Self {
            directory: beneath.unwrap_or_else(|| Root::new(directory).top()),
            dataset,
        }
    }

    fn file(&self, name: &str) -> io::Result<BeneathPath> {
        let name = files::FileName::parse(name).map_err(io::Error::other)?;
        Ok(self.directory.join(name))
    }
}

impl LogDir for DiskLogDir {
    fn create(&mut self, name: &str) -> io::Result<Box<dyn LogFile>> {
        Ok(Box::new(self.file(name)?.create_new()?))
    }

    fn rename(&mut self, from: &str, to: &str) -> io::Result<()> {
        self.file(from)?.rename(&self.file(to)?)
    }

    fn list(&mut self) -> io::Result<Vec<(String, u64)>> {
        fs::create_dir_all(self.directory.root().path())?;
        self.directory.create_dir_all()?;
        let entries = self.directory.entries()?;
        let bytes = |entry: &BeneathPath| entry.metadata().map_or(0, |metadata| metadata.bytes);
        Ok(entries
            .iter()
            .map(|entry| (entry.name(), bytes(entry)))
            .collect())
    }

    fn remove(&mut self, name: &str) -> io::Result<()> {
        self.file(name)?.remove_file()
    }

    fn free_bytes(&mut self) -> Option<u64> {
        let log = disk_free_bytes(&self.directory.shown());
        log.into_iter().chain(disk_free_bytes(&self.dataset)).min()
    }
}

/// File name: start time of the collection and file number.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct LogName {
    /// Start time, for example `2026-11-20T10-15-03Z`.
    pub(super) started: String,
    /// File number, from 1.
    pub(super) number: u64,
}

impl LogName {
    /// Returns the first name of a collection that starts now.
    pub(super) fn first() -> Self {
        Self {
            started: Timestamp::now().strftime("%Y-%m-%dT%H-%M-%SZ").to_string(),
            number: 1,
        }
    }

    /// Returns the name while the file is open.
    pub(super) fn open(&self) -> String {
        format!("{}-{:05}{OPEN}", self.started, self.number)
    }

    /// Returns the name of the closed file.
    pub(super) fn closed(&self) -> String {
        format!("{}-{:05}{CLOSED}", self.started, self.number)
    }

    /// Parses the name of a black box file; `None` for other files.
    pub(super) fn parse(name: &str) -> Option<Self> {
        let stem = name.strip_suffix(OPEN).or(name.strip_suffix(CLOSED))?;
        let (started, number) = stem.rsplit_once('-')?;
        let pattern = started.bytes().map(|byte| match byte {
            b'0'..=b'9' => '0',
            other => char::from(other),
        });
        if pattern.collect::<String>() != "0000-00-00T00-00-00Z" {
            return None;
        }
        let is_number = number.len() >= 5 && number.bytes().all(|byte| byte.is_ascii_digit());
        Some(Self {
            started: started.to_owned(),
            number: number.parse().ok().filter(|_| is_number)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_parsed_and_sort_by_age() {
        let name = LogName {
            started: "2026-11-20T10-15-03Z".into(),
            number: 12,
        };
        assert_eq!(name.closed(), "2026-11-20T10-15-03Z-00012.mcap");
        assert_eq!(LogName::parse(&name.closed()), Some(name.clone()));
        assert_eq!(LogName::parse(&name.open()), Some(name.clone()));
        let late = LogName::parse("2026-11-20T10-15-03Z-123456.mcap").unwrap();
        assert!(name < late);
        for other in [
            "notes.mcap",
            "2026-11-20T10-15-03Z-7f3a2.mcap",
            "2026-11-20T10-15-03Z-00012.mcap.bak",
            "2026-11-20-00012.mcap",
            "2026-11-20T10-15-03Z-1.mcap",
        ] {
            assert_eq!(LogName::parse(other), None, "{other}");
        }
        assert_eq!(LogName::parse(&LogName::first().open()).unwrap().number, 1);
    }
}
