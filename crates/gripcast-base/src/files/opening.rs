//! How files are opened: below a folder, regular ones only, with a limit of size for each kind.

use std::ffi::OsStr;
use std::fs::File;
use std::io::{self, Read as _};
use std::os::fd::{AsFd, OwnedFd};
use std::path::Path;

use rustix::fs::{
    AtFlags, CWD, FileType, Mode, OFlags, RawMode, ResolveFlags, fstat, openat, openat2, statat,
};
use rustix::io::Errno;

use crate::error::Refused;

/// Rights of new files, less the umask.
pub(super) const FILE_MODE: Mode = Mode::from_raw_mode(0o666);
/// `openat2` asks to try again when a folder moves meanwhile.
const MAX_TRIES: usize = 16;

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

/// Opens a path below a folder; `XDEV` where it leads out of it.
pub(super) fn open_beneath(
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
pub(super) fn open_stepwise(
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

pub(super) fn regular(fd: OwnedFd, kind: FileKind) -> io::Result<File> {
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
pub(super) fn owned(fd: OwnedFd) -> io::Result<File> {
    let stat = fstat(&fd)?;
    if let Some(refused) = irregular(FileType::from_raw_mode(stat.st_mode as RawMode)) {
        return Err(refused.into());
    }
    if stat.st_nlink > 1 {
        return Err(Refused::Linked.into());
    }
    Ok(fd.into())
}

pub(super) fn read_all(mut file: File, kind: FileKind) -> io::Result<Vec<u8>> {
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
