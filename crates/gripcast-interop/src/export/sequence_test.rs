//! Sequences from the black box in the LeRobot export.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use parquet::file::reader::{FileReader as _, SerializedFileReader};
use parquet::record::{Field, Row};
use serde_json::{Value, json};

use super::{ExportFormat, ExportPlan, ExportReport, SequencePlan, export};
use crate::black_box::sample_log::{SampleEntry, write_log};
use gripcast_base::error::{ErrorKind, Result};
use gripcast_dataset::sample::{capture_with_fields, jpeg, meta, new_dataset};
use gripcast_dataset::{Dataset, DatasetWriter, GraspId, Outcome, PoseQuality, PoseRecord};
use gripcast_imaging::{Decoder, Frame, PixelFormat, Role};

const OFFSET: i128 = 1_763_633_700_000_000_000;
const MS: u64 = 1_000_000;
const FILE: &str = "2026-11-20T10-15-03Z-00001.mcap";
/// First frame, initial and grasp frame, and end of the log of a grasp, in frames of 40 ms.
const INITIAL: u64 = 10;
const GRASP: u64 = 30;
const END: u64 = 90;
/// Begin of the second grasp after the first, in frames.
const SECOND: u64 = 100;

/// Frame `number` of a camera: gels and depth at 25 frames per second, colour at 20.
fn frame(role: Role, number: u64) -> Frame {
    let (format, period) = match role {
        Role::Left | Role::Right => (PixelFormat::Mjpg, 40),
        Role::Depth => (PixelFormat::Z16, 40),
        _ => (PixelFormat::Yuyv, 50),
    };
    let shade = (number as u8).wrapping_mul(3) ^ (role as u8 * 64);
    let data = match format {
        PixelFormat::Mjpg => jpeg(16, 8, shade),
        _ => (0..=255_u8).map(|i| i.wrapping_mul(5) ^ shade).collect(),
    };
    let driver_time_ns = (1000 + number * period + role as u64) * MS;
    Frame {
        format,
        width: 16,
        height: 8,
        data: data.into(),
        sequence: number as u32,
        driver_time_ns,
        received_ns: driver_time_ns,
    }
}

/// Number of the frame of a camera at frame `number` of the left gel, which is `number` × 40 ms.
fn number_at(role: Role, number: u64) -> u64 {
    if role == Role::Rgb {
        number * 4 / 5
    } else {
        number
    }
}

/// The log from frame `from` to frame `to` of the left gel.
fn log(from: u64, to: u64) -> Vec<SampleEntry> {
    let mut entries = Vec::new();
    for role in [Role::Left, Role::Right, Role::Rgb, Role::Depth] {
        let numbers = number_at(role, from)..number_at(role, to);
        entries.extend(numbers.map(|number| SampleEntry::Frame(role, frame(role, number))));
    }
    // Every other frame of the left gel was measured, 30 ms later.
    for number in (from..to).filter(|number| number % 2 == 0) {
        let time_ns = frame(Role::Left, number).driver_time_ns;
        let shear = json!({
            "role": "left",
            "frame_time_ns": time_ns,
            "summary": null,
            "force": {"normal_n": number as f64 / 4.0, "normal_std_n": 0.5, "shear_n": null,
                "shear_std_n": null, "is_calibrated": false},
            "problems": [],
            "markers": {"shape": [2, 3, 5], "values": vec![Some(number as f64); 30]},
        });
        entries.push(SampleEntry::Shear(time_ns + 30 * MS, shear));
    }
    entries.sort_by_key(SampleEntry::time_ns);
    entries
}

