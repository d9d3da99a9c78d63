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
use std::io::{self, Read as _, Write as _};
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::ffi::OsStringExt as _;
use std::path::{Path, PathBuf};
use std::sync::{Arc, RwLock};

use rustix::fs::{
    AtFlags, CWD, Dir, FileType, Mode, OFlags, RawMode, RenameFlags, ResolveFlags, fstat, fsync,
    linkat, mkdirat, openat, openat2, renameat, renameat_with, statat, unlinkat,
};
use rustix::io::Errno;

use super::name::{ContentKey, FileName, GraspId, ObjectName, SimulationId};
use super::partial_name;
use crate::error::Refused;

/// Rights of new files and folders, less the umask.
const FILE_MODE: Mode = Mode::from_raw_mode(0o666);
const DIR_MODE: Mode = Mode::from_raw_mode(0o777);
/// `openat2` asks to try again when a folder moves meanwhile.
const MAX_TRIES: usize = 16;

/// Folders outside of a root into which its links may lead; set once by the application.
static ALLOWED: RwLock<Vec<PathBuf>> = RwLock::new(Vec::new());

/// Permits symbolic links below any [`Root`] that lead into one of these folders.
pub fn allow_links_into(folders: Vec<PathBuf>) {
    *ALLOWED.write().unwrap_or_else(|e| e.into_inner()) = folders;
}

/// What a file holds; says how large one can be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// A record, a card, a configuration: JSON or TOML written by hand or of one item.
    Record,
    /// A compressed image or a raw frame of a camera.
    Image,
    /// A list with a line or a row an item: index, plan, table, log.
    List,
    /// A mesh, its buffers and textures, a trace.
    Mesh,
    /// An ONNX file: protobuf ends at 2 GiB.
    Model,
    /// A shard of samples, an HDF5 file: what is read piece by piece.
    Bulk,
}

impl FileKind {
    /// Largest file of this kind, bytes.
    #[must_use]
    pub fn max_bytes(self) -> u64 {
        const MIB: u64 = 1 << 20;
        match self {
            Self::Record => 16 * MIB,
            Self::Image => 256 * MIB,
            Self::List | Self::Mesh | Self::Model => 2048 * MIB,
            Self::Bulk => 16 * 1024 * MIB,
        }
    }
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

