//! Files below a folder whose contents somebody else may have made.
//!
//! A [`Root`] is a folder that the user named; a [`BeneathPath`] is a place below it. Every
//! operation resolves the place below the folder in the kernel (`openat2` with `RESOLVE_BENEATH`),
//! so that neither `..` nor an absolute name nor a symbolic link leads out of it, whatever changes
//! meanwhile. Components come from literals and from name types that cannot hold a path; no method
//! takes a plain string.
//!
//! Symbolic links that stay below the folder are followed. Links that leave it are refused unless
//! they lead into a folder that the user allowed with [`allow_links_into`]; a bind mount needs no
//! permission. The root itself may be a link. Kernels without `openat2` follow no link at all.

use std::ffi::{OsStr, OsString};
use std::fmt;
use std::fs::File;
use std::io::{self, Write as _};
use std::os::fd::OwnedFd;
use std::os::unix::ffi::OsStringExt as _;
use std::path::{Path, PathBuf};
use std::sync::{Arc, RwLock};

use rustix::fs::{
    AtFlags, CWD, Dir, FileType, Mode, OFlags, RawMode, RenameFlags, fstat, fsync, linkat, mkdirat,
    openat, renameat, renameat_with, statat, unlinkat,
};
use rustix::io::Errno;

use super::name::{ContentKey, FileName, GraspId, ObjectName, SimulationId};
use super::opening::{FILE_MODE, FileKind, open_beneath, owned, read_all, regular};
use super::partial_name;
use crate::error::Refused;

/// Rights of new folders, less the umask.
const DIR_MODE: Mode = Mode::from_raw_mode(0o777);

/// Folders outside of a root into which its links may lead; set once by the application.
static ALLOWED: RwLock<Vec<PathBuf>> = RwLock::new(Vec::new());

/// Permits symbolic links below any [`Root`] that lead into one of these folders.
pub fn allow_links_into(folders: Vec<PathBuf>) {
    *ALLOWED.write().unwrap_or_else(|e| e.into_inner()) = folders;
}

/// What a place is; symbolic links that may be followed are followed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Metadata {
    /// Whether it is a regular file.
    pub is_file: bool,
    /// Whether it is a folder.
    pub is_dir: bool,
    /// Size, bytes.
    pub bytes: u64,
}

/// A component of a path that cannot lead anywhere else.
pub trait Component {
    /// The component.
    fn component(&self) -> &str;
}

macro_rules! components {
    ($($name:ty),*) => {
        $(impl Component for $name {
            fn component(&self) -> &str {
                self
            }
        })*
    };
}

components!(ContentKey, FileName, GraspId, ObjectName, SimulationId);

impl<T: Component> Component for &T {
    fn component(&self) -> &str {
        (*self).component()
    }
}

/// A literal of the program; nothing that came from a file has this type.
impl Component for &'static str {
    fn component(&self) -> &str {
        self
    }
}

/// A folder that the user named.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Root(Arc<PathBuf>);

impl Root {
    /// The folder; it need not exist yet.
    #[must_use]
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self(Arc::new(path.into()))
    }

    /// Where it is.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.0
    }

    /// The folder as a place.
    #[must_use]
    pub fn top(&self) -> BeneathPath {
        BeneathPath {
            root: self.clone(),
            relative: PathBuf::new(),
        }
    }

    /// The place of a path that a file gives relative to the folder, for instance a texture.
    ///
    /// # Errors
    /// [`Refused::Outside`] for an absolute path and one with `..`.
    pub fn resolve(&self, relative: &str) -> io::Result<BeneathPath> {
        use std::path::Component as Part;
        let mut place = PathBuf::new();
        for part in Path::new(relative).components() {
            match part {
                Part::Normal(name) => place.push(name),
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
            relative: place,
        })
    }

    /// As [`resolve`](Self::resolve); an absolute path may also lie in a folder that the user
    /// allowed with [`allow_links_into`].
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

    /// The folder of a file that the user named.
    #[must_use]
    pub fn beside(path: &Path) -> BeneathPath {
        Self::new(super::folder(path)).top()
    }

    /// What has the last component of a path that the user named.
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

