//! Atomic writes of result files.
//!
//! A file is written under a temporary name in the same directory and renamed when complete. After
//! a kill or with a full disk there is either the old file or the new one; a kill may leave a
//! hidden `.gripcast-….partial` beside it, which is ignored.

mod beneath;
#[cfg(test)]
mod beneath_test;
mod component;
mod disk_failure;
mod foreign;
mod name;
pub mod npy;
mod opening;
mod owner_lock;
mod signature;

use std::fs::{self, OpenOptions};
use std::hash::{BuildHasher as _, RandomState};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};

use sha2::{Digest as _, Sha256};

use crate::error::{Error, Result};

pub use beneath::{BeneathPath, Metadata, Root, allow_links_into};
pub use component::Component;
pub use disk_failure::disk_remedy;
pub use foreign::{conflict_copy_of, glob_character, is_system_file, without_bom};
pub use name::{
    ContentKey, FieldName, FileName, GraspId, Label, MAX_LABEL_CHARS, ObjectName, Printable,
    SimulationId, folded_name, is_unsafe_char,
};
pub use opening::{FileKind, open_regular, read_regular, read_text};
pub use owner_lock::{NotLocked, OwnerLock};
pub use signature::file_type;

/// Maximum number of symbolic links that are followed, as in Linux.
const MAX_LINKS: usize = 40;

/// Formats bytes as lower-case hex.
pub fn hex(bytes: &[u8]) -> String {
    let digit = |value: u8| char::from_digit(u32::from(value), 16).unwrap_or_default();
    let digits = bytes.iter().flat_map(|b| [b >> 4, b & 15]);
    digits.map(digit).collect()
}

/// SHA-256 as printed by `sha256sum`: 64 lower-case hex digits.
pub fn sha256_hex(bytes: impl AsRef<[u8]>) -> String {
    hex(&Sha256::digest(bytes))
}

/// Writes a file atomically, replacing an existing one.
///
/// A link is kept and its target replaced. Anything but a regular file (a pipe, `/dev/stdout`) is
/// written directly. An existing file keeps its permissions and must be writable; its owner
/// becomes the writer, and other hard links keep the old contents. The contents are flushed before
/// the rename.
///
/// # Errors
/// Those of the operating system; the old file is then unchanged, unless it is written directly.
pub fn replace_file(path: &Path, bytes: &[u8]) -> io::Result<()> {
    StagedFile::write(path, bytes)?.commit()
}

/// As [`replace_file`], with an error that names the file.
///
/// # Errors
/// `Io`, `Permission`, `DiskFull`, …; the old file is then unchanged.
pub fn save(path: &Path, bytes: &[u8]) -> Result<()> {
    replace_file(path, bytes).map_err(|e| {
        let remedy = disk_remedy(&e);
        let error = Error::io("cannot write the file", e).at(path.display());
        match remedy {
            Some(remedy) => error.remedy(remedy),
            None => error,
        }
    })
}

/// A file that is written but not renamed yet, so that several can be committed together. Removed
/// when dropped.
#[derive(Debug)]
pub struct StagedFile(Stage);

#[derive(Debug)]
enum Stage {
    /// Written under a temporary name.
    Beside { partial: Partial, target: PathBuf },
    /// To be written directly at commit.
    Direct { path: PathBuf, bytes: Vec<u8> },
}

impl StagedFile {
    /// Writes the contents beside the target.
    ///
    /// # Errors
    /// As [`replace_file`].
    pub fn write(path: &Path, bytes: &[u8]) -> io::Result<Self> {
        let Some(target) = replaceable(path)? else {
            return Ok(Self(Stage::Direct {
                path: path.to_owned(),
                bytes: bytes.to_vec(),
            }));
        };
        let permissions = match OpenOptions::new().write(true).open(&target) {
            Ok(old) => Some(old.metadata()?.permissions()),
            Err(error) if error.kind() == io::ErrorKind::NotFound => None,
            Err(error) => return Err(error),
        };
        let partial = Partial(folder(&target).join(partial_name()));
        let mut file = OpenOptions::new()
            .write(true)
            .create_new(true)
            .open(&partial.0)?;
        if let Some(permissions) = permissions {
            file.set_permissions(permissions)?;
        }
        file.write_all(bytes)?;
        file.sync_all()?;
        Ok(Self(Stage::Beside { partial, target }))
    }

