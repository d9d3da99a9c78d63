//! Every option that a message or a page names exists in the command that it is for.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use clap::Command;
use gripcast::cli;

/// Other programs whose options messages name.
const OTHER_PROGRAMS: [&str; 4] = ["udevadm", "ptrepack", "cargo", "gltf-transform"];

/// Long options by command, such as `render calibrate`; those of the program by the empty name.
type Flags = BTreeMap<String, BTreeSet<String>>;

fn collect(command: &Command, name: &str, all: &mut Flags) {
    let own = command.get_arguments();
    let own = own.flat_map(|arg| arg.get_long_and_visible_aliases().unwrap_or_default());
    let own = own.map(|long| format!("--{long}")).collect();
    all.insert(name.to_owned(), own);
    for below in command.get_subcommands() {
        collect(below, format!("{name} {}", below.get_name()).trim(), all);
    }
}

fn flags() -> Flags {
    let mut program = cli::command();
    program.build();
    let mut all = Flags::new();
    collect(&program, "", &mut all);
    all
}

/// Command and place of an unknown option.
fn unknown(text: &str, flags: &Flags, default: &str) -> Vec<String> {
    let mut command = default.to_owned();
    let mut is_other = false;
    let mut after_name = false;
    let mut found = Vec::new();
    for word in text.split(|c: char| c.is_whitespace() || c == '\\' || c == '\0') {
        let bare = word.trim_matches(|c: char| !c.is_alphanumeric() && c != '-');
        if bare == "gripcast" {
            (command, is_other, after_name) = (String::new(), false, true);
        } else if OTHER_PROGRAMS.contains(&bare) {
            is_other = true;
        } else if after_name {
            let longer = format!("{command} {bare}");
            match flags.contains_key(longer.trim()) {
                true => command = longer.trim().to_owned(),
                false => after_name = false,
            }
        }
        let name = bare.split(['=', '[', '`', '\'']).next().unwrap_or(bare);
        let is_flag = name
            .strip_prefix("--")
            .is_some_and(|rest| rest.starts_with(|c: char| c.is_ascii_lowercase()));
        if is_flag && !is_other {
            let below = format!("{command} ");
            let mut owners = flags.iter().filter(|(owner, _)| {
                command.is_empty() || **owner == command || owner.starts_with(&below)
            });
            if !owners.any(|(_, known)| known.contains(name)) {
                found.push(format!("`{command}` has no {name}"));
            }
        }
        // The end of a quoted command.
        if word.ends_with(['`', ';', ')']) || word.ends_with("`,") || word.ends_with("`:") {
            (command, is_other, after_name) = (default.to_owned(), false, false);
        }
    }
    found
}

/// String literals of a Rust source without its comments and its test module.
fn literals(source: &str) -> Vec<String> {
    let source = source.split("#[cfg(test)]\nmod ").next().unwrap_or(source);
    let mut found = Vec::new();
    let mut rest = source;
    while let Some(at) = rest.find(['"', '/', '\'']) {
        let (before, tail) = rest.split_at(at);
        rest = if tail.starts_with("//") {
            &tail[tail.find('\n').unwrap_or(tail.len())..]
        } else if let Some(after) = ["'\"'", "'\\\"'"].iter().find_map(|c| tail.strip_prefix(c)) {
            after
        } else if let Some(tail) = tail.strip_prefix('"') {
            let hashes = before.len() - before.trim_end_matches('#').len();
            let is_raw = before[..before.len() - hashes].ends_with('r');
            let (text, after) = match is_raw {
                true => split_raw(tail, hashes),
                false => split_quoted(tail),
            };
            found.push(text.to_owned());
            after
        } else {
            &tail[1..]
        };
    }
    found
}

fn split_raw(text: &str, hashes: usize) -> (&str, &str) {
    let end = format!("\"{}", "#".repeat(hashes));
    text.split_once(&end).unwrap_or((text, ""))
}

fn split_quoted(text: &str) -> (&str, &str) {
    let mut is_escaped = false;
    for (i, c) in text.char_indices() {
        match c {
            _ if is_escaped => is_escaped = false,
            '\\' => is_escaped = true,
            '"' => return (&text[..i], &text[i + 1..]),
            _ => {}
        }
    }
    (text, "")
}

/// Files below a folder of the repository with a suffix.
fn files(folder: &str, suffix: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![Path::new(env!("CARGO_MANIFEST_DIR")).join(folder)];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.to_string_lossy().ends_with(suffix) {
                found.push(path);
            }
        }
    }
    found.sort();
    found
}

/// Command of a file of `src/cli`, such as `render_calibrate.rs`; empty for shared files.
fn command_of(path: &Path, flags: &Flags) -> String {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let words: Vec<String> = stem.split('_').map(str::to_owned).collect();
    // The longest command that the file is named after: `collect_live` belongs to `collect`.
    (1..=words.len())
        .rev()
        .map(|count| words[..count].join(" "))
        .find(|name| flags.contains_key(name))
        .unwrap_or_default()
}

#[test]
fn messages_name_options_of_their_commands() {
    let flags = flags();
    let mut wrong = Vec::new();
    for path in ["src", "crates"].iter().flat_map(|f| files(f, ".rs")) {
        let name = path.to_string_lossy();
        let is_other = ["_test.rs", "/tests.rs", "/build.rs"]
            .iter()
            .any(|end| name.ends_with(end));
        // The measuring program has its own options.
        if is_other || name.contains("/tests/") || name.contains("gripcast-bench") {
            continue;
        }
        let default = match name.contains("/src/cli/") {
            true => command_of(&path, &flags),
            false => String::new(),
        };
        let source = fs::read_to_string(&path).unwrap();
        for text in literals(&source) {
            // A lone option may be an argument of a command that is started.
            let default = if text.contains(' ') { &*default } else { "" };
            let problems = unknown(&text, &flags, default);
            wrong.extend(
                problems
                    .iter()
                    .map(|what| format!("{name}: {what}: {text}")),
            );
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn pages_name_options_of_their_commands() {
    let flags = flags();
    let mut pages = files("docs", ".md");
    pages.push(Path::new(env!("CARGO_MANIFEST_DIR")).join("README.md"));
    let mut wrong = Vec::new();
    for path in pages {
        let page = fs::read_to_string(&path).unwrap();
        for (index, line) in page.lines().enumerate() {
            // Options without a command may be those of other programs.
            let from = line.find("gripcast ").map(|at| &line[at..]);
            let commands = from.unwrap_or_default().split(" # ").next();
            for what in unknown(commands.unwrap_or_default(), &flags, "") {
                wrong.push(format!("{}:{}: {what}", path.display(), index + 1));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn unknown_options_are_found() {
    let flags = flags();
    let of = |text: &str| unknown(text, &flags, "render calibrate");
    assert_eq!(
        of("pass --ball-mm, or run `gripcast collect --dataset DIR`"),
        [""; 0]
    );
    assert_eq!(
        of("pass --ball-diameter"),
        ["`render calibrate` has no --ball-diameter"]
    );
    assert_eq!(
        of("write one with `gripcast sim grasp --presses FILE`, then pass --presses"),
        ["`sim grasp` has no --presses"]
    );
    assert_eq!(of("run `sudo udevadm control --reload`"), [""; 0]);
    let source = "let a = \"x --b\"; // \"no\"\nlet c = '\"'; let d = r#\"e \"f\" g\"#;";
    assert_eq!(literals(source), ["x --b", "e \"f\" g"]);
}
