//! The verb `dataset`, and datasets read by other programs.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use gripcast_dataset::{
    CapturedCamera, DatasetWriter, FieldArray, GraspId, GraspMeta, NewDataset, Outcome,
    PredictionRecord, StageCapture,
};
use gripcast_imaging::{Frame, PixelFormat, Role};
use serde_json::Value;

use crate::peers::{agrees, peer};

const WIDTH: u32 = 32;
const HEIGHT: u32 = 24;

fn new_dataset() -> NewDataset {
    NewDataset {
        name: "kitchen".into(),
        rig: "bench-1".into(),
        licence: "CC-BY-4.0".into(),
        label_definition: "stable = still held 3 s after the lift".into(),
    }
}

fn jpeg(number: u32, role: Role) -> Vec<u8> {
    let pixels: Vec<u8> = (0..WIDTH * HEIGHT * 3)
        .map(|i| (i * (number + 1) + role as u32 * 50) as u8)
        .collect();
    let image = turbojpeg::Image {
        pixels: pixels.as_slice(),
        width: WIDTH as usize,
        pitch: WIDTH as usize * 3,
        height: HEIGHT as usize,
        format: turbojpeg::PixelFormat::RGB,
    };
    turbojpeg::compress(image, 90, turbojpeg::Subsamp::Sub2x1)
        .unwrap()
        .to_vec()
}

fn camera(number: u32, role: Role) -> CapturedCamera {
    let raw = |salt: u32| -> Vec<u8> {
        (0..WIDTH * HEIGHT * 2)
            .map(|i| (i * salt + number * 7) as u8)
            .collect()
    };
    let (format, data) = match role {
        Role::Left | Role::Right => (PixelFormat::Mjpg, jpeg(number, role)),
        Role::Rgb | Role::External => (PixelFormat::Yuyv, raw(3)),
        Role::Depth => (PixelFormat::Z16, raw(5)),
    };
    CapturedCamera {
        frame: Frame {
            format,
            width: WIDTH,
            height: HEIGHT,
            data: data.into(),
            sequence: number,
            driver_time_ns: 1_000_000_000 + u64::from(number),
            received_ns: 0,
        },
        product: "GelSight Mini".into(),
        serial: format!("S-{role}"),
        interface: 0,
        port: "3-2".into(),
        controls: BTreeMap::new(),
        age_ms: 12.5,
        crop_profile: role.is_tactile().then(|| "gsmini-seventh-v1".into()),
        depth_unit_m: (role == Role::Depth).then_some(0.001),
    }
}

fn capture(number: u32, roles: &[Role]) -> StageCapture {
    StageCapture {
        captured_at: format!("2026-11-20T10:15:{number:02}Z").parse().unwrap(),
        trigger_time_ns: 1_000_000_100,
        trigger: "script".into(),
        truth: None,
        pre_grasp_frames: Vec::new(),
        fields: Vec::new(),
        shear: BTreeMap::new(),
        force: BTreeMap::new(),
        pose: None,
        cameras: roles
            .iter()
            .map(|&role| (role, camera(number, role)))
            .collect(),
    }
}

fn prediction() -> PredictionRecord {
    PredictionRecord {
        p_stable: 0.75,
        ood_score: None,
        unsure_reason: None,
        adapted: None,
        set: None,
        threshold: 0.5,
        inputs: None,
        geometry: None,
        model_sha256: "ab".repeat(32),
        model: "baseline-contact".into(),
        latency_ms: 31.0,
        engine_ms: 4.0,
    }
}

