//! What `--json` prints, as a reviewed schema per command: the tests that run a command with
//! `--json` hold its output against `snapshots/json/COMMAND.snap`. Files that people read or write
//! have theirs in `snapshots/files/FILE.snap`.
//!
//! A line of a schema is `path: types`. `[]` is an item of an array, `{}` a value of an object
//! whose keys are data, `?` a key that not every object has. A schema knows the values that the
//! test saw: arrays that are empty, and arrays of texts, have no lines for their items.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{BufRead as _, BufReader, Read as _};
use std::path::Path;
use std::process::Stdio;

use clap::Command;
use gripcast::cli;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

use crate::dataset::{write_dataset, write_mixed_dataset};
use crate::program::{gripcast, json, succeed};

/// `replay demo` takes minutes and prints the report of `replay`.
const WITHOUT_SCHEMA: [&str; 1] = ["replay demo"];

/// Reports of a command that differ from its others.
const VARIANTS: [&str; 1] = ["dataset import video"];

/// Objects whose keys are data: objects, operators, models, scenes, roles, parts of a dataset. Those
/// of files begin with `file`.
const KEYED_BY_DATA: [&str; 25] = [
    "cameras",
    "file.calibration",
    "file.cameras",
    "file.cameras.{}.controls",
    "file.files",
    "file.grasp.cameras",
    "file.grasp.cameras.{}.controls",
    "file.grasp.fields",
    "file.grasp.fields.{}",
    "file.grasp.force",
    "file.grasp.shear",
    "file.initial.cameras",
    "file.initial.cameras.{}.controls",
    "file.initial.fields",
    "file.initial.fields.{}",
    "file.initial.force",
    "file.initial.shear",
    "file.lift.cameras",
    "file.splits",
    "findings[].figures",
    "objects",
    "operators",
    "parts",
    "predictions",
    "scenes",
];

/// All values seen at one place.
#[derive(Default)]
struct Place {
    types: BTreeSet<&'static str>,
    objects: usize,
    keys: BTreeMap<String, (usize, Place)>,
    items: Option<Box<Place>>,
}

impl Place {
    fn see(&mut self, value: &Value, path: &str) {
        self.types.insert(match value {
            Value::Null => "null",
            Value::Bool(_) => "boolean",
            Value::Number(n) if n.is_f64() => "number",
            Value::Number(_) => "integer",
            Value::String(_) => "string",
            Value::Array(_) => "array",
            Value::Object(_) => "object",
        });
        match value {
            Value::Array(items) => {
                let place = self.items.get_or_insert_default();
                let path = format!("{path}[]");
                items.iter().for_each(|item| place.see(item, &path));
            }
            Value::Object(map) => {
                self.objects += 1;
                for (key, value) in map {
                    let key = if KEYED_BY_DATA.contains(&path) {
                        "{}"
                    } else {
                        key
                    };
                    let (seen, place) = self.keys.entry(key.to_owned()).or_default();
                    *seen += 1;
                    place.see(value, &joined(path, key));
                }
            }
            _ => {}
        }
    }

    /// Warnings and the like come and go: texts in an array have no line of their own.
    fn is_told(&self) -> bool {
        !self.types.is_empty() && self.types != BTreeSet::from(["string"])
    }

    fn write(&self, path: &str, optional: bool, lines: &mut Vec<String>) {
        if !path.is_empty() {
            let mark = if optional { "?" } else { "" };
            let types: Vec<&str> = self.types.iter().copied().collect();
            lines.push(format!("{path}{mark}: {}", types.join(" | ")));
        }
        for (key, (seen, place)) in &self.keys {
            place.write(&joined(path, key), *seen < self.objects, lines);
        }
        if let Some(items) = self.items.as_ref().filter(|items| items.is_told()) {
            items.write(&format!("{path}[]"), false, lines);
        }
    }
}

fn joined(path: &str, key: &str) -> String {
    match path {
        "" => key.to_owned(),
        path => format!("{path}.{key}"),
    }
}

/// `root` is the path of the outputs in [`KEYED_BY_DATA`].
fn schema(root: &str, outputs: &[&Value]) -> String {
    let mut place = Place::default();
    outputs.iter().for_each(|output| place.see(output, root));
    let mut lines = Vec::new();
    place.write("", false, &mut lines);
    lines.join("\n")
}