/// A stable mug and a bottle that slipped, each with a log from its frame 0 to its `END`. The label
/// of the mug comes 1.5 s after its grasp.
fn dataset() -> (tempfile::TempDir, Vec<GraspId>) {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("d");
    let (mut writer, _) = DatasetWriter::open_or_create(&root, &new_dataset()).unwrap();
    let mut ids = Vec::new();
    for (object, begin) in [("mug", 0), ("bottle", SECOND)] {
        let stages = [(1, INITIAL), (2, GRASP)].map(|(number, at)| {
            let mut stage = capture_with_fields(number);
            stage.trigger_time_ns = (1000 + 40 * (begin + at) + 20) * MS;
            for (role, camera) in &mut stage.cameras {
                camera.frame = frame(*role, number_at(*role, begin + at));
            }
            stage
        });
        let pending = writer.save_initial(&stages[0], Vec::new()).unwrap();
        let record = writer
            .save_grasp(&pending, &stages[1], meta(object))
            .unwrap();
        let (outcome, after_ms) = match object {
            "mug" => (Outcome::Stable, 1500),
            _ => (Outcome::Slip, 60_000),
        };
        let grasp_ns = frame(Role::Depth, begin + GRASP).driver_time_ns;
        let labelled_ns = OFFSET + i128::from(grasp_ns + after_ms * MS);
        let at = jiff::Timestamp::from_nanosecond(labelled_ns).unwrap();
        writer.set_outcome(&record.id, outcome, at, None).unwrap();
        ids.push(record.id);
    }
    fs::create_dir(root.join("blackbox")).unwrap();
    (dir, ids)
}

fn whole_log() -> Vec<SampleEntry> {
    [log(0, END), log(SECOND, SECOND + 120)].concat()
}

fn write(dir: &Path, entries: &[SampleEntry]) -> PathBuf {
    let path = dir.join("d/blackbox").join(FILE);
    write_log(&path, Some(OFFSET), entries);
    path
}

fn run(dir: &Path, out: &str, sequences: SequencePlan) -> Result<ExportReport> {
    let mut plan = ExportPlan::new(ExportFormat::LeRobot);
    plan.sequences = Some(sequences);
    let dataset = Dataset::open(dir.join("d")).unwrap();
    export(&dataset, &dir.join(out), &plan, &|_, _| {})
}

fn rows(out: &Path) -> Vec<Row> {
    let file = fs::File::open(out.join("data/chunk-000/file-000.parquet")).unwrap();
    let rows = SerializedFileReader::new(file).unwrap();
    let rows = rows.get_row_iter(None).unwrap();
    rows.map(std::result::Result::unwrap).collect()
}

fn json_file(path: &Path) -> Value {
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

fn field<'a>(row: &'a Row, name: &str) -> &'a Field {
    row.get_column_iter().find(|(of, _)| *of == name).unwrap().1
}

fn integers(rows: &[Row], name: &str) -> Vec<i64> {
    let value = |row: &Row| match field(row, name) {
        Field::Long(value) => *value,
        Field::Bool(value) => i64::from(*value),
        other => panic!("{name}: {other}"),
    };
    rows.iter().map(value).collect()
}

fn floats(field: &Field) -> Vec<f32> {
    match field {
        Field::Float(value) => vec![*value],
        Field::Double(value) => vec![*value as f32],
        Field::ListInternal(list) => list.elements().iter().flat_map(floats).collect(),
        other => panic!("{other}"),
    }
}

fn image(row: &Row, name: &str) -> Vec<u8> {
    match field(row, name) {
        Field::Group(image) => {
            let bytes = image.get_column_iter().find(|(of, _)| *of == "bytes");
            match bytes.unwrap().1 {
                Field::Bytes(bytes) => bytes.data().to_vec(),
                other => panic!("{other}"),
            }
        }
        other => panic!("{other}"),
    }
}

fn lift(seconds: u64) -> SequencePlan {
    SequencePlan {
        lift: Duration::from_secs(seconds),
        ..SequencePlan::default()
    }
}

/// The newest frame of a camera at or before a time, by its definition.
fn newest(role: Role, time_ns: u64) -> Frame {
    let frames = (0..500).map(|number| frame(role, number));
    let before = frames.take_while(|frame| frame.driver_time_ns <= time_ns);
    before.last().unwrap()
}