/// One grasp per object, alternately stable and slip; the last one is unlabelled and lacks depth.
pub(super) fn write_dataset(root: &Path, objects: &[&str]) -> Vec<GraspId> {
    let (mut writer, _) = DatasetWriter::open_or_create(root, &new_dataset()).unwrap();
    let mut ids = Vec::new();
    for (index, object) in objects.iter().enumerate() {
        let number = 2 * index as u32;
        let is_last = index + 1 == objects.len();
        let all = [Role::Left, Role::Right, Role::Rgb, Role::Depth];
        let roles = if is_last { &all[..3] } else { &all[..] };
        let pending = writer
            .save_initial(&capture(number, roles), Vec::new())
            .unwrap();
        let meta = GraspMeta {
            object: object.parse().unwrap(),
            scene: "table".parse().unwrap(),
            operator: "Ada".parse().unwrap(),
            rig: "bench-1".into(),
            prediction: (index > 0).then(prediction),
            ..GraspMeta::default()
        };
        let id = writer
            .save_grasp(&pending, &capture(number + 1, roles), meta)
            .unwrap()
            .id;
        if !is_last {
            let outcome = [Outcome::Stable, Outcome::Slip][index % 2];
            let at = "2026-11-20T11:00:00Z".parse().unwrap();
            writer.set_outcome(&id, outcome, at, None).unwrap();
        }
        ids.push(id);
    }
    ids
}

/// Objects 001 to 010, the first six without label, prediction, colour, depth and markers, the last two
/// with lift frames: readers that infer types from the first grasps or the digits get them wrong.
pub(super) fn write_mixed_dataset(root: &Path) {
    let (mut writer, _) = DatasetWriter::open_or_create(root, &new_dataset()).unwrap();
    for index in 0..10 {
        let is_bare = index < 6;
        let all = [Role::Left, Role::Right, Role::Rgb, Role::Depth];
        let roles = if is_bare { &all[..2] } else { &all[..] };
        let mut initial = capture(2 * index, roles);
        let mut closed = capture(2 * index + 1, roles);
        if !is_bare {
            initial.fields.push(markers(index));
            closed.fields.push(markers(index + 10));
        }
        let pending = writer.save_initial(&initial, Vec::new()).unwrap();
        let meta = GraspMeta {
            object: format!("{:03}", index + 1).parse().unwrap(),
            prediction: (!is_bare).then(prediction),
            ..GraspMeta::default()
        };
        let id = writer.save_grasp(&pending, &closed, meta).unwrap().id;
        if !is_bare {
            let at = "2026-11-20T11:00:00Z".parse().unwrap();
            writer.set_outcome(&id, Outcome::Stable, at, None).unwrap();
        }
        if index >= 8 {
            let frame = |at: u32, role| camera(100 + 4 * index + at, role).frame;
            let frames = [Role::Left, Role::Right].map(|role| {
                let of_role = (0..3).map(|at| frame(at, role)).collect();
                (role, of_role)
            });
            writer.append_lift(&id, &frames.into(), 2.0).unwrap();
        }
    }
}

/// Markers of the left gel; one of them lost.
fn markers(number: u32) -> FieldArray {
    let mut values: Vec<f32> = (0..3 * 4 * 5).map(|i| (i + number) as f32 / 8.0).collect();
    values[10..15].fill(f32::NAN);
    FieldArray::markers(Role::Left, values, [3, 4, 5], 2.9e-5).unwrap()
}

pub(super) fn gripcast(args: &[&str], dataset: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_gripcast"))
        .arg("dataset")
        .args(&args[..1])
        .arg(dataset)
        .args(&args[1..])
        .output()
        .unwrap()
}

pub(super) fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

pub(super) fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

pub(super) fn json(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout)
        .unwrap_or_else(|e| panic!("{e}: {}{}", stdout(output), stderr(output)))
}

/// Replaces the process id in grasp ids; the time in them is fixed.
fn redacted(text: &str, ids: &[GraspId]) -> String {
    ids.iter().fold(text.to_owned(), |text, id| {
        let (time, _) = id.rsplit_once('-').unwrap();
        text.replace(id.as_str(), &format!("{time}-XXXX"))
    })
}

pub(super) fn tree(root: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut files = BTreeMap::new();
    for entry in fs::read_dir(root).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            files.extend(tree(&path));
        } else {
            files.insert(path.clone(), fs::read(path).unwrap());
        }
    }
    files
}

