//! Sequences of a collection on the virtual rig: `dataset export --to lerobot --sequences`.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;

use crate::peers::{agrees, peer};
use crate::program::{collect_on, gripcast, json, stderr, succeed};

/// Collects two grasps with a black box; returns the dataset, and whether the log has all frames.
fn collected(dir: &Path) -> (PathBuf, bool) {
    let dataset = dir.join("d");
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/sequences.txt");
    let mut command = collect_on(Path::new("virtual-markers"), &script, &dataset);
    // The free space of the test machine must not matter.
    command
        .arg("--black-box")
        .env("GRIPCAST__BLACK_BOX__RESERVE_GB", "0");
    let report = json(&succeed(&mut command));
    let black_box = &report["black_box"];
    assert_eq!(black_box["stopped"], Value::Null);
    let cameras = black_box["frames"].as_object().unwrap();
    let is_whole = cameras.values().all(|counts| counts["dropped"] == 0);
    (dataset, is_whole)
}

fn export(dataset: &Path, out: &Path, arguments: &[&str]) -> Output {
    let mut command: Command = gripcast();
    command.args(["dataset", "export", "--to", "lerobot", "--sequences"]);
    command.args(["--json", "--out"]).arg(out);
    command.args(arguments).arg(dataset).output().unwrap()
}

fn info(out: &Path) -> Value {
    serde_json::from_slice(&fs::read(out.join("meta/info.json")).unwrap()).unwrap()
}

#[test]
fn sequences_of_a_collection_have_the_frames_of_its_black_box() {
    let dir = tempfile::tempdir().unwrap();
    let (dataset, is_whole) = collected(dir.path());
    let out = dir.path().join("out");
    let output = export(&dataset, &out, &[]);
    // On a loaded machine the log lacks frames, or cameras were too slow; then grasps are named.
    let is_incomplete = |reason: &str| match is_whole {
        true => reason.contains("in the 500 ms up to"),
        false => reason.contains("the black box "),
    };
    if output.status.code() == Some(1) && is_incomplete(&stderr(&output)) {
        println!("SKIPPED: the machine is too slow: {}", stderr(&output));
        return;
    }
    let report = json(&output);
    let left_out = report["left_out"].as_array().unwrap();
    for one in left_out {
        let reason = one["reason"].as_str().unwrap();
        assert!(is_incomplete(reason), "{reason}");
    }
    let status = if left_out.is_empty() { 0 } else { 3 };
    assert_eq!(output.status.code(), Some(status), "{}", stderr(&output));
    let info = info(&out);
    let fps = info["fps"].as_u64().unwrap();
    assert!((1..=60).contains(&fps), "{fps}");
    // Each lift has 1.5 s until its label.
    let frames = info["total_frames"].as_u64().unwrap();
    let grasps = report["grasps"].as_u64().unwrap();
    assert!(
        frames > grasps * fps * 3 / 2,
        "{frames} at {fps} per second"
    );
    let notes = report["notes"].as_array().unwrap();
    let is_rate = |note: &Value| note.as_str().unwrap().contains("frames per second, as ");
    assert_eq!(
        notes.iter().filter(|note| is_rate(note)).count(),
        1,
        "{notes:?}"
    );

    if let Some(mut check) = peer("load_sequences.py") {
        check.arg(&dataset).arg(&out);
        check.arg("--left-out");
        check.args(left_out.iter().map(|one| one["id"].as_str().unwrap()));
        let cache = dir.path().join("cache");
        println!("{}", agrees(check.env("HF_HOME", cache)));
    }

    cut_and_missing_logs(dir.path(), &dataset, &report);
}

/// The log of a killed program has the frames up to the kill; without one there is an error.
fn cut_and_missing_logs(dir: &Path, dataset: &Path, report: &Value) {
    let cut = dir.join("cut");
    fs::create_dir(&cut).unwrap();
    let files: Vec<_> = fs::read_dir(dataset.join("blackbox")).unwrap().collect();
    let [Ok(file)] = &files[..] else {
        panic!("{files:?}");
    };
    let bytes = fs::read(file.path()).unwrap();
    let name = file.file_name().into_string().unwrap();
    let name = name.replace(".mcap", ".partial.mcap");
    fs::write(cut.join(&name), &bytes[..bytes.len() / 3]).unwrap();
    let arguments = ["--black-box", cut.to_str().unwrap(), "--lift", "0.5"];
    let output = export(dataset, &dir.join("of-cut"), &arguments);
    match output.status.code() {
        Some(3) => {
            let of_cut = json(&output);
            assert!(of_cut["grasps"].as_u64() < report["grasps"].as_u64().map(|n| n + 1));
            assert!(!of_cut["left_out"].as_array().unwrap().is_empty());
            assert!(of_cut["notes"].to_string().contains(&name), "{of_cut}");
        }
        // The first third of a slow collection ends before the first grasp.
        Some(1) => assert!(
            stderr(&output).contains("the black box"),
            "{}",
            stderr(&output)
        ),
        other => panic!("{other:?}: {}", stderr(&output)),
    }

    fs::write(cut.join(&name), "a text").unwrap();
    fs::write(cut.join("other.mcap"), "not a log of a collection").unwrap();
    let output = export(dataset, &dir.join("of-text"), &arguments);
    assert_eq!(output.status.code(), Some(1));
    assert!(
        stderr(&output).contains("other.mcap: expected an MCAP file"),
        "{}",
        stderr(&output)
    );
    assert!(!dir.join("of-text").exists());

    let arguments = ["--black-box", "/nowhere/at-all"];
    let output = export(dataset, &dir.join("of-none"), &arguments);
    assert_eq!(output.status.code(), Some(1));
    let said = stderr(&output);
    assert!(
        said.contains("/nowhere/at-all") && said.contains("collect with"),
        "{said}"
    );
}

#[test]
fn flags_of_sequences_need_sequences() {
    for arguments in [
        &["--to", "lerobot", "--fps", "20"][..],
        &["--to", "lerobot", "--sequences", "--fps", "0"],
        &["--to", "lerobot", "--sequences", "--lift", "-1"],
    ] {
        let mut command = gripcast();
        let output = command
            .args(["dataset", "export", "d", "--out", "out"])
            .args(arguments)
            .output()
            .unwrap();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
    }
}