    /// Renames the file to its target.
    ///
    /// # Errors
    /// As [`replace_file`].
    pub fn commit(self) -> io::Result<()> {
        match self.0 {
            Stage::Beside { partial, target } => fs::rename(&partial.0, target),
            Stage::Direct { path, bytes } => fs::write(path, bytes),
        }
    }
}

/// A temporary file that is removed when dropped.
#[derive(Debug)]
struct Partial(PathBuf);

impl Drop for Partial {
    fn drop(&mut self) {
        // Fails after the rename, as intended.
        let _ = fs::remove_file(&self.0);
    }
}

/// A random name: process ids repeat and would collide with leftovers of a kill.
fn partial_name() -> String {
    format!(".gripcast-{:016x}.partial", RandomState::new().hash_one(()))
}

/// Resolves links to the file to replace or create; `None` where it must be written directly.
fn replaceable(path: &Path) -> io::Result<Option<PathBuf>> {
    if fs::metadata(path).is_ok_and(|found| !found.is_file()) {
        return Ok(None);
    }
    let mut target = path.to_owned();
    for _ in 0..MAX_LINKS {
        // An open file such as /dev/stdout: its reader has the file open, not its name.
        if fs::canonicalize(folder(&target)).is_ok_and(|f| f.starts_with("/proc")) {
            return Ok(None);
        }
        match fs::read_link(&target) {
            Ok(link) => target = folder(&target).join(link),
            Err(_) => return Ok(Some(target)),
        }
    }
    Err(io::Error::other("too many symbolic links"))
}

/// Returns a reader for files that a file names relative to itself (material library, buffer,
/// texture): below its directory only, see [`Root`].
///
/// A name that is not found is looked for in other upper and lower case, as file systems of Windows
/// and macOS do, and then without its folders, which are often those of the author's machine.
pub fn companions(path: &Path) -> impl Fn(&str) -> io::Result<Vec<u8>> + use<> {
    let root = Root::new(folder(path));
    move |name: &str| {
        let read = |path: io::Result<BeneathPath>| path?.read(FileKind::Mesh);
        let parts: Vec<&str> = name
            .split(['/', '\\'])
            .filter(|part| *part != ".")
            .collect();
        read(root.resolve(name)).or_else(|error| {
            let moved = in_any_case(&root, &parts)
                .or_else(|| in_any_case(&root, &parts[parts.len().saturating_sub(1)..]));
            moved.map_or(Err(error), |path| read(Ok(path)))
        })
    }
}

/// Returns the first file below a directory whose path has these names in any case.
fn in_any_case(root: &Root, names: &[&str]) -> Option<BeneathPath> {
    names.iter().try_fold(root.top(), |folder, name| {
        let entries = folder.entries().ok()?;
        let same = |entry: &BeneathPath| entry.name().to_lowercase() == name.to_lowercase();
        entries.into_iter().find(same)
    })
}

