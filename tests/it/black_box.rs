//! The black box of a collection on the virtual rig, held against the dataset beside it.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use mcap::MessageStream;
use prost::Message as _;
use serde_json::Value;
use sha2::{Digest as _, Sha256};

use crate::program::{collect, grasps, json, script, stderr, succeed, verify};

/// Data of a `foxglove.CompressedImage`.
#[derive(Clone, PartialEq, prost::Message)]
struct Compressed {
    #[prost(bytes = "vec", tag = "2")]
    data: Vec<u8>,
}

/// Contents of a log: frames by role and JSON messages by topic.
#[derive(Default)]
struct Log {
    frames: BTreeMap<String, Vec<Logged>>,
    messages: BTreeMap<String, Vec<Value>>,
}

struct Logged {
    sequence: u32,
    driver_time_ns: i128,
    data: Vec<u8>,
}

fn files(directory: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(directory).unwrap();
    let mut files: Vec<_> = entries.map(|entry| entry.unwrap().path()).collect();
    files.sort();
    files
}

fn read(directory: &Path) -> Log {
    let mut log = Log::default();
    for path in files(directory) {
        let file = std::fs::read(&path).unwrap();
        let summary = mcap::Summary::read(&file).unwrap().unwrap();
        let origin = mcap::read::metadata(&file, &summary.metadata_indexes[0]).unwrap();
        assert_eq!(origin.metadata["rig"], "virtual");
        let offset_ns: i128 = origin.metadata["wall_minus_monotonic_ns"].parse().unwrap();
        for message in MessageStream::new(&file).unwrap() {
            let message = message.unwrap();
            let topic = &message.channel.topic;
            if let Some(role) = topic.strip_prefix("/camera/") {
                log.frames.entry(role.into()).or_default().push(Logged {
                    sequence: message.sequence,
                    driver_time_ns: i128::from(message.publish_time) - offset_ns,
                    data: message.data.into_owned(),
                });
            } else {
                let note = serde_json::from_slice(&message.data).unwrap();
                log.messages.entry(topic.clone()).or_default().push(note);
            }
        }
    }
    log
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[test]
fn black_box_has_every_frame_including_the_saved_ones() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = dir.path().join("d");
    let three = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/three-grasps.txt");
    let mut command = collect(&three, &dataset);
    // The free space of the test machine must not matter.
    command
        .arg("--black-box")
        .env("GRIPCAST__BLACK_BOX__RESERVE_GB", "0")
        .env("GRIPCAST__BLACK_BOX__FILE_MIB", "8");
    let report = json(&succeed(&mut command));
    let black_box = &report["black_box"];
    assert_eq!(black_box["stopped"], Value::Null, "{black_box}");
    let log = read(&dataset.join("blackbox"));
    assert_eq!(black_box["files"], files(&dataset.join("blackbox")).len());

    for (role, frames) in &log.frames {
        let counts = &black_box["frames"][role];
        let dropped = counts["dropped"].as_u64().unwrap();
        assert_eq!(counts["written"], frames.len(), "{role}");
        let lost = &report["cameras"][role]["sequence_gaps"];
        let first = frames.iter().map(|frame| frame.sequence).min().unwrap();
        let last = frames.iter().map(|frame| frame.sequence).max().unwrap();
        let missing = u64::from(last - first + 1) - frames.len() as u64;
        // Every delivered frame is logged or counted as dropped.
        assert!(
            missing <= dropped + lost.as_u64().unwrap(),
            "{role}: {missing} of {first} to {last} are missing, {dropped} dropped, {lost} lost"
        );
    }

    let records = grasps(&dataset);
    assert_eq!(records.len(), 3);
    for (id, record) in &records {
        for (stage, role) in [("initial", "left"), ("initial", "right"), ("grasp", "left")] {
            let camera = &record[stage]["cameras"][role];
            let found = log.frames[role].iter().find(|frame| {
                camera["sequence"] == frame.sequence
                    && camera["driver_time_ns"].as_u64().map(i128::from)
                        == Some(frame.driver_time_ns)
            });
            let dropped = black_box["frames"][role]["dropped"].as_u64().unwrap();
            let Some(found) = found else {
                // Frames may be dropped on a slow disk.
                assert!(dropped > 0, "{id} {stage} {role} is not in the log");
                continue;
            };
            let image = Compressed::decode(&*found.data).unwrap();
            let digest = hex(&Sha256::digest(&image.data));
            let file = camera["file"].as_str().unwrap();
            assert_eq!(record["files"][file]["sha256"], digest, "{id} {file}");
        }
    }

    let stored = &log.messages["/session/stored"];
    let requests = |key: &str| {
        stored
            .iter()
            .filter(|s| s["request"].get(key).is_some())
            .count()
    };
    assert_eq!((requests("save_initial"), requests("save_grasp")), (3, 3));
    let events = &log.messages["/session/events"];
    let ends = events.iter().filter(|event| event["event"] == "end");
    assert_eq!(ends.count(), 1);
    assert!(!log.messages["/prediction"].is_empty());
    assert_eq!(
        log.messages["/cameras"][0]["left"]["report"]["reconnects"],
        0
    );
    let verified = verify(&dataset);
    assert_eq!(
        verified["problems"].as_array().unwrap().len(),
        0,
        "{verified}"
    );
}

#[test]
fn black_box_write_error_loses_no_grasp() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = dir.path().join("d");
    let occupied = dir.path().join("occupied");
    std::fs::write(&occupied, "a file").unwrap();
    let steps =
        "wait live\ninitial\nwait saved\nwait contact\nwait fresh\ngrasp\nwait saved\nquit\n";
    let mut command = collect(&script(dir.path(), steps), &dataset);
    command
        .arg("--black-box")
        .env("GRIPCAST__BLACK_BOX__DIRECTORY", &occupied);
    let output = succeed(&mut command);
    let report = json(&output);
    assert_eq!(report["session"]["saved"], 1);
    let stopped = report["black_box"]["stopped"].as_str().unwrap();
    assert!(stopped.contains("occupied"), "{stopped}");
    let said = stderr(&output);
    assert_eq!(
        said.matches("the black box has stopped").count(),
        1,
        "{said}"
    );
}

#[test]
fn contradictory_limits_are_rejected_at_start() {
    let dir = tempfile::tempdir().unwrap();
    let mut command = collect(&script(dir.path(), "quit\n"), &dir.path().join("d"));
    command
        .arg("--black-box")
        .env("GRIPCAST__BLACK_BOX__TOTAL_GIB", "0.1");
    let output = command.output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("black_box.total_gib"));
    assert!(!dir.path().join("d").exists());
}