/// Holds outputs of a command, `dataset verify`, against its reviewed schema.
pub(crate) fn assert_schema(command: &str, outputs: &[&Value]) {
    assert_reviewed("json", &command.replace(' ', "-"), schema("", outputs));
}

/// Holds the contents of files of a kind, `grasp.json`, against their reviewed schema.
fn assert_file_schema(kind: &str, contents: &[Value]) {
    let contents: Vec<&Value> = contents.iter().collect();
    assert_reviewed("files", kind, schema("file", &contents));
}

fn assert_reviewed(folder: &str, name: &str, found: String) {
    let mut settings = insta::Settings::clone_current();
    let snapshots = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/it/snapshots");
    settings.set_snapshot_path(snapshots.join(folder));
    settings.set_prepend_module_to_snapshot(false);
    settings.set_omit_expression(true);
    settings.bind(|| insta::assert_snapshot!(name, found));
}

/// Parses JSON, the lines of JSON Lines, or TOML.
fn read_values(path: &Path) -> Vec<Value> {
    let text = std::fs::read_to_string(path).unwrap();
    match path.extension().unwrap().to_str().unwrap() {
        "toml" => vec![toml::from_str(&text).unwrap()],
        "jsonl" => text
            .lines()
            .map(|line| serde_json::from_str(line).unwrap())
            .collect(),
        _ => vec![serde_json::from_str(&text).unwrap()],
    }
}

/// The reference of file formats is made from these.
#[test]
fn file_schemas() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = dir.path().join("d");
    write_mixed_dataset(&dataset);
    output("dataset split --seed 1 --json", &dataset);
    let below = |folder: &str, file: &str| -> Vec<Value> {
        let mut found: Vec<_> = std::fs::read_dir(dataset.join(folder))
            .unwrap()
            .map(|entry| entry.unwrap().path().join(file))
            .collect();
        found.sort();
        found.iter().flat_map(|path| read_values(path)).collect()
    };
    assert_file_schema("grasp.json", &below("grasps", "grasp.json"));
    assert_file_schema("dataset.toml", &read_values(&dataset.join("dataset.toml")));
    let index = read_values(&dataset.join("metadata.jsonl"));
    assert_file_schema("metadata.jsonl", &index);
    let splits = std::fs::read_dir(dataset.join("splits")).unwrap();
    let splits = splits.flat_map(|entry| read_values(&entry.unwrap().path()));
    assert_file_schema("split.json", &splits.collect::<Vec<_>>());
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    for (kind, folder) in [
        ("rig.toml", "calib/rigs"),
        ("board.toml", "calib/boards"),
        ("sensor-profile.toml", "calib/sensors"),
    ] {
        let mut files: Vec<_> = std::fs::read_dir(root.join(folder))
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .filter(|path| path.extension().is_some_and(|e| e == "toml"))
            .collect();
        files.sort();
        let contents: Vec<Value> = files.iter().flat_map(|path| read_values(path)).collect();
        assert_file_schema(kind, &contents);
    }
    assert_file_schema(
        "model.toml",
        &read_values(&root.join("models/gripcast-vt.toml")),
    );
}

/// Commands below `command` that have `--json`, with their path.
fn with_json(command: &Command, path: &str, found: &mut BTreeSet<String>) {
    if command
        .get_arguments()
        .any(|arg| arg.get_long() == Some("json"))
    {
        found.insert(path.to_owned());
    }
    for below in command.get_subcommands() {
        with_json(
            below,
            format!("{path} {}", below.get_name()).trim_start(),
            found,
        );
    }
}

#[test]
fn every_json_command_has_schema_snapshot() {
    let mut commands = BTreeSet::new();
    with_json(&cli::command(), "", &mut commands);
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/it/snapshots/json");
    let reviewed: BTreeSet<String> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .filter_map(|name| Some(name.strip_suffix(".snap")?.replace('-', " ")))
        .collect();
    commands.retain(|command| !WITHOUT_SCHEMA.contains(&command.as_str()));
    commands.extend(VARIANTS.map(str::to_owned));
    assert_eq!(commands, reviewed);
}