#[test]
fn clean_dataset_verifies() {
    let dir = tempfile::tempdir().unwrap();
    write_dataset(dir.path(), &["mug", "bottle", "mug"]);
    let output = gripcast(&["verify", "--json"], dir.path());
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    insta::assert_snapshot!(stdout(&output), @r#"
    {
      "grasps": 3,
      "unlabelled": 1,
      "pending": 0,
      "notes": [],
      "by_kind": [],
      "problems": []
    }
    "#);
    let output = gripcast(&["verify"], dir.path());
    assert_eq!(
        stdout(&output),
        "3 grasps, 1 unlabelled, 0 pending, 0 problems\n"
    );
    assert_eq!(stderr(&output), "verifying\n");
}

#[test]
fn problems_are_reported_and_recovered() {
    let dir = tempfile::tempdir().unwrap();
    let ids = write_dataset(dir.path(), &["mug", "bottle", "mug"]);
    fs::remove_file(dir.path().join(format!("grasps/{}/grasp.rgb.png", ids[0]))).unwrap();
    let output = gripcast(&["verify", "--json"], dir.path());
    assert_eq!(output.status.code(), Some(4));
    insta::assert_snapshot!(redacted(&stdout(&output), &ids), @r#"
    {
      "grasps": 3,
      "unlabelled": 1,
      "pending": 0,
      "notes": [],
      "by_kind": [
        {
          "kind": "missing-file",
          "problems": 1,
          "grasps": 1,
          "examples": [
            "2026-11-20T10-15-00Z-XXXX"
          ]
        }
      ],
      "problems": [
        {
          "kind": "missing-file",
          "grasp": "2026-11-20T10-15-00Z-XXXX",
          "file": "grasps/2026-11-20T10-15-00Z-XXXX/grasp.rgb.png",
          "detail": "cannot read the file: No such file or directory (os error 2)",
          "remedy": "restore it from a backup, or run `gripcast dataset recover`"
        }
      ]
    }
    "#);
    assert!(stderr(&output).contains("1 problem found"));

    let before = tree(dir.path());
    let planned = gripcast(&["recover", "--dry-run", "--json"], dir.path());
    assert_eq!(planned.status.code(), Some(3));
    assert_eq!(tree(dir.path()), before, "a dry run changes nothing");
    let done = gripcast(&["recover", "--json"], dir.path());
    assert_eq!(done.status.code(), Some(3), "a grasp was lost");
    assert_eq!(json(&planned)["actions"], json(&done)["actions"]);
    assert_eq!(json(&done)["grasps"], 2);
    assert!(dir.path().join(format!("trash/{}", ids[0])).is_dir());

    let output = gripcast(&["verify"], dir.path());
    assert_eq!(output.status.code(), Some(0), "{}", stdout(&output));
    let output = gripcast(&["recover"], dir.path());
    assert_eq!(output.status.code(), Some(0));
    assert_eq!(stderr(&output), "nothing to recover\n");
}

#[test]
fn earlier_format_is_migrated_by_the_command() {
    let dir = tempfile::tempdir().unwrap();
    write_dataset(dir.path(), &["mug"]);
    let descriptor = dir.path().join("dataset.toml");
    let text = fs::read_to_string(&descriptor).unwrap();
    fs::write(&descriptor, text.replace("schema = 2", "schema = 1")).unwrap();
    assert_eq!(gripcast(&["verify"], dir.path()).status.code(), Some(0));
    let migrated = json(&gripcast(&["migrate", "--json"], dir.path()));
    assert_eq!(migrated, serde_json::json!({"from": 1, "to": 2}));
    assert_eq!(fs::read_to_string(&descriptor).unwrap(), text);
    let again = gripcast(&["migrate"], dir.path());
    assert!(
        stdout(&again).contains("nothing changed"),
        "{}",
        stdout(&again)
    );
}

#[test]
fn missing_index_is_rebuilt() {
    let dir = tempfile::tempdir().unwrap();
    let ids = write_dataset(dir.path(), &["mug", "bottle"]);
    let index = dir.path().join("metadata.jsonl");
    let before = fs::read_to_string(&index).unwrap();
    fs::remove_file(&index).unwrap();
    assert_eq!(gripcast(&["verify"], dir.path()).status.code(), Some(4));
    let output = gripcast(&["reindex", "--json"], dir.path());
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert_eq!(json(&output)["changed"], true);
    assert_eq!(fs::read_to_string(&index).unwrap(), before);
    assert_eq!(
        json(&gripcast(&["reindex", "--json"], dir.path()))["changed"],
        false
    );
    let columns = |line: &str| -> Vec<String> {
        let row: serde_json::Map<String, Value> = serde_json::from_str(line).unwrap();
        row.keys().cloned().collect()
    };
    let mut lines = before.lines();
    let first = columns(lines.next().unwrap());
    assert!(lines.all(|line| columns(line) == first), "same columns");
    insta::assert_snapshot!(redacted(before.lines().last().unwrap(), &ids), @r#"{"captured_at":"2026-11-20T10:15:03Z","grasp_depth_file_name":null,"grasp_left_file_name":"grasps/2026-11-20T10-15-02Z-XXXX/grasp.left.jpg","grasp_rgb_file_name":"grasps/2026-11-20T10-15-02Z-XXXX/grasp.rgb.png","grasp_right_file_name":"grasps/2026-11-20T10-15-02Z-XXXX/grasp.right.jpg","id":"2026-11-20T10-15-02Z-XXXX","initial_left_file_name":"grasps/2026-11-20T10-15-02Z-XXXX/initial.left.jpg","initial_rgb_file_name":"grasps/2026-11-20T10-15-02Z-XXXX/initial.rgb.png","initial_right_file_name":"grasps/2026-11-20T10-15-02Z-XXXX/initial.right.jpg","labelled_at":null,"object":"bottle","operator":"Ada","outcome":"unlabelled","pose_q_wxyz":null,"pose_t_m":null,"predicted_model":"baseline-contact","predicted_p_stable":0.75,"predicted_threshold":0.5,"rig":"bench-1","scene":"table"}"#);

    fs::write(
        dir.path().join(format!("grasps/{}/grasp.json", ids[0])),
        "{",
    )
    .unwrap();
    let output = gripcast(&["reindex"], dir.path());
    assert_eq!(output.status.code(), Some(3), "a grasp was skipped");
    assert!(stderr(&output).contains(ids[0].as_str()));
}

#[test]
fn info_shows_counts_and_agreement() {
    let dir = tempfile::tempdir().unwrap();
    write_dataset(dir.path(), &["mug", "bottle", "mug", "sponge"]);
    let output = gripcast(&["info", "--json"], dir.path());
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let mut info = json(&output);
    assert!(info["bytes"].as_u64().unwrap() > 10_000);
    info["bytes"] = 0.into();
    insta::assert_snapshot!(format!("{info:#}"), @r#"
    {
      "bytes": 0,
      "fields": {},
      "first_captured_at": "2026-11-20T10:15:01Z",
      "grasps": 4,
      "label_definition": "stable = still held 3 s after the lift",
      "last_captured_at": "2026-11-20T10:15:07Z",
      "licence": "CC-BY-4.0",
      "lifts": 0,
      "name": "kitchen",
      "objects": {
        "bottle": {
          "slip": 1
        },
        "mug": {
          "stable": 2
        },
        "sponge": {
          "unlabelled": 1
        }
      },
      "operators": {
        "Ada": 4
      },
      "outcomes": {
        "slip": 1,
        "stable": 2,
        "unlabelled": 1
      },
      "predictions": {
        "baseline-contact": {
          "false_slip": 0,
          "false_stable": 1,
          "true_slip": 0,
          "true_stable": 1
        }
      },
      "rigs": [
        "bench-1"
      ],
      "scenes": {
        "table": 4
      },
      "schema": 2,
      "stable_fraction": 0.6666666666666666,
      "trash_bytes": 0,
      "unreadable": 0
    }
    "#);
    let text = stdout(&gripcast(&["info"], dir.path()));
    assert!(
        text.contains("67 % of the labelled grasps are stable"),
        "{text}"
    );
    assert!(text.contains("baseline-contact: 1 of 2"), "{text}");
}

#[test]
fn splits_group_by_object_and_are_reproducible() {
    let dir = tempfile::tempdir().unwrap();
    let objects = ["a", "b", "c", "d", "e", "f", "A ", "b", "c", "d"];
    write_dataset(dir.path(), &objects);
    let args = ["split", "--seed", "7", "--json"];
    let output = gripcast(&args, dir.path());
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let path = dir.path().join("splits/object-7.json");
    let first = fs::read(&path).unwrap();
    gripcast(&args, dir.path());
    assert_eq!(fs::read(&path).unwrap(), first);
    let splits = &json(&output)["split"]["splits"];
    let mut groups: Vec<&str> = ["train", "val", "test"]
        .iter()
        .flat_map(|split| splits[split]["groups"].as_array().unwrap())
        .map(|group| group.as_str().unwrap())
        .collect();
    groups.sort_unstable();
    assert_eq!(groups, ["a", "b", "c", "d", "e", "f"], "each in one split");
    assert_eq!(gripcast(&["verify"], dir.path()).status.code(), Some(0));

    let few = tempfile::tempdir().unwrap();
    write_dataset(few.path(), &["mug", "bottle"]);
    let output = gripcast(&["split", "--seed", "1"], few.path());
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr(&output).contains("3 different objects"));
    let output = gripcast(&["split", "--train", "0.9"], few.path());
    assert_eq!(output.status.code(), Some(2));
    for name in ["../x", "train"] {
        let output = gripcast(&["split", "--name", name], few.path());
        assert_eq!(output.status.code(), Some(2), "{name}");
    }
}

#[test]
fn missing_and_foreign_directories_are_explained() {
    let dir = tempfile::tempdir().unwrap();
    for verb in ["info", "verify", "recover", "migrate", "reindex", "split"] {
        let output = gripcast(&[verb], &dir.path().join("nowhere"));
        assert_eq!(output.status.code(), Some(1), "{verb}");
        let text = stderr(&output);
        assert!(text.contains("dataset not found"), "{verb}: {text}");
        let output = gripcast(&[verb], dir.path());
        assert_eq!(output.status.code(), Some(1), "{verb}");
        assert!(stderr(&output).contains("not a dataset"), "{verb}");
    }
    fs::write(dir.path().join("dataset.toml"), "schema = 99\n").unwrap();
    let output = gripcast(&["verify"], dir.path());
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr(&output).contains("update gripcast"));
}

#[test]
fn locked_dataset_is_not_modified() {
    let dir = tempfile::tempdir().unwrap();
    write_dataset(dir.path(), &["mug"]);
    let _writer = DatasetWriter::open_or_create(dir.path(), &new_dataset()).unwrap();
    for verb in ["recover", "migrate", "reindex"] {
        let output = gripcast(&[verb], dir.path());
        assert_eq!(output.status.code(), Some(1), "{verb}");
        let owner = format!("process {}", std::process::id());
        assert!(stderr(&output).contains(&owner), "{}", stderr(&output));
    }
    assert_eq!(gripcast(&["info"], dir.path()).status.code(), Some(0));
}

#[test]
fn python_loads_mixed_dataset() {
    let Some(mut check) = peer("load_imagefolder.py") else {
        return;
    };
    let dir = tempfile::tempdir().unwrap();
    let cache = tempfile::tempdir().unwrap();
    write_mixed_dataset(dir.path());
    agrees(check.arg(dir.path()).env("HF_HOME", cache.path()));
}

#[test]
fn python_loads_all_image_columns() {
    let Some(mut check) = peer("load_imagefolder.py") else {
        return;
    };
    let dir = tempfile::tempdir().unwrap();
    let cache = tempfile::tempdir().unwrap();
    write_dataset(dir.path(), &["mug", "bottle", "sponge"]);
    // Undone and pending grasps and split files must not affect the columns.
    let (mut writer, _) = DatasetWriter::open_or_create(dir.path(), &new_dataset()).unwrap();
    let roles = [Role::Left, Role::Right, Role::Rgb];
    let pending = writer
        .save_initial(&capture(20, &roles), Vec::new())
        .unwrap();
    let id = writer
        .save_grasp(&pending, &capture(21, &roles), GraspMeta::default())
        .unwrap()
        .id;
    writer.undo_grasp(&id).unwrap();
    drop(writer);
    gripcast(&["split", "--name", "fold-1"], dir.path());
    let text = agrees(check.arg(dir.path()).env("HF_HOME", cache.path()));
    assert!(text.contains("7 image columns"), "{text}");
    println!("{text}");
}