#[test]
fn sequence_goes_from_the_initial_trigger_to_lift_or_label() {
    let (dir, ids) = dataset();
    write(dir.path(), &whole_log());
    let report = run(dir.path(), "out", SequencePlan::default()).unwrap();
    assert_eq!(report.left_out, []);
    let notes = [
        "action left out: no grasp has the gripper's opening".to_owned(),
        format!("20 frames per second, as rgb of {}", ids[0]),
    ];
    assert_eq!(report.notes, notes);
    let out = dir.path().join("out");
    let info = json_file(&out.join("meta/info.json"));
    assert_eq!(info["fps"], 20);
    // The mug: 0.783 s before, the grasp, 1.5 s until the label. The bottle: 3 s of lift.
    let lengths = [15 + 1 + 30, 15 + 1 + 60];
    assert_eq!(info["total_frames"], lengths[0] + lengths[1]);
    let rows = rows(&out);
    assert_eq!(rows.len(), lengths[0] + lengths[1]);
    let episodes = integers(&rows, "episode_index");
    assert_eq!(episodes.iter().filter(|e| **e == 0).count(), lengths[0]);
    let phases = integers(&rows, "phase");
    let spans = |n: [usize; 3]| (0..3).flat_map(move |phase| vec![phase as i64; n[phase]]);
    assert_eq!(
        phases,
        spans([15, 1, 30])
            .chain(spans([15, 1, 60]))
            .collect::<Vec<_>>()
    );
    let done = integers(&rows, "next.done");
    let ends: Vec<usize> = (0..rows.len()).filter(|i| done[*i] == 1).collect();
    assert_eq!(ends, [lengths[0] - 1, lengths[0] + lengths[1] - 1]);
    let success = integers(&rows, "next.success");
    assert_eq!(success.iter().sum::<i64>(), 1);
    assert_eq!(success[ends[0]], 1);
    assert_eq!(
        integers(&rows, "index"),
        (0..rows.len() as i64).collect::<Vec<_>>()
    );
    assert_eq!(integers(&rows, "frame_index")[lengths[0]], 0);
    assert_eq!(floats(field(&rows[7], "timestamp")), [7.0 / 20.0]);

    let mut decoder = Decoder::new().unwrap();
    let grasp_ns = frame(Role::Depth, GRASP).driver_time_ns;
    for (index, row) in rows[..lengths[0]].iter().enumerate() {
        let time_ns = grasp_ns + index as u64 * 50 * MS - 15 * 50 * MS;
        for role in [Role::Left, Role::Right, Role::Rgb] {
            let expected = match index {
                15 => frame(role, number_at(role, GRASP)),
                _ => newest(role, time_ns),
            };
            let name = format!("driver_time_ns.{role}");
            let found = integers(std::slice::from_ref(row), &name)[0];
            assert_eq!(found as u64, expected.driver_time_ns, "{index} {role}");
            let pixels = decoder.decode_full(&expected).unwrap();
            let bytes = image(row, &format!("observation.images.{role}"));
            assert_eq!(
                decoder.stored_image(&bytes).unwrap(),
                pixels,
                "{index} {role}"
            );
        }
    }
    // The frames of the trigger are the stored ones.
    for (role, file) in [("left", "grasp.left.jpg"), ("rgb", "grasp.rgb.png")] {
        let stored = fs::read(dir.path().join(format!("d/grasps/{}/{file}", ids[0]))).unwrap();
        let bytes = image(&rows[15], &format!("observation.images.{role}"));
        let [found, stored] = [bytes, stored].map(|b| decoder.stored_image(&b).unwrap());
        assert_eq!(found, stored, "{role}");
    }
    let depth = image(&rows[20], "observation.depth");
    assert_eq!(&depth[..4], b"II*\0");
}

#[test]
fn shear_is_that_of_the_frame_and_nan_elsewhere() {
    let (dir, _) = dataset();
    write(dir.path(), &whole_log());
    let plan = SequencePlan {
        fps: Some(25),
        approach: Some(Duration::from_millis(400)),
        lift: Duration::from_millis(200),
        ..SequencePlan::default()
    };
    run(dir.path(), "out", plan).unwrap();
    let rows = rows(&dir.path().join("out"));
    let numbers = GRASP - 10..=GRASP + 5;
    assert_eq!(rows.len(), 2 * numbers.clone().count());
    for (row, number) in rows.iter().zip(numbers) {
        let time_ns = integers(std::slice::from_ref(row), "driver_time_ns.left")[0];
        assert_eq!(time_ns as u64, frame(Role::Left, number).driver_time_ns);
        let markers = floats(field(row, "observation.tactile.left"));
        let force = floats(field(row, "observation.force"));
        assert_eq!(markers.len(), 30);
        assert!(force[4..].iter().all(|n| n.is_nan()));
        if number == GRASP {
            // What was stored with the grasp.
            assert_eq!((markers[0], markers[29]), (0.25, 29.25));
            assert_eq!(force[..4], [12.5, 1.25, 0.5, -0.75]);
        } else if number % 2 == 0 {
            assert!(markers.iter().all(|n| *n == number as f32), "{number}");
            assert_eq!(force[..2], [number as f32 / 4.0, 0.5]);
            assert!(force[2].is_nan());
        } else {
            assert!(markers.iter().chain(&force).all(|n| n.is_nan()), "{number}");
        }
        let p_stable = floats(field(row, "prediction.p_stable"))[0];
        assert_eq!(p_stable.is_nan(), number != GRASP);
    }
}

