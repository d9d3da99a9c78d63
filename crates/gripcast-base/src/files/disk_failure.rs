//! What the codes of the operating system say about a disk: remedies, and what it cannot do.

use std::io;
use std::os::fd::OwnedFd;

use rustix::fs::fsync;
use rustix::io::Errno;

/// What to do about an error of a file operation; `None` where the code does not tell the cause.
#[must_use]
pub fn disk_remedy(error: &io::Error) -> Option<&'static str> {
    let Some(errno) = Errno::from_io_error(error) else {
        return by_kind(error.kind());
    };
    Some(match errno {
        Errno::NOSPC => "free space on that disk and try again; everything saved so far is safe",
        Errno::DQUOT => {
            "your quota on that disk is used up: free space or ask for more, and try again; \
             everything saved so far is safe"
        }
        Errno::ROFS => {
            "the disk is mounted read-only, as the kernel does after an error: read `dmesg`, \
             remount it writable and try again"
        }
        Errno::ACCESS | Errno::PERM => {
            "the directory or the disk belongs to another user: make it writable and try again"
        }
        Errno::NOENT => "the dataset was moved or its disk unmounted: restore it and try again",
        Errno::IO => "the disk itself failed: read `dmesg`, copy the data away and replace it",
        Errno::NODEV | Errno::NXIO => "the disk was unplugged: plug it in and mount it again",
        Errno::XDEV => {
            "both places must be on one disk: move the linked folder back, or use a bind mount of \
             the whole dataset"
        }
        Errno::INVAL | Errno::OPNOTSUPP | Errno::NOSYS => {
            "this file system cannot do that: `gripcast doctor --dataset DIR` shows what it can \
             do; use a local disk (ext4, XFS, Btrfs)"
        }
        Errno::NOLCK => {
            "the network file system has no lock service: start `rpc.statd` and the server's \
             lockd, mount it with `local_lock=all` where only this computer writes, or use a \
             local disk"
        }
        Errno::STALE | Errno::NOTCONN | Errno::TIMEDOUT | Errno::HOSTDOWN | Errno::HOSTUNREACH => {
            "the file server does not answer: check the network, mount it again and try again"
        }
        Errno::MFILE => "this program has too many open files: raise `ulimit -n` and restart it",
        Errno::NFILE => "the computer has too many open files: close other programs and try again",
        Errno::NAMETOOLONG => "choose a directory with a shorter path or name",
        Errno::FBIG => {
            "the file system does not hold files of this size: FAT32 ends at 4 GB; use another disk"
        }
        Errno::NOMEM => "the memory is used up: close other programs and try again",
        _ => return None,
    })
}

/// For errors that carry no code, such as those of a test's disk.
fn by_kind(kind: io::ErrorKind) -> Option<&'static str> {
    let errno = match kind {
        io::ErrorKind::StorageFull => Errno::NOSPC,
        io::ErrorKind::QuotaExceeded => Errno::DQUOT,
        io::ErrorKind::ReadOnlyFilesystem => Errno::ROFS,
        io::ErrorKind::PermissionDenied => Errno::ACCESS,
        io::ErrorKind::NotFound => Errno::NOENT,
        io::ErrorKind::CrossesDevices => Errno::XDEV,
        _ => return None,
    };
    disk_remedy(&errno.into())
}

/// Flushes a directory; `false` where the file system cannot.
pub(super) fn flush_dir(dir: &OwnedFd) -> io::Result<bool> {
    match fsync(dir) {
        Ok(()) => Ok(true),
        Err(e) if cannot_flush_dirs(e) => Ok(false),
        Err(e) => Err(e.into()),
    }
}

/// Codes of file systems without a flush of directories.
pub(super) fn cannot_flush_dirs(error: Errno) -> bool {
    matches!(
        error,
        Errno::INVAL | Errno::BADF | Errno::OPNOTSUPP | Errno::NOSYS | Errno::NOTTY
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_code_has_its_own_remedy() {
        let remedy = |errno: Errno| disk_remedy(&errno.into()).unwrap();
        for (errno, words) in [
            (Errno::NOSPC, "free space"),
            (Errno::DQUOT, "quota"),
            (Errno::ROFS, "read-only"),
            (Errno::IO, "the disk itself failed"),
            (Errno::XDEV, "on one disk"),
            (Errno::INVAL, "file system cannot"),
            (Errno::OPNOTSUPP, "file system cannot"),
            (Errno::NOLCK, "lock service"),
            (Errno::STALE, "file server"),
            (Errno::MFILE, "ulimit -n"),
            (Errno::NAMETOOLONG, "shorter"),
        ] {
            let text = remedy(errno);
            assert!(text.contains(words), "{errno:?}: {text}");
            let blames_disk = text.contains("disk itself failed");
            assert_eq!(blames_disk, errno == Errno::IO, "{errno:?}: {text}");
        }
        let full = io::Error::from(io::ErrorKind::StorageFull);
        assert_eq!(disk_remedy(&full), Some(remedy(Errno::NOSPC)));
        assert_eq!(disk_remedy(&io::Error::other("?")), None);
    }
}
