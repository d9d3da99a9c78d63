//! Keeps the two rules of docs/explanation/security.md: files of data are opened below their
//! folder, and text leaves through one place.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// Calls that open a path as it is, or make one of a text.
const RAW: [&str; 14] = [
    "fs::read(",
    "fs::read_to_string(",
    "fs::read_dir(",
    "fs::write(",
    "fs::rename(",
    "fs::copy(",
    "fs::hard_link(",
    "File::open(",
    "File::create(",
    "File::create_new(",
    "OpenOptions::new(",
    ".with_file_name(",
    ".set_file_name(",
    ".leak(",
];

/// Folders of the code whose files somebody else may have made.
const AREAS: [&str; 11] = [
    "crates/gripcast-dataset/src",
    "crates/gripcast-geometry/src",
    "crates/gripcast-imaging/src",
    "crates/gripcast-interop/src",
    "crates/gripcast-nn/src",
    "crates/gripcast-annotate/src",
    "crates/gripcast-replay/src",
    "crates/gripcast-synth/src",
    "crates/gripcast-tactile/src",
    "crates/gripcast-train/src",
    "crates/gripcast-visual/src",
];

/// Raw calls that stay, a count a file, with the reason.
const ALLOWED: &[(&str, usize, &str)] = &[
    (
        "crates/gripcast-interop/src/export/staged.rs",
        4,
        "its own hidden folder beside the target that the user named",
    ),
    (
        "crates/gripcast-tactile/src/profile.rs",
        1,
        "the path that the user named, with a FileName",
    ),
];

/// Product code of a file: not its test module.
fn product(path: &Path) -> String {
    let name = path.file_name().unwrap().to_string_lossy().into_owned();
    if name.ends_with("_test.rs") || name.starts_with("sample") || name.contains("/tests/") {
        return String::new();
    }
    let text = fs::read_to_string(path).unwrap();
    let end = text.find("#[cfg(test)]\nmod tests").unwrap_or(text.len());
    text[..end].to_owned()
}

/// Places in product code below `folder` that have one of the words, a count a file.
fn places(folder: &Path, words: &[&str]) -> BTreeMap<String, usize> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut files = Vec::new();
    rust_files(folder, &mut files);
    let mut found = BTreeMap::new();
    for path in files {
        let text = product(&path);
        let lines = text
            .lines()
            .filter(|line| !line.trim_start().starts_with("//"));
        let has = |line: &str, word: &str| {
            line.match_indices(word).any(|(at, _)| {
                let before = line[..at].chars().next_back();
                word.starts_with('.') || !before.is_some_and(|c| c.is_alphanumeric() || c == '_')
            })
        };
        let count = lines
            .filter(|line| !line.contains(".is_terminal()"))
            .filter(|line| words.iter().any(|word| has(line, word)))
            .count();
        if count > 0 {
            let name = path.strip_prefix(root).unwrap().display().to_string();
            found.insert(name, count);
        }
    }
    found
}

#[test]
fn files_of_data_are_opened_below_their_folder() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let found: BTreeMap<String, usize> = AREAS
        .iter()
        .flat_map(|area| places(&root.join(area), &RAW))
        .collect();
    let allowed: BTreeMap<String, usize> = ALLOWED
        .iter()
        .map(|(file, count, reason)| {
            assert!(!reason.is_empty(), "{file} needs a reason");
            ((*file).to_owned(), *count)
        })
        .collect();
    assert_eq!(
        found, allowed,
        "use files::Root (data) or files::read_regular (a path that the user gave)"
    );
}

#[test]
fn text_leaves_through_one_place() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let words = [
        "println!(",
        "eprintln!(",
        "print!(",
        "eprint!(",
        "io::stderr()",
        "io::stdout()",
    ];
    let mut found = places(&root.join("src"), &words);
    found.extend(places(&root.join("crates"), &words));
    let allowed = [
        // Completion scripts of clap: nothing in them comes from data.
        ("src/cli/completions.rs", 1),
        // A block that is drawn over itself; its lines are escaped.
        ("src/cli/calibrate_live.rs", 1),
        // The place.
        ("src/terminal_text.rs", 2),
        // Names of packages that stand in the source.
        ("crates/gripcast-bench/src/baseline.rs", 1),
        // Cargo reads what a build script prints.
        ("crates/gripcast-pose/build.rs", 5),
        // How tests say that they are skipped.
        ("crates/gripcast-testing/src/lib.rs", 1),
        // The screen: ratatui drops control characters; the rest are modes of the terminal.
        ("src/tui/terminal.rs", 4),
    ];
    let allowed: BTreeMap<String, usize> = allowed
        .into_iter()
        .map(|(file, count)| (file.to_owned(), count))
        .collect();
    assert_eq!(
        found, allowed,
        "use print, print_json or note! of terminal_text"
    );
}

/// Rust files below a folder, sorted.
fn rust_files(dir: &Path, found: &mut Vec<PathBuf>) {
    let mut entries: Vec<_> = fs::read_dir(dir)
        .unwrap()
        .map(|e| e.unwrap().path())
        .collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            rust_files(&path, found);
        } else if path.extension().is_some_and(|e| e == "rs") {
            found.push(path);
        }
    }
}