#[test]
fn action_is_the_measured_opening_at_the_grasp() {
    let (dir, ids) = dataset();
    write(dir.path(), &whole_log());
    let (mut writer, _) =
        DatasetWriter::open_or_create(dir.path().join("d"), &new_dataset()).unwrap();
    let quality = PoseQuality {
        frames: Vec::new(),
        markers: [4, 2],
        tags_reprojection_px: 0.1,
        spread_m: 0.0,
        spread_rad: 0.0,
        blur_px: 1.0,
        opening_m: Some(0.03125),
        ambiguous: false,
        sheet: "0".repeat(64),
        tags: "0".repeat(64),
        notes: Vec::new(),
    };
    let pose = PoseRecord {
        t_m: [0.5, -0.25, 0.125],
        q_wxyz: [1.0, 0.0, 0.0, 0.0],
        frame: "t_object_gripper".into(),
        covariance: None,
        reprojection_px: None,
        corrected_by_hand: false,
        quality: Some(quality),
    };
    writer.set_pose(&ids[1], pose).unwrap();
    drop(writer);
    let report = run(dir.path(), "out", lift(1)).unwrap();
    assert_eq!(report.notes.len(), 1, "{:?}", report.notes);
    let info = json_file(&dir.path().join("out/meta/info.json"));
    let names = &info["features"]["action"]["names"];
    assert_eq!(names, &json!(["gripper_opening_m"]));
    let rows = rows(&dir.path().join("out"));
    for (row, episode) in rows.iter().zip(integers(&rows, "episode_index")) {
        let is_measured = episode == 1 && integers(std::slice::from_ref(row), "phase")[0] == 1;
        let action = floats(field(row, "action"))[0];
        match is_measured {
            true => assert_eq!(action, 0.03125),
            false => assert!(action.is_nan()),
        }
        let pose = floats(field(row, "observation.pose"))[0];
        assert_eq!(pose.is_nan(), !is_measured);
    }
}

/// Exports with a log and returns the reason why the only grasp left out was.
fn left_out(dir: &Path, out: &str, id: &GraspId) -> String {
    let report = run(dir, out, lift(2)).unwrap();
    let [only] = &report.left_out[..] else {
        panic!("{:?}", report.left_out);
    };
    assert_eq!((only.id.as_str(), report.grasps), (id.as_str(), 1));
    only.reason.clone()
}

#[test]
fn grasps_that_are_not_completely_in_the_log_are_named() {
    let (dir, ids) = dataset();
    let first = log(0, END);
    write(dir.path(), &first);
    let reason = left_out(dir.path(), "out-a", &ids[1]);
    assert_eq!(reason, "the black box has none of its grasp frames");

    // The log ends 0.8 s after the grasp of the bottle.
    write(
        dir.path(),
        &[first.clone(), log(SECOND, SECOND + 50)].concat(),
    );
    let reason = left_out(dir.path(), "out-b", &ids[1]);
    assert!(
        reason.contains("no frame of rgb in the 500 ms up to 1.25 s after"),
        "{reason}"
    );

    // It begins after the initial trigger.
    write(
        dir.path(),
        &[first.clone(), log(SECOND + 28, SECOND + 120)].concat(),
    );
    let reason = left_out(dir.path(), "out-c", &ids[1]);
    assert!(reason.contains("s before the grasp"), "{reason}");

    // No frame of the right gel.
    let mut second = log(SECOND, SECOND + 120);
    second.retain(|entry| !matches!(entry, SampleEntry::Frame(Role::Right, _)));
    write(dir.path(), &[first.clone(), second].concat());
    let reason = left_out(dir.path(), "out-d", &ids[1]);
    assert!(
        reason.contains("lacks its grasp frame of right"),
        "{reason}"
    );

    // Another image at the time of the grasp.
    let mut second = log(SECOND, SECOND + 120);
    for entry in &mut second {
        if let SampleEntry::Frame(Role::Left, of) = entry
            && u64::from(of.sequence) == SECOND + GRASP
        {
            of.data = jpeg(16, 8, 201).into();
        }
    }
    write(dir.path(), &[first, second].concat());
    let reason = left_out(dir.path(), "out-e", &ids[1]);
    assert!(reason.contains("differs from the stored image"), "{reason}");
    assert!(reason.contains("grasp frame of left"), "{reason}");
}

