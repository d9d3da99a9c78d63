//! Files below a directory with untrusted contents.
//!
//! A [`Root`] is a directory given by the user; a [`BeneathPath`] is a path below it. Every
//! operation resolves the path below the directory in the kernel (`openat2` with
//! `RESOLVE_BENEATH`), so that neither `..` nor an absolute path nor a symbolic link leads out of
//! it, even with concurrent changes. Components are literals or name types that cannot contain a
//! path; no method takes a plain string.
//!
//! Symbolic links that stay below the directory are followed. Links that leave it are refused
//! unless they lead into a directory allowed with [`allow_links_into`]; a bind mount needs no
//! permission. The root itself may be a link. Without `openat2` no link is followed.

use std::ffi::{OsStr, OsString};
use std::fmt;
use std::fs::File;
use std::io::{self, Write as _};
use std::os::fd::OwnedFd;
use std::os::unix::ffi::OsStringExt as _;
use std::path::{Path, PathBuf};
use std::sync::{Arc, RwLock};

use rustix::fs::{
    AtFlags, CWD, Dir, FileType, Mode, OFlags, RawMode, RenameFlags, fstat, linkat, mkdirat,
    openat, renameat, renameat_with, statat, syncfs, unlinkat,
};
use rustix::io::Errno;

use super::component::Component;
use super::disk_failure::{cannot_flush_dirs, flush_dir};
use super::foreign::is_system_file;
use super::opening::{FILE_MODE, FileKind, open_beneath, owned, read_all, regular, text};
use super::partial_name;
use crate::error::Refused;

/// Mode of new directories, before the umask.
const DIR_MODE: Mode = Mode::from_raw_mode(0o777);

/// Directories outside of a root into which its links may lead; set once by the application.
static ALLOWED: RwLock<Vec<PathBuf>> = RwLock::new(Vec::new());

/// Permits symbolic links below any [`Root`] that lead into one of these directories.
pub fn allow_links_into(folders: Vec<PathBuf>) {
    *ALLOWED.write().unwrap_or_else(|e| e.into_inner()) = folders;
}

/// File type and size; permitted symbolic links are followed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Metadata {
    /// Whether it is a regular file.
    pub is_file: bool,
    /// Whether it is a directory.
    pub is_dir: bool,
    /// Size, bytes.
    pub bytes: u64,
}

/// A directory given by the user.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Root(Arc<PathBuf>);

impl Root {
    /// A root directory, which need not exist yet.
    #[must_use]
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self(Arc::new(path.into()))
    }

    /// Path of the directory.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.0
    }

    /// The directory itself.
    #[must_use]
    pub fn top(&self) -> BeneathPath {
        BeneathPath {
            root: self.clone(),
            relative: PathBuf::new(),
        }
    }

    /// Resolves a path that a file gives relative to the directory, for instance of a texture.
    ///
    /// # Errors
    /// [`Refused::Outside`] for an absolute path and one with `..`.
    pub fn resolve(&self, relative: &str) -> io::Result<BeneathPath> {
        use std::path::Component as Part;
        let mut resolved = PathBuf::new();
        for part in Path::new(relative).components() {
            match part {
                Part::Normal(name) => resolved.push(name),
                Part::CurDir => {}
                Part::ParentDir | Part::RootDir | Part::Prefix(_) => {
                    return Err(Refused::Outside {
                        root: self.path().to_owned(),
                        target: Some(PathBuf::from(relative)),
                    }
                    .into());
                }
            }
        }
        Ok(BeneathPath {
            root: self.clone(),
            relative: resolved,
        })
    }

    /// As [`resolve`](Self::resolve); an absolute path may also be in a directory allowed with
    /// [`allow_links_into`].
    ///
    /// # Errors
    /// [`Refused::Outside`] for any other absolute path and one with `..`.
    pub fn resolve_allowed(&self, path: &str) -> io::Result<BeneathPath> {
        let allowed = ALLOWED.read().unwrap_or_else(|e| e.into_inner()).clone();
        let inside = |folder: &PathBuf| {
            let inside = Path::new(path).strip_prefix(folder).ok()?.to_str()?;
            folder
                .is_absolute()
                .then(|| Self::new(folder).resolve(inside))
        };
        let found = allowed.iter().find_map(inside);
        found.unwrap_or_else(|| self.resolve(path))
    }

    /// The directory of a file given by the user.
    #[must_use]
    pub fn beside(path: &Path) -> BeneathPath {
        Self::new(super::folder(path)).top()
    }

    /// The child named like the last component of a path given by the user.
    #[must_use]
    pub fn entry(&self, path: &Path) -> BeneathPath {
        self.top().child(path.file_name().unwrap_or_default())
    }

    pub(super) fn open(&self) -> io::Result<OwnedFd> {
        let path = if self.0.as_os_str().is_empty() {
            Path::new(".")
        } else {
            &self.0
        };
        let flags = OFlags::PATH | OFlags::DIRECTORY | OFlags::CLOEXEC;
        Ok(openat(CWD, path, flags, Mode::empty())?)
    }
}

