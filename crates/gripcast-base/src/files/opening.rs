//! Opens regular files below a directory, with a size limit for each kind.

use std::ffi::OsStr;
use std::fs::File;
use std::io::{self, Read as _};
use std::os::fd::{AsFd, OwnedFd};
use std::path::Path;

use rustix::fs::{
    AtFlags, CWD, FileType, Mode, OFlags, RawMode, ResolveFlags, fstat, openat, openat2, statat,
};
use rustix::io::Errno;

use super::foreign::without_bom;
use crate::error::Refused;

/// Mode of new files, before the umask.
pub(super) const FILE_MODE: Mode = Mode::from_raw_mode(0o666);
/// `openat2` must be retried when a directory moves meanwhile.
const MAX_TRIES: usize = 16;

/// Kind of a file; determines its size limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// A record, model card or configuration: JSON or TOML.
    Record,
    /// A compressed image or a raw frame of a camera.
    Image,
    /// A list with one line or row per item: index, plan, table, log.
    List,
    /// A mesh with its buffers and textures, or a trace.
    Mesh,
    /// An ONNX file: protobuf is limited to 2 GiB.
    Model,
    /// A shard or an HDF5 file, which is read incrementally.
    Bulk,
}

impl FileKind {
    /// Maximum size of a file of this kind, bytes.
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

/// Opens a path below a directory; `XDEV` where it leads out of it.
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
            // A concurrent rename or mount.
            Err(Errno::AGAIN) => {}
            // Kernels before 5.6, and sandboxes that forbid unknown system calls.
            Err(Errno::NOSYS | Errno::PERM) => return open_stepwise(root, relative, flags, mode),
            opened => return opened,
        }
    }
    Err(Errno::AGAIN)
}

/// As [`open_beneath`] without `openat2`: component by component, following no link.
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
            // ELOOP for a link as the last component, ENOTDIR for one before.
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

/// Refuses anything but a regular file.
fn irregular(kind: FileType) -> Option<Refused> {
    let found = match kind {
        FileType::RegularFile => return None,
        FileType::Directory => "a directory",
        FileType::Symlink => "a symbolic link",
        FileType::Fifo => "a pipe",
        FileType::Socket => "a socket",
        FileType::CharacterDevice | FileType::BlockDevice => "a device",
        FileType::Unknown => "an unknown file type",
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

/// Checks for a regular file without other hard links.
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
    // The size of a growing file or one of /proc is not known in advance.
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

/// Opens a regular file at a path given by the user; links are followed.
///
/// # Errors
/// [`Refused`] for a device, a pipe, a socket, a directory, and for a file above the size limit;
/// those of the operating system.
pub fn open_regular(path: &Path, kind: FileKind) -> io::Result<File> {
    let flags = OFlags::RDONLY | OFlags::NONBLOCK | OFlags::NOCTTY | OFlags::CLOEXEC;
    // Opening a device may have side effects, so check first.
    let stat = rustix::fs::stat(path)?;
    if let Some(refused) = irregular(FileType::from_raw_mode(stat.st_mode as RawMode)) {
        return Err(refused.into());
    }
    regular(openat(CWD, path, flags, Mode::empty())?, kind)
}

/// Reads a regular file at a path given by the user.
///
/// # Errors
/// As [`open_regular`].
pub fn read_regular(path: &Path, kind: FileKind) -> io::Result<Vec<u8>> {
    read_all(open_regular(path, kind)?, kind)
}

/// Reads a regular UTF-8 file at a path given by the user, without its byte-order mark.
///
/// # Errors
/// As [`open_regular`]; `InvalidData` for invalid UTF-8.
pub fn read_text(path: &Path, kind: FileKind) -> io::Result<String> {
    text(read_regular(path, kind)?)
}

/// UTF-8 text without its byte-order mark.
pub(super) fn text(mut bytes: Vec<u8>) -> io::Result<String> {
    let mark = bytes.len() - without_bom(&bytes).len();
    bytes.drain(..mark);
    String::from_utf8(bytes).map_err(|e| io::Error::new(io::ErrorKind::InvalidData, e))
}

/// Opens a lock file without following links; `write`: creates it if it is missing.
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