#[test]
fn damaged_frames_are_skipped_and_counted() {
    let (dir, _) = dataset();
    let mut entries = whole_log();
    let damaged = GRASP - 4;
    for entry in &mut entries {
        if let SampleEntry::Frame(Role::Left, of) = entry
            && u64::from(of.sequence) == damaged
        {
            let half = of.data.len() / 2;
            of.data = of.data[..half].to_vec().into();
        }
    }
    write(dir.path(), &entries);
    let plan = SequencePlan {
        fps: Some(25),
        ..lift(1)
    };
    let report = run(dir.path(), "out", plan).unwrap();
    assert_eq!(report.left_out, []);
    let note = "damaged frames of left skipped: 1".to_owned();
    assert!(report.notes.contains(&note), "{:?}", report.notes);
    let times = integers(&rows(&dir.path().join("out")), "driver_time_ns.left");
    let time_of = |number| frame(Role::Left, number).driver_time_ns as i64;
    assert!(!times.contains(&time_of(damaged)));
    let before = times.iter().filter(|time| **time == time_of(damaged - 1));
    assert_eq!(before.count(), 2);
}

#[test]
fn cut_log_has_the_grasps_before_the_cut() {
    let (dir, ids) = dataset();
    let path = write(dir.path(), &whole_log());
    let bytes = fs::read(&path).unwrap();
    fs::remove_file(&path).unwrap();
    let partial = path.with_extension("partial.mcap");
    fs::write(&partial, &bytes[..bytes.len() * 7 / 10]).unwrap();
    let reason = left_out(dir.path(), "out", &ids[1]);
    assert!(reason.starts_with("the black box"), "{reason}");
    let again = run(dir.path(), "again", lift(2)).unwrap();
    assert!(
        again
            .notes
            .iter()
            .any(|note| note.contains("partial.mcap is damaged after"))
    );
}

#[test]
fn equal_logs_give_equal_bytes() {
    let (dir, _) = dataset();
    write(dir.path(), &whole_log());
    for out in ["a", "b"] {
        run(dir.path(), out, lift(1)).unwrap();
    }
    for file in [
        "data/chunk-000/file-000.parquet",
        "meta/info.json",
        "meta/stats.json",
    ] {
        let read = |out: &str| fs::read(dir.path().join(out).join(file)).unwrap();
        assert!(read("a") == read("b"), "{file}");
    }
}

#[test]
fn missing_log_and_other_formats_are_refused() {
    let (dir, _) = dataset();
    let error = run(dir.path(), "out", SequencePlan::default()).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::NotFound);
    assert!(!dir.path().join("out").exists());
    // A log elsewhere, of another collection.
    let elsewhere = dir.path().join("elsewhere");
    fs::create_dir(&elsewhere).unwrap();
    write_log(&elsewhere.join(FILE), Some(OFFSET), &log(300, 320));
    let plan = SequencePlan {
        black_box: Some(elsewhere),
        ..SequencePlan::default()
    };
    let error = run(dir.path(), "out", plan.clone()).unwrap_err();
    assert!(error.what().contains("none of its grasp frames"), "{error}");
    assert!(error.remedy_text().unwrap().contains("--black-box"));
    assert!(!dir.path().join("out").exists());
    let mut other = ExportPlan::new(ExportFormat::Zarr);
    other.sequences = Some(plan);
    let dataset = Dataset::open(dir.path().join("d")).unwrap();
    let error = export(&dataset, &dir.path().join("out"), &other, &|_, _| {}).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Usage);
}