/// A path below a [`Root`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BeneathPath {
    root: Root,
    relative: PathBuf,
}

impl BeneathPath {
    /// A file given by the user, below its own directory.
    #[must_use]
    pub fn from_user_path(path: &Path) -> Self {
        Root::new(super::folder(path)).entry(path)
    }

    /// Appends a component.
    #[must_use]
    pub fn join(&self, name: impl Component) -> Self {
        self.child(OsStr::new(name.component()))
    }

    /// Appends an id with a literal prefix and suffix.
    #[must_use]
    pub fn join_affixed(
        &self,
        before: &'static str,
        name: &impl Component,
        after: &'static str,
    ) -> Self {
        self.child(OsStr::new(&format!("{before}{}{after}", name.component())))
    }

    /// Appends a number in hex with a literal prefix, for instance `chunk-0a`.
    #[must_use]
    pub fn join_number(&self, before: &'static str, number: impl fmt::LowerHex) -> Self {
        self.child(OsStr::new(&format!("{before}{number:02x}")))
    }

    /// Appends `.N` to the name, for an unused name beside an existing one.
    #[must_use]
    pub fn numbered(&self, number: usize) -> Self {
        let mut name = self.relative.clone().into_os_string();
        name.push(format!(".{number}"));
        Self {
            root: self.root.clone(),
            relative: name.into(),
        }
    }

    /// A random hidden name in the same directory, for a file that is renamed when complete.
    #[must_use]
    pub fn partial(&self) -> Self {
        self.parent().child(OsStr::new(&partial_name()))
    }

    /// Appends a name that is known to be one component.
    fn child(&self, name: &OsStr) -> Self {
        Self {
            root: self.root.clone(),
            relative: self.relative.join(name),
        }
    }

    /// The root directory.
    #[must_use]
    pub fn root(&self) -> &Root {
        &self.root
    }

    /// The parent directory; the root's parent is the root.
    #[must_use]
    pub fn parent(&self) -> Self {
        Self {
            root: self.root.clone(),
            relative: self.relative.parent().unwrap_or(Path::new("")).to_owned(),
        }
    }

    /// The last component as text; empty for the root.
    #[must_use]
    pub fn name(&self) -> String {
        let name = self.relative.file_name().unwrap_or_default();
        name.to_string_lossy().into_owned()
    }

    /// The full path for messages. Opening it is not safe: use the methods.
    #[must_use]
    pub fn shown(&self) -> PathBuf {
        self.root.path().join(&self.relative)
    }

    /// The full path, to be displayed.
    pub fn display(&self) -> impl fmt::Display {
        self.shown().display().to_string()
    }

