//! Where the files of the black box are: names, sizes, free space.

use std::fs;
use std::io::{self, Seek, Write};
use std::path::{Path, PathBuf};

use jiff::Timestamp;

use gripcast_base::files::{self, BeneathPath, Root};

/// What ends the name of a file that was closed.
const CLOSED: &str = ".mcap";
/// What ends the name of a file that is being written, or was when the program was killed.
const OPEN: &str = ".partial.mcap";

/// A file that is written.
pub(super) trait Output: Write + Seek + Send {}

impl<T: Write + Seek + Send> Output for T {}

/// The operations of the black box on its directory, so that tests can fail any of them.
pub(super) trait Shelf: Send {
    /// Begins a file that does not exist.
    fn create(&mut self, name: &str) -> io::Result<Box<dyn Output>>;
    /// Gives a file another name.
    fn rename(&mut self, from: &str, to: &str) -> io::Result<()>;
    /// Names of all files and their bytes; makes the place where there is none.
    fn list(&mut self) -> io::Result<Vec<(String, u64)>>;
    /// Removes a file.
    fn remove(&mut self, name: &str) -> io::Result<()>;
    /// The least free space of the disks that matter, bytes; none where they do not say.
    fn free_bytes(&mut self) -> Option<u64>;
}

/// A directory.
#[derive(Debug)]
pub(super) struct DirectoryShelf {
    place: BeneathPath,
    dataset: PathBuf,
}

impl DirectoryShelf {
    /// Files in `directory`; the disk of `dataset` matters too. Inside a dataset no link leads
    /// out of it.
    pub(super) fn new(directory: PathBuf, dataset: PathBuf) -> Self {
        let inside = directory.strip_prefix(&dataset).ok().and_then(Path::to_str);
        let place = inside.and_then(|inside| Root::new(&dataset).resolve(inside).ok());
        Self {
            place: place.unwrap_or_else(|| Root::new(directory).top()),
            dataset,
        }
    }

    fn file(&self, name: &str) -> io::Result<BeneathPath> {
        let name = files::FileName::parse(name).map_err(io::Error::other)?;
        Ok(self.place.join(name))
    }
}

impl Shelf for DirectoryShelf {
    fn create(&mut self, name: &str) -> io::Result<Box<dyn Output>> {
        Ok(Box::new(self.file(name)?.create_new()?))
    }

    fn rename(&mut self, from: &str, to: &str) -> io::Result<()> {
        self.file(from)?.rename(&self.file(to)?)
    }

    fn list(&mut self) -> io::Result<Vec<(String, u64)>> {
        fs::create_dir_all(self.place.root().path())?;
        self.place.create_dir_all()?;
        let entries = self.place.entries()?;
        Ok(entries
            .iter()
            .map(|entry| {
                (
                    entry.name(),
                    entry.metadata().map_or(0, |found| found.bytes),
                )
            })
            .collect())
    }

    fn remove(&mut self, name: &str) -> io::Result<()> {
        self.file(name)?.remove_file()
    }

    fn free_bytes(&mut self) -> Option<u64> {
        let free = |path: &Path| {
            let disk = rustix::fs::statvfs(path).ok()?;
            Some(disk.f_bavail.saturating_mul(disk.f_frsize))
        };
        [&self.place.shown(), &self.dataset]
            .into_iter()
            .filter_map(|path| free(path))
            .min()
    }
}

/// Name of the files of one collection: when it began, and their number in it.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct FileName {
    /// `2026-11-20T10-15-03Z`.
    pub(super) began: String,
    /// Counted from 1.
    pub(super) number: u64,
}

impl FileName {
    /// The first file of a collection that begins now.
    pub(super) fn first() -> Self {
        Self {
            began: Timestamp::now().strftime("%Y-%m-%dT%H-%M-%SZ").to_string(),
            number: 1,
        }
    }

    /// Name while it is being written.
    pub(super) fn open(&self) -> String {
        format!("{}-{:05}{OPEN}", self.began, self.number)
    }

    /// Name once it is closed.
    pub(super) fn closed(&self) -> String {
        format!("{}-{:05}{CLOSED}", self.began, self.number)
    }

    /// The name that a file of ours has; none for files of others.
    pub(super) fn parse(name: &str) -> Option<Self> {
        let stem = name.strip_suffix(OPEN).or(name.strip_suffix(CLOSED))?;
        let (began, number) = stem.rsplit_once('-')?;
        let shape = began.bytes().map(|byte| match byte {
            b'0'..=b'9' => '0',
            other => char::from(other),
        });
        if shape.collect::<String>() != "0000-00-00T00-00-00Z" {
            return None;
        }
        let is_number = number.len() >= 5 && number.bytes().all(|byte| byte.is_ascii_digit());
        Some(Self {
            began: began.to_owned(),
            number: number.parse().ok().filter(|_| is_number)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_told_from_those_of_others_and_sort_by_age() {
        let name = FileName {
            began: "2026-11-20T10-15-03Z".into(),
            number: 12,
        };
        assert_eq!(name.closed(), "2026-11-20T10-15-03Z-00012.mcap");
        assert_eq!(FileName::parse(&name.closed()), Some(name.clone()));
        assert_eq!(FileName::parse(&name.open()), Some(name.clone()));
        let late = FileName::parse("2026-11-20T10-15-03Z-123456.mcap").unwrap();
        assert!(name < late);
        for other in [
            "notes.mcap",
            "2026-11-20T10-15-03Z-7f3a2.mcap",
            "2026-11-20T10-15-03Z-00012.mcap.bak",
            "2026-11-20-00012.mcap",
            "2026-11-20T10-15-03Z-1.mcap",
        ] {
            assert_eq!(FileName::parse(other), None, "{other}");
        }
        assert_eq!(
            FileName::parse(&FileName::first().open()).unwrap().number,
            1
        );
    }
}
