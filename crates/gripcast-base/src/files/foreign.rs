//! Names and bytes that operating systems, editors, file managers and programs that synchronise
//! folders leave beside data. All readers of folders share these rules.

use std::path::Path;

/// Names of files and folders, in lower case.
const SYSTEM_NAMES: [&str; 26] = [
    // macOS.
    ".ds_store",
    ".appledouble",
    ".apdisk",
    ".fseventsd",
    ".localized",
    ".spotlight-v100",
    ".temporaryitems",
    ".trashes",
    "__macosx",
    // Windows.
    "$recycle.bin",
    "desktop.ini",
    "ehthumbs.db",
    "system volume information",
    "thumbs.db",
    // Linux and network storage.
    ".directory",
    "@eadir",
    "#recycle",
    "lost+found",
    // Dropbox, Resilio Sync, Syncthing, Nextcloud.
    ".dropbox",
    ".dropbox.attr",
    ".dropbox.cache",
    ".sync",
    ".stfolder",
    ".stignore",
    ".stversions",
    ".owncloudsync.log",
];

/// Beginnings of names, in lower case: AppleDouble files, open files that were removed on NFS and
/// FUSE, trash folders, locks of editors, files that are being synchronised.
const SYSTEM_PREFIXES: [&str; 11] = [
    "._",
    ".nfs",
    ".fuse_hidden",
    ".trash-",
    ".#",
    ".~lock.",
    "~$",
    ".syncthing.",
    "~syncthing~",
    ".sync_",
    ".goutputstream-",
];

/// Ends of names, in lower case: backups and swap files of editors.
const SYSTEM_SUFFIXES: [&str; 4] = ["~", ".swp", ".swo", ".!sync"];

/// Marks of conflict copies between the original's stem and its extension, in lower case:
/// Syncthing, Nextcloud, Resilio Sync.
const CONFLICT_MARKS: [&str; 3] = [".sync-conflict-", "_conflict-", ".conflict"];

/// Whether a name is that of a file or folder which an operating system, an editor or a program
/// that synchronises folders creates by itself. It is never data.
#[must_use]
pub fn is_system_file(name: &str) -> bool {
    let name = name.to_lowercase();
    SYSTEM_NAMES.contains(&name.as_str())
        || SYSTEM_PREFIXES
            .iter()
            .any(|prefix| name.starts_with(prefix))
        || SYSTEM_SUFFIXES.iter().any(|suffix| name.ends_with(suffix))
}

/// The name of the original, if a name is that of a copy which a file manager or a program that
/// synchronises folders made: `X (conflicted copy 2026-11-25)`, `X.sync-conflict-….json`,
/// `X (1)`, `X - Copy`.
#[must_use]
pub fn conflict_copy_of(name: &str) -> Option<String> {
    for mark in CONFLICT_MARKS {
        // The marks are ASCII, so that positions in the lower-case name are those in the name.
        if let Some(at) = name.to_ascii_lowercase().find(mark).filter(|at| *at > 0) {
            let rest = &name[at + mark.len()..];
            let extension = rest.rfind('.').map_or("", |dot| &rest[dot..]);
            return Some(format!("{}{extension}", &name[..at]));
        }
    }
    // The addition is before the extension of a file, or at the end of a folder's name.
    let (stem, extension) = match name.rfind('.') {
        Some(dot) if dot > 0 && !name[dot..].contains([')', ' ']) => name.split_at(dot),
        _ => (name, ""),
    };
    let original = without_copy_suffix(stem)?;
    (!original.is_empty()).then(|| format!("{original}{extension}"))
}

/// Removes ` (1)`, ` (… conflicted copy …)`, ` - Copy`, ` copy` and ` copy 2` from the end.
fn without_copy_suffix(stem: &str) -> Option<&str> {
    if let Some((original, addition)) = stem.strip_suffix(')').and_then(|s| s.rsplit_once(" (")) {
        let lower = addition.to_lowercase();
        let is_number = !lower.is_empty() && lower.chars().all(|c| c.is_ascii_digit());
        if lower.contains("conflict") || lower == "copy" || is_number {
            return Some(without_copy_suffix(original).unwrap_or(original));
        }
        return None;
    }
    let unnumbered = stem
        .trim_end_matches(|c: char| c.is_ascii_digit())
        .trim_end();
    [" - Copy", " - copy", " copy"]
        .iter()
        .find_map(|suffix| unnumbered.strip_suffix(suffix))
}

/// The first character of a path that `fsspec`, which Hugging Face `datasets` and others use, takes
/// for a pattern instead of a name.
#[must_use]
pub fn glob_character(path: &Path) -> Option<char> {
    let text = path.to_string_lossy();
    text.chars().find(|c| "[]*?{}".contains(*c))
}

/// The bytes of a text file without the byte-order mark that some editors write before UTF-8.
#[must_use]
pub fn without_bom(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_of_systems_are_recognised() {
        for name in [
            ".DS_Store",
            "._grasp.json",
            "Thumbs.db",
            "THUMBS.DB",
            "desktop.ini",
            ".directory",
            ".nfs000000000001a3f00000002",
            "grasp.json~",
            ".grasp.json.swp",
            ".sync",
            ".stfolder",
            "~syncthing~grasp.json.tmp",
            ".fuse_hidden0000000100000001",
            "lost+found",
            "@eaDir",
        ] {
            assert!(is_system_file(name), "{name}");
        }
        for name in [
            "grasp.json",
            ".tmp-2026-11-20T10-15-03Z-7f3a",
            ".grasp.json.partial",
            ".gripcast-0123456789abcdef.partial",
            ".lock",
            "2026-11-20T10-15-03Z-7f3a",
            "notes.txt",
            "syncthing.png",
        ] {
            assert!(!is_system_file(name), "{name}");
        }
    }

    #[test]
    fn copy_is_traced_to_its_original() {
        for (copy, original) in [
            ("X (conflicted copy)", "X"),
            ("X (Anna's conflicted copy 2026-11-25)", "X"),
            ("X (Case Conflict 1)", "X"),
            ("X (1)", "X"),
            ("X (copy) (2)", "X"),
            ("X - Copy", "X"),
            ("X - Copy (2)", "X"),
            ("X copy 3", "X"),
            ("grasp (1).json", "grasp.json"),
            (
                "grasp.sync-conflict-20261125-101010-ABCDEF.json",
                "grasp.json",
            ),
            ("X.sync-conflict-20261125-101010-ABCDEF", "X"),
            ("grasp_conflict-20261125-101010.json", "grasp.json"),
            ("grasp.Conflict.json", "grasp.json"),
        ] {
            assert_eq!(conflict_copy_of(copy).as_deref(), Some(original), "{copy}");
        }
        for name in [
            "grasp.json",
            "2026-11-20T10-15-03Z-7f3a",
            "kitchen (morning)",
            "photocopy.png",
            "grasp.left.jpg",
            " copy",
            "(1)",
            "é.sync",
        ] {
            assert_eq!(conflict_copy_of(name), None, "{name}");
        }
    }

    #[test]
    fn byte_order_mark_is_removed_once() {
        assert_eq!(without_bom(b"\xef\xbb\xbf{}"), b"{}");
        assert_eq!(without_bom(b"{}"), b"{}");
    }

    #[test]
    fn pattern_characters_are_found() {
        assert_eq!(glob_character(Path::new("kitchen [1]")), Some('['));
        assert_eq!(glob_character(Path::new("/data/a{b/kitchen")), Some('{'));
        assert_eq!(glob_character(Path::new("/data/ümlaut 1")), None);
    }
}