    /// File type and size.
    ///
    /// # Errors
    /// `NotFound`, [`Refused::Outside`], those of the operating system.
    pub fn metadata(&self) -> io::Result<Metadata> {
        let fd = self.open(OFlags::PATH, Mode::empty())?;
        let stat = fstat(&fd)?;
        let kind = FileType::from_raw_mode(stat.st_mode as RawMode);
        Ok(Metadata {
            is_file: kind == FileType::RegularFile,
            is_dir: kind == FileType::Directory,
            bytes: u64::try_from(stat.st_size).unwrap_or(0),
        })
    }

    /// Whether it is a directory.
    #[must_use]
    pub fn is_dir(&self) -> bool {
        self.metadata().is_ok_and(|found| found.is_dir)
    }

    /// Whether it is a regular file.
    #[must_use]
    pub fn is_file(&self) -> bool {
        self.metadata().is_ok_and(|found| found.is_file)
    }

    /// Whether the name is taken, even by a dangling link.
    #[must_use]
    pub fn is_taken(&self) -> bool {
        self.in_parent(|dir, name| statat(dir, name, AtFlags::SYMLINK_NOFOLLOW))
            .is_ok()
    }

    /// Whether it is a symbolic link with any target.
    #[must_use]
    pub fn is_link(&self) -> bool {
        self.in_parent(|dir, name| statat(dir, name, AtFlags::SYMLINK_NOFOLLOW))
            .is_ok_and(|s| FileType::from_raw_mode(s.st_mode as RawMode) == FileType::Symlink)
    }

    /// The same name in another directory of the same root.
    #[must_use]
    pub fn moved_into(&self, folder: &Self) -> Self {
        folder.child(self.relative.file_name().unwrap_or_default())
    }

    /// Entries of the directory, sorted by name, without those of [`is_system_file`].
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn entries(&self) -> io::Result<Vec<Self>> {
        let entries = self.typed_entries()?;
        Ok(entries.into_iter().map(|(entry, _)| entry).collect())
    }

    /// Directories in the directory, as [`entries`](Self::entries).
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn directories(&self) -> io::Result<Vec<Self>> {
        let mut entries = self.typed_entries()?;
        entries.retain(|(entry, kind)| match kind {
            FileType::Directory => true,
            // Some file systems do not tell.
            FileType::Symlink | FileType::Unknown => entry.is_dir(),
            _ => false,
        });
        Ok(entries.into_iter().map(|(entry, _)| entry).collect())
    }

    fn typed_entries(&self) -> io::Result<Vec<(Self, FileType)>> {
        let fd = self.open(OFlags::RDONLY | OFlags::DIRECTORY, Mode::empty())?;
        let mut found = Vec::new();
        for entry in Dir::read_from(&fd)? {
            let entry = entry?;
            let name = OsString::from_vec(entry.file_name().to_bytes().to_vec());
            if name != "." && name != ".." && !is_system_file(&name.to_string_lossy()) {
                found.push((name, entry.file_type()));
            }
        }
        found.sort_by(|(a, _), (b, _)| a.cmp(b));
        let found = found.into_iter();
        Ok(found
            .map(|(name, kind)| (self.child(&name), kind))
            .collect())
    }

    /// A value that changes when an entry is added, removed or renamed: device, inode, and time of
    /// the last change of the directory, ns. Changes within the resolution of the file system's
    /// clock may leave it unchanged.
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn change_stamp(&self) -> io::Result<[u64; 3]> {
        let stat = fstat(self.open(OFlags::PATH, Mode::empty())?)?;
        let time_ns = stat.st_mtime as i128 * 1_000_000_000 + stat.st_mtime_nsec as i128;
        Ok([stat.st_dev, stat.st_ino, time_ns as u64])
    }

    /// Opens a regular file for reading.
    ///
    /// # Errors
    /// [`Refused`] for other file types and for a file above the size limit; those of the
    /// operating system.
    pub fn open_file(&self, kind: FileKind) -> io::Result<File> {
        // O_NONBLOCK: a pipe without a writer must not hang the program.
        let fd = self.open(
            OFlags::RDONLY | OFlags::NONBLOCK | OFlags::NOCTTY,
            Mode::empty(),
        )?;
        regular(fd, kind)
    }

