//! `gripcast doctor` on the virtual rig and over injected device trees.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

use crate::json_schema::assert_schema;
use crate::program::{gripcast, json, stderr};
use gripcast_testing::sysfs_tree::{Tree, mini};

/// Runs a command with the devices of a tree.
fn over(tree: &Tree, arguments: &[&str]) -> Output {
    gripcast()
        .args(arguments)
        .arg("--sysfs-root")
        .arg(tree.path("sys"))
        .arg("--dev-root")
        .arg(tree.path("dev"))
        .arg("--proc-root")
        .arg(tree.path("proc"))
        .output()
        .unwrap()
}

fn doctor(tree: &Tree, arguments: &[&str]) -> Output {
    let fixed = ["doctor", "--json", "--seconds", "0.5"];
    over(tree, &[&fixed, arguments].concat())
}

fn findings(output: &Output) -> Vec<Value> {
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    report["findings"].as_array().unwrap().clone()
}

fn of<'a>(findings: &'a [Value], area: &str, name: &str) -> &'a Value {
    findings
        .iter()
        .find(|f| f["area"] == area && f["name"] == name)
        .unwrap_or_else(|| panic!("no finding {area} {name} in {findings:#?}"))
}

#[test]
fn virtual_rig_passes_and_leaves_no_files() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = dir.path().join("d");
    let mut command = gripcast();
    command
        .args([
            "doctor",
            "--rig",
            "virtual-external",
            "--seconds",
            "1",
            "--json",
        ])
        .arg("--dataset")
        .arg(&dataset);
    let output = command.output().unwrap();
    let report = json(&output);
    let bare = serde_json::from_slice(&doctor(&Tree::new(), &[]).stdout).unwrap();
    assert_schema("doctor", &[&report, &bare]);
    assert_eq!(report["rig"], "virtual-external");
    let findings = report["findings"].as_array().unwrap().clone();
    for role in ["left", "right", "rgb", "depth", "external"] {
        let camera = of(&findings, "camera", role);
        // On a loaded machine images may be late; nothing else may fail.
        let is_late = camera["message"]
            .as_str()
            .unwrap()
            .contains(" frames/s, measured ");
        assert!(
            is_late || camera["measurements"]["fps"].as_f64().unwrap() > 0.0,
            "{camera}"
        );
    }
    let failed: Vec<_> = findings
        .iter()
        .filter(|f| f["status"] == "fail" && f["area"] != "camera")
        .collect();
    assert!(failed.is_empty(), "{failed:#?}");
    assert!(of(&findings, "model", "gripcast-vt")["measurements"]["p_stable"].is_number());
    for board in ["the gripper's tags", "the sheet"] {
        let seen = of(&findings, "board", board)["measurements"]["markers"].as_f64();
        assert!(seen.unwrap() >= 2.0, "{findings:#?}");
    }
    assert!(of(&findings, "disk", "writes")["measurements"]["durable_ms_median"].is_number());
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0);
}

#[test]
fn unusable_cameras_fail_with_a_remedy() {
    let mut tree = Tree::new();
    let first = tree.plug(
        mini("3-1", "GelSight Mini R0B 2BNN-4ZE7", "2BNN4ZE7"),
        &[(0, 2)],
    );
    tree.plug(
        mini("3-2", "GelSight Mini R0B 28F5-K4RR", "28F5K4RR"),
        &[(0, 2)],
    );
    tree.hold(77, "guvcview", first);
    let rig = tree.path("bench.toml");
    let made = over(&tree, &["rig", "init", "--out", rig.to_str().unwrap()]);
    assert!(rig.exists(), "{}", stderr(&made));

    let output = doctor(
        &tree,
        &[
            "--rig",
            rig.to_str().unwrap(),
            "--model",
            "baseline-contact",
        ],
    );
    assert_eq!(output.status.code(), Some(4), "{}", stderr(&output));
    let found = findings(&output);
    // The nodes are plain files: they are there, and are no cameras.
    for role in ["left", "right"] {
        let camera = of(&found, "camera", role);
        assert_eq!(camera["status"], "fail");
        assert!(camera["remedy"].is_string(), "{camera}");
    }
    assert_eq!(of(&found, "usb", "bandwidth")["status"], "warn");
    assert_eq!(of(&found, "disk", "all")["status"], "skipped");
    assert_ne!(of(&found, "model", "baseline-contact")["status"], "fail");
    assert!(stderr(&output).contains("collecting will not work: "));
}

#[test]
fn everything_else_is_checked_without_a_rig() {
    let output = doctor(&Tree::new(), &[]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let found = findings(&output);
    assert_eq!(of(&found, "camera", "all")["status"], "skipped");
    assert_eq!(
        of(&found, "usb", "cameras")["message"],
        "no camera is connected"
    );
    // `warn` where a loaded machine computes slower than frames come.
    assert_ne!(of(&found, "model", "gripcast-vt")["status"], "fail");
}

#[test]
fn invalid_arguments_and_paths_are_explained() {
    let tree = Tree::new();
    let output = doctor(&tree, &["--rig", "virtuell"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(
        stderr(&output).contains("did you mean `virtual`?"),
        "{}",
        stderr(&output)
    );

    // A file stands where the dataset should be.
    let file = tree.path("file");
    fs::write(&file, "").unwrap();
    let output = doctor(&tree, &["--dataset", file.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(4), "{}", stderr(&output));
    assert_eq!(of(&findings(&output), "disk", "dataset")["status"], "fail");

    let output = doctor(&tree, &["--model", "/proc/nonexistent.onnx"]);
    assert_eq!(output.status.code(), Some(4));
    let text = Command::new(env!("CARGO_BIN_EXE_gripcast"))
        .args(["doctor", "--model", "/proc/nonexistent.onnx"])
        .output()
        .unwrap();
    let text = String::from_utf8(text.stdout).unwrap();
    assert!(
        text.contains("FAIL  model    /proc/nonexistent.onnx"),
        "{text}"
    );
    assert!(!Path::new("/proc/nonexistent.onnx").exists());
}
