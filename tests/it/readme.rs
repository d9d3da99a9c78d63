//! README repeats figures of the docs and of the model's card; they must agree.

use std::fs;
use std::path::Path;

/// Where the figures of a command stand in full.
const SOURCES: [(&str, &[&str]); 4] = [
    ("gripcast bench", &["docs/reference/performance.md"]),
    ("-p gripcast-bench", &["docs/reference/performance.md"]),
    ("gripcast eval", &MODEL_SOURCES),
    (
        "cargo test --test it crash",
        &["docs/reference/performance.md"],
    ),
];

/// Where the results of the built-in model stand in full.
const MODEL_SOURCES: [&str; 2] = [
    "docs/reference/training-results.md",
    "models/gripcast-vt.toml",
];

fn read(path: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(path);
    fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Returns the text from `from` up to `to`.
fn between<'a>(text: &'a str, from: &str, to: &str) -> &'a str {
    let start = text
        .find(from)
        .unwrap_or_else(|| panic!("README has no `{from}`"));
    let rest = &text[start..];
    &rest[..rest
        .find(to)
        .unwrap_or_else(|| panic!("README has no `{to}`"))]
}

/// Returns the stand-alone numbers as they are written; `1,209` is one.
fn numbers(text: &str) -> Vec<&str> {
    let is_inner = |c: char| c.is_alphanumeric() || ".,_".contains(c);
    text.split(|c| !is_inner(c))
        .map(|word| word.trim_end_matches(['.', ',']).trim_start_matches(','))
        .filter(|word| word.replace(',', "").parse::<f64>().is_ok())
        .collect()
}

/// Returns whether a source has a number of the README, perhaps with more digits.
fn is_stated(number: &str, source: &str) -> bool {
    let decimals = number
        .split_once('.')
        .map_or(0, |(_, decimals)| decimals.len());
    let value = |text: &str| text.replace(',', "").parse::<f64>().unwrap();
    let half = if decimals == 0 {
        0.0
    } else {
        0.5 * 0.1_f64.powi(decimals as i32)
    };
    let wanted = value(number);
    numbers(source)
        .into_iter()
        .any(|found| (value(found) - wanted).abs() <= half + 1e-9)
}

/// Returns the numbers of a text that no source has.
fn missing<'a>(text: &'a str, sources: &[&str]) -> Vec<&'a str> {
    let source: String = sources.iter().map(|path| read(path)).collect();
    let mut missing = numbers(text);
    missing.retain(|number| !is_stated(number, &source));
    missing
}

/// Returns a text without the targets of its links.
fn without_links(text: &str) -> String {
    let mut parts = text.split("](");
    let first = parts.next().unwrap_or_default().to_owned();
    parts.fold(first, |text, part| {
        text + part.split_once(')').map_or("", |(_, rest)| rest)
    })
}

#[test]
fn readme_measurements_match_the_docs() {
    let readme = read("README.md");
    let table = between(&readme, "## Measured", "All measurements");
    let mut command = String::new();
    let mut rows = 0;
    for line in table.lines().filter(|line| line.starts_with("| ")).skip(2) {
        let cells: Vec<&str> = line.trim_matches('|').split(" | ").map(str::trim).collect();
        let [_, _, figure, by] = cells[..] else {
            panic!("not four cells: {line}");
        };
        if by != "same" {
            command = by.to_owned();
        }
        let found = SOURCES.iter().find(|(name, _)| command.contains(name));
        let (_, sources) =
            found.unwrap_or_else(|| panic!("no source for the command of this row: {line}"));
        let figure = without_links(figure);
        let missing = missing(&figure, sources);
        assert!(
            missing.is_empty(),
            "{missing:?} of this row are not in {sources:?}: {line}"
        );
        rows += 1;
    }
    assert_eq!(rows, 5);
}

#[test]
fn readme_model_results_match_its_card() {
    let readme = read("README.md");
    let text = without_links(between(&readme, "## The built-in model", "## Measured"));
    let missing = missing(&text, &MODEL_SOURCES);
    assert!(
        missing.is_empty(),
        "{missing:?} are not in {MODEL_SOURCES:?}"
    );
}
