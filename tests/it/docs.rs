//! Runs the shell blocks of README, tutorial and how-to guides.
//!
//! The `sh` blocks of a page run in order in one shell in an empty folder, with the program on the
//! path. A comment on the line before a block changes that: `<!-- not run: REASON -->`, or
//! `<!-- exit codes: 0 4 -->` for other codes than 0. With `<!-- needs: kitchen -->` anywhere on
//! the page, the folder has a small dataset `kitchen`.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use crate::dataset::write_dataset;
use crate::program;

/// Time limit of a page, for a busy machine.
const TIMEOUT_S: &str = "600";

/// A fenced block of a page.
#[derive(Debug, PartialEq)]
struct Block<'a> {
    line: usize,
    language: &'a str,
    comment: &'a str,
    text: String,
}

fn blocks(page: &str) -> Vec<Block<'_>> {
    let mut found: Vec<Block<'_>> = Vec::new();
    let mut previous = "";
    let mut is_inside = false;
    for (index, line) in page.lines().enumerate() {
        let text = line.trim();
        if let Some(language) = text.strip_prefix("```") {
            is_inside = !is_inside;
            if is_inside {
                let comment = previous.strip_prefix("<!--").unwrap_or_default();
                found.push(Block {
                    line: index + 1,
                    language,
                    comment: comment.trim_end_matches("-->").trim(),
                    text: String::new(),
                });
            }
        } else if is_inside && let Some(block) = found.last_mut() {
            block.text.push_str(line);
            block.text.push('\n');
        }
        previous = text;
    }
    found
}

/// Returns the script of a page that writes the line of each block to `block` before it runs.
fn script(page: &str) -> Result<String, String> {
    let mut script = "set -euo pipefail\n".to_owned();
    for block in blocks(page) {
        let is_command = ["gripcast ", "cargo ", "make ", "sudo "]
            .iter()
            .any(|name| block.text.starts_with(name));
        match (block.language, block.comment.split_once(": ")) {
            ("sh", Some(("not run", reason))) if !reason.is_empty() => {}
            ("sh", Some(("exit codes", codes))) => {
                let codes = codes.replace(' ', "|");
                let _ = write!(
                    script,
                    "echo {} > \"$BLOCK\"\ncode=0\n{{\n{}}} || code=$?\n\
                     case $code in {codes}) ;; *) exit $code ;; esac\n",
                    block.line, block.text
                );
            }
            ("sh", _) => {
                let _ = write!(script, "echo {} > \"$BLOCK\"\n{}", block.line, block.text);
            }
            ("", _) if is_command => {
                return Err(format!(
                    "line {}: commands need the language `sh`",
                    block.line
                ));
            }
            _ => {}
        }
    }
    Ok(script)
}

fn run(path: &Path) {
    let name = path.display();
    let page = fs::read_to_string(path).unwrap();
    let script = script(&page).unwrap_or_else(|error| panic!("{name}: {error}"));
    let dir = tempfile::tempdir().unwrap();
    let work = dir.path().join("work");
    fs::create_dir(&work).unwrap();
    if page.contains("<!-- needs: kitchen -->") {
        write_dataset(&work.join("kitchen"), &["mug", "bottle", "mug", "sponge"]);
    }
    let bin = Path::new(env!("CARGO_BIN_EXE_gripcast")).parent().unwrap();
    let search = std::env::var("PATH").unwrap_or_default();
    // Messages go to a file: a background job of the page would keep a pipe open.
    let log = dir.path().join("log");
    let output = fs::File::create(&log).unwrap();
    let mut shell = Command::new("timeout");
    shell
        .args([TIMEOUT_S, "bash", "-c", &script])
        .current_dir(&work)
        .env("BLOCK", dir.path().join("block"))
        .env("PATH", format!("{}:{search}", bin.display()))
        .env("HOME", dir.path())
        .env("XDG_RUNTIME_DIR", dir.path())
        .stdin(Stdio::null())
        .stdout(output.try_clone().unwrap())
        .stderr(output);
    program::set_environment(&mut shell);
    program::relax_guards(&mut shell);
    let status = shell.status().unwrap();
    let line = fs::read_to_string(dir.path().join("block")).unwrap_or_default();
    let log = fs::read_to_string(log).unwrap();
    assert!(status.success(), "{name}:{}: {status}\n{log}", line.trim());
}

fn page(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(name)
}

#[test]
fn readme_commands_run() {
    run(&page("README.md"));
}

#[test]
fn tutorial_commands_run() {
    run(&page("docs/tutorial/unboxing-to-report.md"));
}

#[test]
fn how_to_commands_run() {
    let pages = fs::read_dir(page("docs/how-to")).unwrap();
    let mut pages: Vec<PathBuf> = pages.map(|entry| entry.unwrap().path()).collect();
    pages.sort();
    assert!(pages.len() > 10, "{pages:?}");
    pages.iter().for_each(|page| run(page));
}

#[test]
fn comment_before_a_block_decides_whether_it_runs() {
    let page = "<!-- not run: slow -->\n```sh\nslow\n```\n```toml\na = 1\n```\n\
                <!-- exit codes: 0 4 -->\n```sh\nexit 4\n```\n  ```sh\n  true\n  ```\n";
    let script = script(page).unwrap();
    assert!(
        !script.contains("slow") && !script.contains("a = 1"),
        "{script}"
    );
    assert!(script.contains("case $code in 0|4)"), "{script}");
    assert!(
        script.ends_with("echo 12 > \"$BLOCK\"\n  true\n"),
        "{script}"
    );
}

#[test]
fn commands_without_language_are_refused() {
    let error = script("text\n\n```\ngripcast doctor\n```\n").unwrap_err();
    assert_eq!(error, "line 3: commands need the language `sh`");
    assert!(script("```\na drawing\n```\n").is_ok());
}
