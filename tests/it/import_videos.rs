//! `gripcast dataset import --from video`: pairs of videos become grasps. The videos are streams of
//! PPM images, and a stand-in for ffmpeg passes them on.

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use gripcast_dataset::{Dataset, Outcome, Stage, verify};
use gripcast_imaging::{Role, synthetic_gel};
use serde_json::Value;

use crate::json_schema::assert_schema;
use crate::program::{gripcast, stderr};

/// Strength of the contact in each frame: an old touch, open, pressed from `contact` on.
fn strengths(contact: usize, frames: usize) -> Vec<f32> {
    let strength = |at: usize| match at {
        0..5 => 0.6,
        at if at < contact => 0.0,
        at => (0.3 * (at - contact + 1) as f32).min(0.8),
    };
    (0..frames).map(strength).collect()
}

fn write_video(path: &Path, seed: u64, strengths: &[f32]) {
    let mut stream = Vec::new();
    for strength in strengths {
        stream.extend(b"P6\n320 240\n255\n");
        stream.extend(synthetic_gel(320, 240, seed, *strength).as_raw());
    }
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, stream).unwrap();
}

/// Two clips: `a` from open, `b` in contact until its last frames.
fn clips(dir: &Path) -> PathBuf {
    write_video(&dir.join("clips/a/0.avi"), 1, &strengths(16, 30));
    write_video(&dir.join("clips/a/1.avi"), 2, &strengths(18, 30));
    let mut begins_closed = vec![0.7; 20];
    begins_closed.extend([0.4, 0.0, 0.0]);
    write_video(&dir.join("clips/b/0.avi"), 3, &begins_closed);
    write_video(&dir.join("clips/b/1.avi"), 4, &begins_closed);
    let table = dir.join("clips.csv");
    let rows = "id,left,right,object,outcome,begins\n\
                a,clips/a/0.avi,clips/a/1.avi,mug,slip,\n\
                b,clips/b/0.avi,clips/b/1.avi,cup,stable,contact\n";
    fs::write(&table, rows).unwrap();
    table
}

fn import_command(dir: &Path, source: &Path, more: &[&str]) -> Command {
    let programs = dir.join("programs");
    fs::create_dir_all(&programs).unwrap();
    let program = programs.join("ffmpeg");
    fs::write(&program, "#!/bin/sh\nexec /bin/cat\n").unwrap();
    fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
    let mut command = gripcast();
    command.env("PATH", &programs);
    command.args(["dataset", "import", "--from", "video", "--json"]);
    command
        .arg(source)
        .arg("--out")
        .arg(dir.join("D"))
        .args(more);
    command
}

fn import(dir: &Path, source: &Path, more: &[&str]) -> Output {
    import_command(dir, source, more).output().unwrap()
}

fn json(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout).unwrap_or_else(|_| panic!("{}", stderr(output)))
}

#[test]
fn clips_become_grasps_with_the_frames_before_and_after_contact() {
    let dir = tempfile::tempdir().unwrap();
    let table = clips(dir.path());
    let output = import(dir.path(), &table, &["--licence", "BSD-2-Clause"]);
    // The clip that begins in contact is left out, with the reason.
    assert_eq!(output.status.code(), Some(3), "{}", stderr(&output));
    let report = json(&output);
    assert_schema("dataset import video", &[&report]);
    let reason = report["left_out"][0]["reason"].as_str().unwrap();
    assert!(
        reason.contains("begins in contact") && reason.contains("--initial-at-end"),
        "{reason}"
    );
    let one = &report["imported"][0];
    assert_eq!(one["contact_frames"], serde_json::json!([16, 18]));
    assert_eq!(
        (&one["initial_frame"], &one["grasp_frame"]),
        (&14.into(), &21.into())
    );

    let dataset = Dataset::open(dir.path().join("D")).unwrap();
    assert_eq!(dataset.descriptor().licence, "BSD-2-Clause");
    let grasps: Vec<_> = dataset.grasps().unwrap().map(Result::unwrap).collect();
    assert_eq!(grasps.len(), 1);
    let grasp = &grasps[0];
    assert_eq!(
        (grasp.object.as_str(), grasp.outcome),
        ("mug", Outcome::Slip)
    );
    assert_eq!(
        grasp.note,
        "clip a: initial frame 14, contact in frames 16 and 18, grasp frame 21"
    );
    for (stage, number) in [(Stage::Initial, 14), (Stage::Grasp, 21)] {
        for (role, seed, contact) in [(Role::Left, 1, 16), (Role::Right, 2, 18)] {
            let frame = dataset.load_frame(grasp, stage, role).unwrap();
            let expected = synthetic_gel(320, 240, seed, strengths(contact, 30)[number]);
            assert_eq!(&frame.data[..], expected.as_raw().as_slice(), "{role}");
        }
    }
    let verified = verify(dir.path().join("D"), &|_, _| {}).unwrap();
    assert_eq!(verified.problems, []);

    // The same call continues: nothing twice. The rest comes in with its initial frame at the end.
    let again = json(&import(dir.path(), &table, &["--initial-at-end"]));
    assert_eq!(
        (&again["already_there"], &again["left_out"]),
        (&1.into(), &serde_json::json!([]))
    );
    let one = &again["imported"][0];
    assert_eq!(
        (&one["clip"], &one["initial_frame"]),
        (&"b".into(), &22.into())
    );
    assert_eq!(dataset.ids().unwrap().len(), 2);
}

