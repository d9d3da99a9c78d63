//! Paths below a directory with hostile contents.

use std::fs;
use std::io;
use std::os::unix::fs::symlink;
use std::path::Path;

use rustix::fs::{CWD, FileType, Mode, OFlags};
use rustix::io::Errno;

use super::beneath::*;
use super::opening::*;
use crate::error::Refused;

fn refused(error: &io::Error) -> Option<&Refused> {
    error.get_ref()?.downcast_ref()
}

/// A directory `data` with a secret file beside it.
fn jail() -> (tempfile::TempDir, Root) {
    let dir = tempfile::tempdir().unwrap();
    fs::create_dir(dir.path().join("data")).unwrap();
    fs::write(dir.path().join("secret"), "secret").unwrap();
    let root = Root::new(dir.path().join("data"));
    (dir, root)
}

#[test]
fn links_are_followed_only_inside_the_root() {
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
    for path in [
        top.join("relative"),
        top.join("absolute"),
        top.join("up").join("secret"),
        top.join("magic").join("etc"),
    ] {
        let error = path.read(FileKind::Record).unwrap_err();
        assert!(
            matches!(refused(&error), Some(Refused::Outside { .. })),
            "{}: {error}",
            path.display()
        );
        assert!(!path.is_file() && !path.is_dir());
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
fn stepwise_open_follows_no_link() {
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
fn write_replaces_a_link_not_its_target() {
    let (dir, root) = jail();
    let secret = dir.path().join("secret");
    let target = root.top().join("file");
    for write in [BeneathPath::write, BeneathPath::replace] {
        let _ = fs::remove_file(target.shown());
        symlink("../secret", target.shown()).unwrap();
        write(&target, b"new").unwrap();
        assert_eq!(fs::read(&secret).unwrap(), b"secret");
        assert_eq!(target.read(FileKind::Record).unwrap(), b"new");
        let _ = fs::remove_file(target.shown());
        fs::hard_link(&secret, target.shown()).unwrap();
        write(&target, b"new").unwrap();
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
fn allowed_links_and_linked_roots_are_followed() {
    let (dir, root) = jail();
    let disk = dir.path().join("disk");
    fs::create_dir(&disk).unwrap();
    fs::write(disk.join("file"), "far").unwrap();
    symlink(&disk, dir.path().join("data/grasps")).unwrap();
    symlink("data", dir.path().join("alias")).unwrap();
    let target = root.top().join("grasps").join("file");
    assert!(target.read(FileKind::Record).is_err());
    allow_links_into(vec![disk]);
    assert_eq!(target.read(FileKind::Record).unwrap(), b"far");
    let alias = Root::new(dir.path().join("alias"));
    let target = alias.top().join("grasps").join("new");
    target.write(b"x").unwrap();
    assert_eq!(target.read(FileKind::Record).unwrap(), b"x");
    symlink("../secret", dir.path().join("data/other")).unwrap();
    assert!(!root.top().join("other").is_file());
    allow_links_into(Vec::new());
    assert!(target.read(FileKind::Record).is_err());
}

#[test]
fn directories_are_created_listed_and_renamed() {
    let (_dir, root) = jail();
    let target = root.top().join("a").join("b");
    target.create_dir_all().unwrap();
    target.create_dir_all().unwrap();
    let [one, two] = ["one", "two"].map(|name| target.join(name));
    one.write(b"1").unwrap();
    two.write(b"2").unwrap();
    assert_eq!(target.entries().unwrap(), [one.clone(), two.clone()]);
    assert_eq!(
        one.rename_new(&two).unwrap_err().kind(),
        io::ErrorKind::AlreadyExists
    );
    one.rename(&two).unwrap();
    assert_eq!(two.read(FileKind::Record).unwrap(), b"1");
    two.hard_link(&one).unwrap();
    two.remove_file().unwrap();
    one.remove_file().unwrap();
    target.sync_dir().unwrap();
    target.remove_dir().unwrap();
    assert_eq!(target.name(), "b");
    assert_eq!(target.parent(), root.top().join("a"));
    assert_eq!(target.numbered(2).name(), "b.2");
}

#[test]
fn directory_that_cannot_be_flushed_is_no_error() {
    // The kernel's own file system answers EINVAL, as SMB and some FUSE do.
    let proc = Root::new("/proc").top();
    assert!(!proc.can_sync_dir().unwrap());
    proc.sync_dir().unwrap();
    let dir = tempfile::tempdir().unwrap();
    let disk = Root::new(dir.path()).top();
    assert!(disk.can_sync_dir().unwrap());
    disk.sync_dir().unwrap();
    assert!(disk.join("none").sync_dir().is_err());
}