/// A place below a [`Root`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BeneathPath {
    root: Root,
    relative: PathBuf,
}

impl BeneathPath {
    /// A file that the user named, below its own folder.
    #[must_use]
    pub fn given(path: &Path) -> Self {
        Root::new(super::folder(path)).entry(path)
    }

    /// A place inside this one.
    #[must_use]
    pub fn join(&self, name: impl Component) -> Self {
        self.child(OsStr::new(name.component()))
    }

    /// A place whose name is an id with something before and behind it, both literals.
    #[must_use]
    pub fn join_affixed(
        &self,
        before: &'static str,
        name: &impl Component,
        after: &'static str,
    ) -> Self {
        self.child(OsStr::new(&format!("{before}{}{after}", name.component())))
    }

    /// A place that is named by a number, for instance `chunk-003`.
    #[must_use]
    pub fn join_number(&self, before: &'static str, number: impl fmt::LowerHex) -> Self {
        self.child(OsStr::new(&format!("{before}{number:02x}")))
    }

    /// `self` with the name `name.N`, for a free name beside one that is taken.
    #[must_use]
    pub fn numbered(&self, number: usize) -> Self {
        let mut name = self.relative.clone().into_os_string();
        name.push(format!(".{number}"));
        Self {
            root: self.root.clone(),
            relative: name.into(),
        }
    }

    /// A place beside it with a hidden name by chance, for a file that gets its own name last.
    #[must_use]
    pub fn partial(&self) -> Self {
        self.parent().child(OsStr::new(&partial_name()))
    }

    /// A child by a name that is known to be one component.
    fn child(&self, name: &OsStr) -> Self {
        Self {
            root: self.root.clone(),
            relative: self.relative.join(name),
        }
    }

    /// The folder below which it is.
    #[must_use]
    pub fn root(&self) -> &Root {
        &self.root
    }

    /// The folder that it is in; that of the root is the root.
    #[must_use]
    pub fn parent(&self) -> Self {
        Self {
            root: self.root.clone(),
            relative: self.relative.parent().unwrap_or(Path::new("")).to_owned(),
        }
    }

    /// Its last component as text; empty for the root.
    #[must_use]
    pub fn name(&self) -> String {
        let name = self.relative.file_name().unwrap_or_default();
        name.to_string_lossy().into_owned()
    }

    /// The path for people. Opening it is not safe: use the methods.
    #[must_use]
    pub fn shown(&self) -> PathBuf {
        self.root.path().join(&self.relative)
    }

    /// The path for messages.
    pub fn display(&self) -> impl fmt::Display {
        self.shown().display().to_string()
    }

    /// What is there.
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

    /// Whether a folder is there.
    #[must_use]
    pub fn is_dir(&self) -> bool {
        self.metadata().is_ok_and(|found| found.is_dir)
    }

    /// Whether a regular file is there.
    #[must_use]
    pub fn is_file(&self) -> bool {
        self.metadata().is_ok_and(|found| found.is_file)
    }

    /// Whether the name is taken, be it by a link to nothing.
    #[must_use]
    pub fn is_taken(&self) -> bool {
        self.in_parent(|dir, name| statat(dir, name, AtFlags::SYMLINK_NOFOLLOW))
            .is_ok()
    }

    /// Whether it is a symbolic link, wherever that leads.
    #[must_use]
    pub fn is_link(&self) -> bool {
        self.in_parent(|dir, name| statat(dir, name, AtFlags::SYMLINK_NOFOLLOW))
            .is_ok_and(|s| FileType::from_raw_mode(s.st_mode as RawMode) == FileType::Symlink)
    }

    /// The place of the same name in another folder of the same root.
    #[must_use]
    pub fn moved_into(&self, folder: &Self) -> Self {
        folder.child(self.relative.file_name().unwrap_or_default())
    }

    /// What the folder holds, sorted by name.
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn entries(&self) -> io::Result<Vec<Self>> {
        let fd = self.open(OFlags::RDONLY | OFlags::DIRECTORY, Mode::empty())?;
        let mut names = Vec::new();
        for entry in Dir::read_from(&fd)? {
            let name = OsString::from_vec(entry?.file_name().to_bytes().to_vec());
            if name != "." && name != ".." {
                names.push(name);
            }
        }
        names.sort();
        Ok(names.iter().map(|name| self.child(name)).collect())
    }