    fn open(&self) -> io::Result<OwnedFd> {
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

/// Opens a path below a folder; `XDEV` where it leads out of it.
fn open_beneath(
    root: impl AsFd,
    relative: &Path,
    flags: OFlags,
    mode: Mode,
) -> rustix::io::Result<OwnedFd> {
    let relative = if relative.as_os_str().is_empty() {
        Path::new(".")
    } else {
        relative
    };
    let flags = flags | OFlags::CLOEXEC;
    let resolve = ResolveFlags::BENEATH | ResolveFlags::NO_MAGICLINKS;
    for _ in 0..MAX_TRIES {
        match openat2(root.as_fd(), relative, flags, mode, resolve) {
            // Another rename or mount of the system came in between.
            Err(Errno::AGAIN) => {}
            // Kernels before 5.6, and sandboxes that forbid calls that they do not know.
            Err(Errno::NOSYS | Errno::PERM) => return open_stepwise(root, relative, flags, mode),
            opened => return opened,
        }
    }
    Err(Errno::AGAIN)
}

/// The same without `openat2`: component by component, following no link.
fn open_stepwise(
    root: impl AsFd,
    relative: &Path,
    flags: OFlags,
    mode: Mode,
) -> rustix::io::Result<OwnedFd> {
    use std::path::Component as Part;
    let step = OFlags::PATH | OFlags::DIRECTORY | OFlags::NOFOLLOW | OFlags::CLOEXEC;
    let mut dir = openat(root.as_fd(), ".", step, Mode::empty())?;
    let mut parts = relative.components().peekable();
    while let Some(part) = parts.next() {
        let name = match part {
            Part::Normal(name) => name,
            Part::CurDir => OsStr::new("."),
            Part::ParentDir | Part::RootDir | Part::Prefix(_) => return Err(Errno::XDEV),
        };
        let is_last = parts.peek().is_none();
        let how = if is_last {
            flags | OFlags::NOFOLLOW
        } else {
            step
        };
        dir = match openat(&dir, name, how, mode) {
            // ELOOP for a link that is to be opened, ENOTDIR for one on the way.
            Err(Errno::LOOP) => return Err(Errno::XDEV),
            Err(Errno::NOTDIR)
                if statat(&dir, name, AtFlags::SYMLINK_NOFOLLOW).is_ok_and(|s| {
                    FileType::from_raw_mode(s.st_mode as RawMode) == FileType::Symlink
                }) =>
            {
                return Err(Errno::XDEV);
            }
            opened => opened?,
        };
    }
    Ok(dir)
}

/// What is no regular file, in words.
fn irregular(kind: FileType) -> Option<Refused> {
    let found = match kind {
        FileType::RegularFile => return None,
        FileType::Directory => "a folder",
        FileType::Symlink => "a symbolic link",
        FileType::Fifo => "a pipe",
        FileType::Socket => "a socket",
        FileType::CharacterDevice | FileType::BlockDevice => "a device",
        FileType::Unknown => "something else",
    };
    Some(Refused::NotRegular(found))
}

fn regular(fd: OwnedFd, kind: FileKind) -> io::Result<File> {
    let stat = fstat(&fd)?;
    if let Some(refused) = irregular(FileType::from_raw_mode(stat.st_mode as RawMode)) {
        return Err(refused.into());
    }
    let bytes = u64::try_from(stat.st_size).unwrap_or(0);
    let limit = kind.max_bytes();
    if bytes > limit {
        return Err(Refused::TooLarge { bytes, limit }.into());
    }
    Ok(fd.into())
}

/// A regular file that has no other name.
fn owned(fd: OwnedFd) -> io::Result<File> {
    let stat = fstat(&fd)?;
    if let Some(refused) = irregular(FileType::from_raw_mode(stat.st_mode as RawMode)) {
        return Err(refused.into());
    }
    if stat.st_nlink > 1 {
        return Err(Refused::Linked.into());
    }
    Ok(fd.into())
}

fn read_all(mut file: File, kind: FileKind) -> io::Result<Vec<u8>> {
    let limit = kind.max_bytes();
    let expected = file.metadata()?.len();
    let mut bytes = Vec::with_capacity(usize::try_from(expected).unwrap_or(0) + 1);
    // One that grows while it is read, and those of /proc, do not say how large they are.
    (&mut file).take(limit + 1).read_to_end(&mut bytes)?;
    let found = bytes.len() as u64;
    if found > limit {
        return Err(Refused::TooLarge {
            bytes: found,
            limit,
        }
        .into());
    }
    Ok(bytes)
}

/// Opens a regular file at a path that the user gave; links are followed.
///
/// # Errors
/// [`Refused`] for a device, a pipe, a socket, a folder, and for a file larger than its kind can
/// be; those of the operating system.
pub fn open_regular(path: &Path, kind: FileKind) -> io::Result<File> {
    let flags = OFlags::RDONLY | OFlags::NONBLOCK | OFlags::NOCTTY | OFlags::CLOEXEC;
    // Opening a device may already do something, so look first.
    let stat = rustix::fs::stat(path)?;
    if let Some(refused) = irregular(FileType::from_raw_mode(stat.st_mode as RawMode)) {
        return Err(refused.into());
    }
    regular(openat(CWD, path, flags, Mode::empty())?, kind)
}

/// Reads a regular file at a path that the user gave.
///
/// # Errors
/// As of [`open_regular`].
pub fn read_regular(path: &Path, kind: FileKind) -> io::Result<Vec<u8>> {
    read_all(open_regular(path, kind)?, kind)
}

/// Reads a regular file of UTF-8 at a path that the user gave.
///
/// # Errors
/// As of [`open_regular`]; `InvalidData` for other bytes.
pub fn read_text(path: &Path, kind: FileKind) -> io::Result<String> {
    String::from_utf8(read_regular(path, kind)?)
        .map_err(|e| io::Error::new(io::ErrorKind::InvalidData, e))
}

/// Opens a lock file without following a link; `write`: makes it where it is missing.
pub(super) fn open_lock(
    dir: impl AsFd,
    path: impl rustix::path::Arg,
    write: bool,
) -> io::Result<File> {
    let flags = OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::NOCTTY | OFlags::CLOEXEC;
    let flags = flags
        | if write {
            OFlags::RDWR | OFlags::CREATE
        } else {
            OFlags::RDONLY
        };
    match openat(dir, path, flags, FILE_MODE) {
        Err(Errno::LOOP) => Err(Refused::NotRegular("a symbolic link").into()),
        opened => owned(opened?),
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::os::unix::fs::symlink;

    use super::*;

    fn refused(error: &io::Error) -> Option<&Refused> {
        error.get_ref()?.downcast_ref()
    }

    /// A folder `data` with a secret beside it.
    fn jail() -> (tempfile::TempDir, Root) {
        let dir = tempfile::tempdir().unwrap();
        fs::create_dir(dir.path().join("data")).unwrap();
        fs::write(dir.path().join("secret"), "secret").unwrap();
        let root = Root::new(dir.path().join("data"));
        (dir, root)
    }

    #[test]
    fn links_out_of_the_folder_are_refused_and_those_inside_followed() {
        let (dir, root) = jail();
        let data = dir.path().join("data");
        fs::write(data.join("file"), "inside").unwrap();
        symlink("file", data.join("good")).unwrap();
        symlink("../secret", data.join("relative")).unwrap();
        symlink(dir.path().join("secret"), data.join("absolute")).unwrap();
        symlink("..", data.join("up")).unwrap();
        symlink("/proc/self/root", data.join("magic")).unwrap();
        let top = root.top();
        assert_eq!(top.join("good").read(FileKind::Record).unwrap(), b"inside");
        for place in [
            top.join("relative"),
            top.join("absolute"),
            top.join("up").join("secret"),
            top.join("magic").join("etc"),
        ] {
            let error = place.read(FileKind::Record).unwrap_err();
            assert!(
                matches!(refused(&error), Some(Refused::Outside { .. })),
                "{}: {error}",
                place.display()
            );
            assert!(!place.is_file() && !place.is_dir());
        }
        let error = top.join("up").join("new").write(b"x").unwrap_err();
        assert!(refused(&error).is_some(), "{error}");
        assert!(!dir.path().join("new").exists());
        for path in ["../secret", "/etc/passwd", "a/../../secret", "./../secret"] {
            assert!(root.resolve(path).is_err(), "{path}");
        }
        assert!(root.resolve("./textures//a.png").is_ok());
    }

    #[test]
    fn without_openat2_no_link_is_followed() {
        let (dir, root) = jail();
        let data = dir.path().join("data");
        fs::create_dir(data.join("sub")).unwrap();
        fs::write(data.join("sub/file"), "x").unwrap();
        symlink("sub", data.join("link")).unwrap();
        symlink("../secret", data.join("out")).unwrap();
        let open = |path: &str| {
            open_stepwise(
                root.open().unwrap(),
                Path::new(path),
                OFlags::RDONLY,
                Mode::empty(),
            )
        };
        assert!(open("sub/file").is_ok());
        assert!(open(".").is_ok());
        for path in ["link/file", "out", "../secret", "sub/../../secret"] {
            assert_eq!(open(path).unwrap_err(), Errno::XDEV, "{path}");
        }
        assert_eq!(open("sub/none").unwrap_err(), Errno::NOENT);
    }

    #[test]
    fn a_write_replaces_a_link_and_never_its_target() {
        let (dir, root) = jail();
        let secret = dir.path().join("secret");
        let place = root.top().join("file");
        for write in [BeneathPath::write, BeneathPath::replace] {
            let _ = fs::remove_file(place.shown());
            symlink("../secret", place.shown()).unwrap();
            write(&place, b"new").unwrap();
            assert_eq!(fs::read(&secret).unwrap(), b"secret");
            assert_eq!(place.read(FileKind::Record).unwrap(), b"new");
            let _ = fs::remove_file(place.shown());
            fs::hard_link(&secret, place.shown()).unwrap();
            write(&place, b"new").unwrap();
            assert_eq!(fs::read(&secret).unwrap(), b"secret");
        }
        let log = root.top().join("log");
        symlink("../secret", log.shown()).unwrap();
        assert!(log.append().is_err());
        fs::remove_file(log.shown()).unwrap();
        fs::hard_link(&secret, log.shown()).unwrap();
        let error = log.append().unwrap_err();
        assert_eq!(refused(&error), Some(&Refused::Linked));
        assert!(root.top().join("link").create_new().is_ok());
        assert!(root.top().join("link").create_new().is_err());
    }

    #[test]
    fn devices_pipes_sockets_and_huge_files_are_refused() {
        let (dir, root) = jail();
        let data = dir.path().join("data");
        let top = root.top();
        let mode = Mode::from_raw_mode(0o600);
        rustix::fs::mknodat(CWD, data.join("pipe"), FileType::Fifo, mode, 0).unwrap();
        let _socket = std::os::unix::net::UnixListener::bind(data.join("socket")).unwrap();
        fs::create_dir(data.join("folder")).unwrap();
        fs::File::create(data.join("huge"))
            .unwrap()
            .set_len(1 << 40)
            .unwrap();
        for name in ["pipe", "folder", "huge"] {
            let error = top.join(name).read(FileKind::Bulk).unwrap_err();
            assert!(refused(&error).is_some(), "{name}: {error}");
        }
        assert!(top.join("socket").read(FileKind::Bulk).is_err());
        for path in [
            Path::new("/dev/zero"),
            &data.join("pipe"),
            &data.join("huge"),
        ] {
            let error = read_regular(path, FileKind::Bulk).unwrap_err();
            assert!(refused(&error).is_some(), "{}: {error}", path.display());
        }
        assert!(read_regular(Path::new("/proc/self/status"), FileKind::Record).is_ok());
    }

    #[test]
    fn the_root_may_be_a_link_and_links_may_lead_where_the_user_allows() {
        let (dir, root) = jail();
        let disk = dir.path().join("disk");
        fs::create_dir(&disk).unwrap();
        fs::write(disk.join("file"), "far").unwrap();
        symlink(&disk, dir.path().join("data/grasps")).unwrap();
        symlink("data", dir.path().join("alias")).unwrap();
        let place = root.top().join("grasps").join("file");
        assert!(place.read(FileKind::Record).is_err());
        allow_links_into(vec![disk]);
        assert_eq!(place.read(FileKind::Record).unwrap(), b"far");
        let alias = Root::new(dir.path().join("alias"));
        let place = alias.top().join("grasps").join("new");
        place.write(b"x").unwrap();
        assert_eq!(place.read(FileKind::Record).unwrap(), b"x");
        symlink("../secret", dir.path().join("data/other")).unwrap();
        assert!(!root.top().join("other").is_file());
        allow_links_into(Vec::new());
        assert!(place.read(FileKind::Record).is_err());
    }

    #[test]
    fn folders_are_listed_made_and_renamed_below() {
        let (_dir, root) = jail();
        let place = root.top().join("a").join("b");
        place.create_dir_all().unwrap();
        place.create_dir_all().unwrap();
        let [one, two] = ["one", "two"].map(|name| place.join(name));
        one.write(b"1").unwrap();
        two.write(b"2").unwrap();
        assert_eq!(place.entries().unwrap(), [one.clone(), two.clone()]);
        assert_eq!(
            one.rename_new(&two).unwrap_err().kind(),
            io::ErrorKind::AlreadyExists
        );
        one.rename(&two).unwrap();
        assert_eq!(two.read(FileKind::Record).unwrap(), b"1");
        two.hard_link(&one).unwrap();
        two.remove_file().unwrap();
        one.remove_file().unwrap();
        place.sync_dir().unwrap();
        place.remove_dir().unwrap();
        assert_eq!(place.name(), "b");
        assert_eq!(place.parent(), root.top().join("a"));
        assert_eq!(place.numbered(2).name(), "b.2");
    }
}