#[test]
fn schema_shows_optional_keys_items_and_types() {
    let first = serde_json::json!({"a": [{"b": 1}, {"b": 1.5, "c": null}], "d": []});
    let second = serde_json::json!({"a": [], "d": ["x"], "g": [1], "e": {"f": true}});
    let expected = "a: array\na[]: object\na[].b: integer | number\na[].c?: null\n\
                    d: array\ne?: object\ne.f: boolean\ng?: array\ng[]: integer";
    assert_eq!(schema("", &[&first, &second]), expected);
}

/// What a command prints; the exit code may tell that it found something.
fn output(words: &str, path: &Path) -> Value {
    let mut command = gripcast();
    json(
        &command
            .args(words.split_whitespace())
            .arg(path)
            .output()
            .unwrap(),
    )
}

#[test]
fn dataset_schemas() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = dir.path().join("d");
    let ids = write_dataset(&dataset, &["mug", "bottle", "mug", "sponge"]);
    assert_schema("dataset info", &[&output("dataset info --json", &dataset)]);
    let split = output("dataset split --seed 1 --json", &dataset);
    assert_schema("dataset split", &[&split]);
    let clean = output("dataset verify --json", &dataset);
    std::fs::remove_file(dataset.join(format!("grasps/{}/grasp.rgb.png", ids[0]))).unwrap();
    let damaged = output("dataset verify --json", &dataset);
    assert_schema("dataset verify", &[&clean, &damaged]);
    let recovered = output("dataset recover --json", &dataset);
    assert_schema("dataset recover", &[&recovered]);
    let migrated = output("dataset migrate --json", &dataset);
    assert_schema("dataset migrate", &[&migrated]);
    let reindexed = output("dataset reindex --json", &dataset);
    assert_schema("dataset reindex", &[&reindexed]);

    let files = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/import/deepdish.h5");
    let mut import = gripcast();
    import.args([
        "dataset",
        "import",
        "--from",
        "feeling-of-success",
        "--json",
    ]);
    let imported = json(&succeed(
        import.arg(files).arg("--out").arg(dir.path().join("i")),
    ));
    assert_schema("dataset import", &[&imported]);
}

#[test]
fn board_schemas() {
    let dir = tempfile::tempdir().unwrap();
    for (command, flags) in [
        ("board charuco", "--squares 8x6 --square-mm 28"),
        ("board gripper", "--dpi 100"),
    ] {
        let made = output(
            &format!("{command} {flags} --json --out"),
            &dir.path().join("b.svg"),
        );
        assert_schema(command, &[&made]);
    }
}

#[test]
fn config_schema() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("gripcast.toml");
    std::fs::write(&file, "[daemon]\nlisten = \"none\"\n").unwrap();
    let mut found = gripcast();
    found
        .args(["config", "show", "--json"])
        .current_dir(dir.path());
    let chosen = output("config show --json --config", &file);
    assert_schema("config show", &[&json(&succeed(&mut found)), &chosen]);
}

#[test]
fn live_bench_schemas() {
    for (command, flags) in [
        ("bench live", "--seconds 1 --model baseline-contact"),
        ("bench daemon", "--seconds 1 --grasps 1 --viewers 1"),
    ] {
        let mut bench = gripcast();
        bench
            .args(command.split(' '))
            .args(flags.split(' '))
            .arg("--json");
        assert_schema(command, &[&json(&succeed(&mut bench))]);
    }
}

#[test]
fn closing_report_schema() {
    let dir = tempfile::tempdir().unwrap();
    let mut child = gripcast()
        .args(["daemon", "--json", "--rig", "virtual", "--dataset", "d"])
        .args(["--listen", "127.0.0.1:0"])
        .env("XDG_RUNTIME_DIR", dir.path())
        .current_dir(dir.path())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let said = BufReader::new(child.stderr.take().unwrap()).lines();
    let mut said = said.map(Result::unwrap);
    assert!(said.any(|line| line.starts_with("page and API: ")));
    kill_process(Pid::from_child(&child), Signal::TERM).unwrap();
    let mut report = String::new();
    child
        .stdout
        .take()
        .unwrap()
        .read_to_string(&mut report)
        .unwrap();
    child.wait().unwrap();
    assert_schema("daemon", &[&serde_json::from_str(&report).unwrap()]);
}