    /// Reads a regular file.
    ///
    /// # Errors
    /// As [`open_file`](Self::open_file).
    pub fn read(&self, kind: FileKind) -> io::Result<Vec<u8>> {
        read_all(self.open_file(kind)?, kind)
    }

    /// Reads a regular UTF-8 file without its byte-order mark.
    ///
    /// # Errors
    /// As [`open_file`](Self::open_file); `InvalidData` for invalid UTF-8.
    pub fn read_to_string(&self, kind: FileKind) -> io::Result<String> {
        text(self.read(kind)?)
    }

    /// Creates a new file; an existing name, even of a link, is an error.
    ///
    /// # Errors
    /// `AlreadyExists`; those of the operating system.
    pub fn create_new(&self) -> io::Result<File> {
        let flags = OFlags::WRONLY | OFlags::CREATE | OFlags::EXCL | OFlags::NOFOLLOW;
        Ok(self
            .in_parent(|dir, name| openat(dir, name, flags | OFlags::CLOEXEC, FILE_MODE))?
            .into())
    }

    /// Writes a complete file, replacing an existing file or link, and flushes its contents. The
    /// name is durable only after [`sync_dir`](Self::sync_dir).
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn write(&self, bytes: &[u8]) -> io::Result<()> {
        match self.remove_file() {
            Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(e),
            _ => {}
        }
        let mut file = self.create_new()?;
        file.write_all(bytes)?;
        file.sync_all()
    }

    /// Replaces a file atomically: readers see either the old or the new contents. A link is
    /// replaced, not followed.
    ///
    /// # Errors
    /// Those of the operating system; the old file is then unchanged.
    pub fn replace(&self, bytes: &[u8]) -> io::Result<()> {
        let partial = self.partial();
        let written = partial.write(bytes).and_then(|()| partial.rename(self));
        if written.is_err() {
            // The caller reports the cause.
            let _ = partial.remove_file();
        }
        written
    }

    /// Opens a file without other hard links for appending; creates it if it is missing.
    ///
    /// # Errors
    /// [`Refused`] for a link, another file type or a file with other hard links.
    pub fn append(&self) -> io::Result<File> {
        let flags = OFlags::WRONLY | OFlags::APPEND | OFlags::CREATE;
        let flags = flags | OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let fd = self.in_parent(|dir, name| openat(dir, name, flags, FILE_MODE))?;
        owned(fd)
    }

    /// Creates a directory whose parent exists.
    ///
    /// # Errors
    /// `AlreadyExists`, those of the operating system.
    pub fn create_dir(&self) -> io::Result<()> {
        self.in_parent(|dir, name| mkdirat(dir, name, DIR_MODE))
    }

    /// Creates a directory and its missing ancestors below the root.
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn create_dir_all(&self) -> io::Result<()> {
        if self.relative.as_os_str().is_empty() || self.is_dir() {
            return Ok(());
        }
        self.parent().create_dir_all()?;
        match self.create_dir() {
            Err(e) if e.kind() == io::ErrorKind::AlreadyExists && self.is_dir() => Ok(()),
            created => created,
        }
    }

    /// Creates a hard link.
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn hard_link(&self, to: &Self) -> io::Result<()> {
        self.in_parent_io(|dir, name| {
            to.in_parent(|to_dir, to_name| linkat(dir, name, to_dir, to_name, AtFlags::empty()))
        })
    }

    /// Renames, replacing an existing file.
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn rename(&self, to: &Self) -> io::Result<()> {
        self.in_parent_io(|dir, name| {
            to.in_parent(|to_dir, to_name| renameat(dir, name, to_dir, to_name))
        })
    }