/// The directory of a path; `.` for a bare name.
fn folder(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::{PermissionsExt as _, symlink};
    use std::thread;

    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let name = |e: io::Result<fs::DirEntry>| e.unwrap().file_name().into_string().unwrap();
        let mut names: Vec<_> = fs::read_dir(folder).unwrap().map(name).collect();
        names.sort();
        names
    }

    #[test]
    fn companions_are_found_in_any_case_and_without_foreign_folders() {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("Tex")).unwrap();
        fs::write(folder.path().join("Tex/Wood.PNG"), b"deep").unwrap();
        fs::write(folder.path().join("cup.png"), b"beside").unwrap();
        let read = companions(&folder.path().join("cup.obj"));
        for name in ["tex/wood.png", "Tex\\Wood.png", "./TEX/WOOD.PNG"] {
            assert_eq!(read(name).unwrap(), b"deep", "{name}");
        }
        for name in [
            "CUP.png",
            "C:\\work\\cup.png",
            "/home/me/Cup.png",
            "../cup.png",
        ] {
            assert_eq!(read(name).unwrap(), b"beside", "{name}");
        }
        // Nothing outside the directory, and no other name.
        let inside = companions(&folder.path().join("Tex/a.obj"));
        for name in ["../cup.png", "cup.png", "", "..", "wood.jpg"] {
            assert!(inside(name).is_err(), "{name}");
        }
    }

    #[test]
    fn replaced_file_keeps_its_permissions() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        replace_file(&path, b"old").unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o640)).unwrap();
        replace_file(&path, b"new").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        let mode = fs::metadata(&path).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o640);
        assert_eq!(names(folder.path()), ["a.png"]);
        let long = folder.path().join("n".repeat(255));
        replace_file(&long, b"as long as names can be").unwrap();
        assert_eq!(names(folder.path()).len(), 2);
    }

    #[test]
    fn readers_see_the_old_file_until_commit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.toml");
        replace_file(&path, b"old").unwrap();
        let mut open = fs::File::open(&path).unwrap();
        let staged = StagedFile::write(&path, b"new").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(names(folder.path()).len(), 2);
        staged.commit().unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        let mut text = String::new();
        io::Read::read_to_string(&mut open, &mut text).unwrap();
        assert_eq!(text, "old");
        drop(StagedFile::write(&path, b"given up").unwrap());
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(names(folder.path()), ["a.toml"]);
    }

    #[test]
    fn failed_write_leaves_no_file() {
        let folder = tempfile::tempdir().unwrap();
        let taken = folder.path().join("taken");
        fs::create_dir(&taken).unwrap();
        assert!(replace_file(&taken, b"x").is_err());
        assert!(replace_file(&folder.path().join("no/such/a.png"), b"x").is_err());
        let path = folder.path().join("a.png");
        // A directory takes the name after the contents were written.
        let staged = StagedFile::write(&path, b"x").unwrap();
        fs::create_dir(&path).unwrap();
        assert!(staged.commit().is_err());
        assert_eq!(names(folder.path()), ["a.png", "taken"]);
        let circle = folder.path().join("circle");
        symlink(&circle, &circle).unwrap();
        assert!(replace_file(&circle, b"x").is_err());
        assert_eq!(names(folder.path()), ["a.png", "circle", "taken"]);
    }

    #[test]
    fn link_is_kept_and_its_target_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let [real, second, first, dangling] =
            ["deep/real.png", "deep/second", "first", "dangling"].map(|n| folder.path().join(n));
        fs::create_dir(folder.path().join("deep")).unwrap();
        replace_file(&real, b"old").unwrap();
        symlink("real.png", &second).unwrap();
        symlink("deep/second", &first).unwrap();
        symlink("deep/made.png", &dangling).unwrap();
        replace_file(&first, b"new").unwrap();
        replace_file(&dangling, b"made").unwrap();
        assert_eq!(fs::read(&real).unwrap(), b"new");
        assert_eq!(
            fs::read(folder.path().join("deep/made.png")).unwrap(),
            b"made"
        );
        assert!([&first, &second, &dangling].iter().all(|l| l.is_symlink()));
        assert!(!real.is_symlink());
        assert_eq!(
            names(&folder.path().join("deep")),
            ["made.png", "real.png", "second"]
        );
    }

    #[test]
    fn devices_pipes_and_open_files_are_written_directly() {
        replace_file(Path::new("/dev/null"), b"gone").unwrap();
        let (mut reader, writer) = io::pipe().unwrap();
        let reading = thread::spawn(move || {
            let mut text = String::new();
            io::Read::read_to_string(&mut reader, &mut text).map(|_| text)
        });
        let open = |file: &dyn std::os::fd::AsRawFd| {
            let descriptor = file.as_raw_fd();
            PathBuf::from(format!("/dev/fd/{descriptor}"))
        };
        replace_file(&open(&writer), b"through a pipe").unwrap();
        drop(writer);
        assert_eq!(reading.join().unwrap().unwrap(), "through a pipe");
        let mut file = tempfile::tempfile().unwrap();
        replace_file(&open(&file), b"without a name").unwrap();
        let mut text = String::new();
        io::Read::read_to_string(&mut file, &mut text).unwrap();
        assert_eq!(text, "without a name");
    }
}