    /// Opens a regular file for reading.
    ///
    /// # Errors
    /// [`Refused`] for anything else and for a file larger than its kind can be; those of the
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
    /// As of [`open_file`](Self::open_file).
    pub fn read(&self, kind: FileKind) -> io::Result<Vec<u8>> {
        read_all(self.open_file(kind)?, kind)
    }

    /// Reads a regular file of UTF-8.
    ///
    /// # Errors
    /// As of [`open_file`](Self::open_file); `InvalidData` for other bytes.
    pub fn read_to_string(&self, kind: FileKind) -> io::Result<String> {
        String::from_utf8(self.read(kind)?)
            .map_err(|e| io::Error::new(io::ErrorKind::InvalidData, e))
    }

    /// Makes a file that is not there yet; a name that is taken, be it by a link, is an error.
    ///
    /// # Errors
    /// `AlreadyExists`; those of the operating system.
    pub fn create_new(&self) -> io::Result<File> {
        let flags = OFlags::WRONLY | OFlags::CREATE | OFlags::EXCL | OFlags::NOFOLLOW;
        Ok(self
            .in_parent(|dir, name| openat(dir, name, flags | OFlags::CLOEXEC, FILE_MODE))?
            .into())
    }

    /// Writes a file whole in the place of what had its name, links included, and forces its
    /// contents to the disk. The name is durable only after [`sync_dir`](Self::sync_dir).
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

    /// Replaces a file whole or not at all: readers see the old contents or the new. A link is
    /// replaced, not followed.
    ///
    /// # Errors
    /// Those of the operating system; the old file is then as it was.
    pub fn replace(&self, bytes: &[u8]) -> io::Result<()> {
        let partial = self.partial();
        let written = partial.write(bytes).and_then(|()| partial.rename(self));
        if written.is_err() {
            // The cause is what the caller reports.
            let _ = partial.remove_file();
        }
        written
    }

    /// Opens a file of one's own for appending; makes it where it is missing.
    ///
    /// # Errors
    /// [`Refused`] for a link, for what is no regular file and for one with other names.
    pub fn append(&self) -> io::Result<File> {
        let flags = OFlags::WRONLY | OFlags::APPEND | OFlags::CREATE;
        let flags = flags | OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let fd = self.in_parent(|dir, name| openat(dir, name, flags, FILE_MODE))?;
        owned(fd)
    }

    /// Makes a folder whose parent exists.
    ///
    /// # Errors
    /// `AlreadyExists`, those of the operating system.
    pub fn create_dir(&self) -> io::Result<()> {
        self.in_parent(|dir, name| mkdirat(dir, name, DIR_MODE))
    }

    /// Makes a folder, and those above it below the root, where they are missing.
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
            made => made,
        }
    }

    /// Gives a file a second name; its contents are shared.
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn hard_link(&self, to: &Self) -> io::Result<()> {
        self.in_parent_io(|dir, name| {
            to.in_parent(|to_dir, to_name| linkat(dir, name, to_dir, to_name, AtFlags::empty()))
        })
    }

    /// Renames, replacing a file that has the new name.
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn rename(&self, to: &Self) -> io::Result<()> {
        self.in_parent_io(|dir, name| {
            to.in_parent(|to_dir, to_name| renameat(dir, name, to_dir, to_name))
        })
    }

    /// Renames; fails where the new name is taken.
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
            // Some network and FAT file systems lack the flag. Locks keep other writers out, so
            // looking first is as good there.
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

    /// Removes an empty folder.
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn remove_dir(&self) -> io::Result<()> {
        self.in_parent(|dir, name| unlinkat(dir, name, AtFlags::REMOVEDIR))
    }

    /// Forces the names inside a folder to the disk.
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn sync_dir(&self) -> io::Result<()> {
        let fd = self.open(OFlags::RDONLY | OFlags::DIRECTORY, Mode::empty())?;
        Ok(fsync(fd)?)
    }

    /// Does something in the folder that the place is in; the name is not followed.
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

    /// Opens what a link leads to outside of the root, where the user allowed that.
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