    /// Renames; fails if the target exists.
    ///
    /// # Errors
    /// `AlreadyExists`; those of the operating system.
    pub fn rename_new(&self, to: &Self) -> io::Result<()> {
        let renamed = self.in_parent_io(|dir, name| {
            to.in_parent_io(|to_dir, to_name| {
                Ok(renameat_with(
                    dir,
                    name,
                    to_dir,
                    to_name,
                    RenameFlags::NOREPLACE,
                ))
            })
        })?;
        match renamed {
            // Some network and FAT file systems lack the flag. The caller's lock excludes other
            // writers, so checking first is equivalent.
            Err(Errno::INVAL | Errno::NOSYS) if to.is_taken() => {
                Err(io::ErrorKind::AlreadyExists.into())
            }
            Err(Errno::INVAL | Errno::NOSYS) => self.rename(to),
            renamed => Ok(renamed?),
        }
    }

    /// Removes a file or a link.
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn remove_file(&self) -> io::Result<()> {
        self.in_parent(|dir, name| unlinkat(dir, name, AtFlags::empty()))
    }

    /// Removes an empty directory.
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn remove_dir(&self) -> io::Result<()> {
        self.in_parent(|dir, name| unlinkat(dir, name, AtFlags::REMOVEDIR))
    }

    /// Flushes the entries of a directory to the disk. Where the file system cannot flush
    /// directories (SMB, some FUSE), it is asked to write all that it holds back.
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn sync_dir(&self) -> io::Result<()> {
        let dir = self.open(OFlags::RDONLY | OFlags::DIRECTORY, Mode::empty())?;
        if !flush_dir(&dir)? {
            // Refused by the same file systems; nothing else is left to try.
            match syncfs(&dir) {
                Err(e) if cannot_flush_dirs(e) => {}
                flushed => flushed?,
            }
        }
        Ok(())
    }

    /// Whether the file system can flush directories. Otherwise a power failure can lose names of
    /// the last files, even of flushed ones.
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn can_sync_dir(&self) -> io::Result<bool> {
        flush_dir(&self.open(OFlags::RDONLY | OFlags::DIRECTORY, Mode::empty())?)
    }

    /// Runs `act` with the parent directory and the name; a link with that name is not followed.
    fn in_parent<T>(
        &self,
        act: impl FnOnce(&OwnedFd, &OsStr) -> rustix::io::Result<T>,
    ) -> io::Result<T> {
        self.in_parent_io(|dir, name| Ok(act(dir, name)?))
    }

    fn in_parent_io<T>(
        &self,
        act: impl FnOnce(&OwnedFd, &OsStr) -> io::Result<T>,
    ) -> io::Result<T> {
        let name = self
            .relative
            .file_name()
            .ok_or_else(|| io::Error::from(io::ErrorKind::IsADirectory))?;
        let dir = self
            .parent()
            .open(OFlags::PATH | OFlags::DIRECTORY, Mode::empty())?;
        act(&dir, name)
    }

    fn open(&self, flags: OFlags, mode: Mode) -> io::Result<OwnedFd> {
        let root = self.root.open()?;
        match open_beneath(&root, &self.relative, flags, mode) {
            Err(Errno::XDEV) => self.open_outside(flags, mode),
            opened => Ok(opened?),
        }
    }

    /// Opens the target of a link outside of the root, if allowed.
    fn open_outside(&self, flags: OFlags, mode: Mode) -> io::Result<OwnedFd> {
        let target = self.shown().canonicalize().ok();
        let refused = Refused::Outside {
            root: self.root.path().to_owned(),
            target: target.clone(),
        };
        let Some(target) = target else {
            return Err(refused.into());
        };
        let allowed = ALLOWED.read().unwrap_or_else(|e| e.into_inner()).clone();
        for folder in allowed {
            let Ok(folder) = folder.canonicalize() else {
                continue;
            };
            if let Ok(inside) = target.strip_prefix(&folder) {
                return Ok(open_beneath(
                    Root::new(&folder).open()?,
                    inside,
                    flags | OFlags::NOFOLLOW,
                    mode,
                )?);
            }
        }
        Err(refused.into())
    }
}