#[test]
fn frames_may_be_given_and_a_folder_needs_no_table() {
    let dir = tempfile::tempdir().unwrap();
    clips(dir.path());
    let folder = dir.path().join("clips");
    let more = [
        "--initial-frame",
        "8",
        "--grasp-frame",
        "19",
        "--object",
        "mug",
    ];
    let output = import(dir.path(), &folder, &more);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let report = json(&output);
    assert_eq!(report["outcomes"], serde_json::json!([0, 0, 2]));
    assert_eq!(report["imported"][1]["grasp_frame"], 19);
    let beyond = import(
        dir.path(),
        &folder,
        &["--initial-frame", "8", "--grasp-frame", "90"],
    );
    assert_eq!(json(&beyond)["already_there"], 2);
}

#[test]
fn unusable_clips_are_explained() {
    let dir = tempfile::tempdir().unwrap();
    let table = dir.path().join("clips.csv");
    let long = strengths(16, 30);
    let cases: [(&str, &[f32], &[f32], &str); 4] = [
        (
            "lengths",
            &long,
            &long[..28],
            "left video has 30 frames, the right one 28",
        ),
        (
            "one",
            &long,
            &[0.0; 30],
            "the right gel does not come into contact",
        ),
        (
            "short",
            &long[..19],
            &long[..19],
            "the clip has only 19 frames",
        ),
        (
            "nothing",
            &[0.0; 30],
            &[0.0; 30],
            "no gel comes into contact",
        ),
    ];
    for (name, left, right, expected) in cases {
        write_video(&dir.path().join(format!("{name}/l.avi")), 1, left);
        write_video(&dir.path().join(format!("{name}/r.avi")), 2, right);
        fs::write(&table, format!("left,right\n{name}/l.avi,{name}/r.avi\n")).unwrap();
        let output = import(dir.path(), &table, &[]);
        assert_eq!(output.status.code(), Some(1), "{name}");
        assert!(
            stderr(&output).contains(expected),
            "{name}: {}",
            stderr(&output)
        );
        assert!(!dir.path().join("D").exists(), "{name}");
    }
    // A codec that ffmpeg cannot read, and no ffmpeg.
    fs::write(dir.path().join("one/l.avi"), b"").unwrap();
    fs::write(&table, "left,right\none/l.avi,one/r.avi\n").unwrap();
    let output = import(dir.path(), &table, &[]);
    assert!(
        stderr(&output).contains("no frame that ffmpeg can decode"),
        "{}",
        stderr(&output)
    );
    let output = import_command(dir.path(), &table, &[])
        .env("PATH", "/nonexistent")
        .output()
        .unwrap();
    assert!(
        stderr(&output).contains("apt install ffmpeg"),
        "{}",
        stderr(&output)
    );
    // A path that leads out of the table's folder.
    fs::write(&table, "left,right\n../l.avi,one/r.avi\n").unwrap();
    let output = import(dir.path(), &table, &[]);
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    // Splits are of shards.
    let other = import(dir.path(), &table, &["--split", "test=1"]);
    assert_eq!(other.status.code(), Some(2), "{}", stderr(&other));
}

/// The recorded clips, through the system's ffmpeg.
#[test]
fn recorded_clips_are_imported() {
    let Some(data) = gripcast_testing::shared("data/slip_gsmini") else {
        return;
    };
    let has_ffmpeg = std::env::split_paths(&std::env::var_os("PATH").unwrap_or_default())
        .any(|folder| folder.join("ffmpeg").is_file());
    if !has_ffmpeg {
        gripcast_testing::skip(gripcast_testing::Needs::Ffmpeg, "no ffmpeg in PATH");
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let list = fs::read(data.join("grasps.json")).unwrap();
    let mut rows: Vec<Value> = serde_json::from_slice(&list).unwrap();
    rows.retain(|row| ["002", "066", "012"].contains(&row["id"].as_str().unwrap()));
    for row in &rows {
        let id = row["id"].as_str().unwrap();
        let folder = dir.path().join("grasps").join(id);
        fs::create_dir_all(&folder).unwrap();
        for name in ["camera_0.avi", "camera_2.avi"] {
            fs::copy(data.join("grasps").join(id).join(name), folder.join(name)).unwrap();
        }
    }
    let table = dir.path().join("grasps.json");
    fs::write(&table, serde_json::to_vec(&rows).unwrap()).unwrap();
    let mut command = gripcast();
    command
        .args(["dataset", "import", "--from", "video", "--json"])
        .arg(&table);
    command.args([
        "--left",
        "grasps/{id}/camera_0.avi",
        "--right",
        "grasps/{id}/camera_2.avi",
    ]);
    let output = command
        .arg("--out")
        .arg(dir.path().join("D"))
        .output()
        .unwrap();
    let report = json(&output);
    assert_eq!(report["left_out"][0]["id"], "012", "{report}");
    for one in report["imported"].as_array().unwrap() {
        let contact = one["contact_frames"].as_array().unwrap();
        let both = contact
            .iter()
            .map(|frame| frame.as_u64().unwrap())
            .max()
            .unwrap();
        // As its source states it.
        assert!((13..=38).contains(&both), "{one}");
    }
    assert_eq!(report["imported"].as_array().unwrap().len(), 2);
}
