//! Damages a dataset in every way that verification detects, then recovers it.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use super::sample::{capture, meta, new_dataset};
use super::{
    ActionKind, Dataset, DatasetWriter, GraspId, GroupKey, Outcome, ProblemKind, RecoverReport,
    SplitPlan, recover, split, verify,
};
use gripcast_base::error::ErrorKind;
use gripcast_imaging::{CropProfile, Decoder, PixelFormat, Role};

fn has_losses(report: &RecoverReport) -> bool {
    report.actions.iter().any(|action| action.lost)
}

/// Three labelled grasps of three objects.
fn dataset() -> (tempfile::TempDir, Vec<GraspId>) {
    let dir = tempfile::tempdir().unwrap();
    let (mut writer, report) = DatasetWriter::open_or_create(dir.path(), &new_dataset()).unwrap();
    assert!(report.created);
    let calibration = writer.put_calibration("unit = 1\n").unwrap();
    let mut ids = Vec::new();
    for (number, object) in (0..).zip(["mug", "bottle", "sponge"]) {
        let pending = writer
            .save_initial(&capture(2 * number + 1), Vec::new())
            .unwrap();
        let mut meta = meta(object);
        meta.calibration.insert(Role::Left, calibration.clone());
        let record = writer
            .save_grasp(&pending, &capture(2 * number + 2), meta)
            .unwrap();
        let at = "2026-11-20T11:00:00Z".parse().unwrap();
        writer
            .set_outcome(&record.id, Outcome::Slip, at, None)
            .unwrap();
        ids.push(record.id);
    }
    (dir, ids)
}

fn problems(root: &Path) -> BTreeSet<ProblemKind> {
    verify(root, &|_, _| {})
        .unwrap()
        .problems
        .into_iter()
        .map(|problem| {
            assert!(!problem.remedy.is_empty() && !problem.detail.is_empty());
            problem.kind
        })
        .collect()
}

fn kinds(report: &RecoverReport) -> BTreeSet<ActionKind> {
    report.actions.iter().map(|action| action.kind).collect()
}

/// Contents of all files.
fn contents(dir: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut files = BTreeMap::new();
    let mut dirs = vec![dir.to_owned()];
    while let Some(dir) = dirs.pop() {
        for entry in fs::read_dir(dir).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                dirs.push(path);
            } else {
                files.insert(path.clone(), fs::read(path).unwrap());
            }
        }
    }
    files
}

/// Damages a dataset, expects the problems `found`, recovers; returns the report and the dataset.
fn damaged(
    found: &[ProblemKind],
    damage: impl FnOnce(&Path, &[GraspId]),
) -> (RecoverReport, tempfile::TempDir, Vec<GraspId>) {
    let (dir, ids) = dataset();
    assert_eq!(problems(dir.path()), BTreeSet::new());
    damage(dir.path(), &ids);
    assert_eq!(problems(dir.path()), found.iter().copied().collect());
    let before = contents(dir.path());
    let planned = recover(dir.path(), true).unwrap();
    assert_eq!(contents(dir.path()), before, "a dry run changes nothing");
    let done = recover(dir.path(), false).unwrap();
    assert_eq!(planned.actions, done.actions);
    assert_eq!(planned.grasps, done.grasps);
    let after: BTreeSet<Vec<u8>> = contents(dir.path()).into_values().collect();
    for (path, bytes) in before {
        let derived = path.ends_with("metadata.jsonl") || path.ends_with(".lock");
        assert!(derived || after.contains(&bytes), "{path:?} was deleted");
    }
    assert_eq!(problems(dir.path()), BTreeSet::new(), "recovered");
    assert_eq!(recover(dir.path(), false).unwrap().actions, []);
    (done, dir, ids)
}

#[test]
fn missing_image_loses_only_its_grasp() {
    let (report, dir, ids) = damaged(&[ProblemKind::MissingFile], |root, ids| {
        fs::remove_file(root.join(format!("grasps/{}/grasp.left.jpg", ids[1]))).unwrap()
    });
    assert!(has_losses(&report));
    assert_eq!(report.grasps, 2);
    let reason = fs::read_to_string(dir.path().join(format!("trash/{}/reason.txt", ids[1])));
    assert!(reason.unwrap().contains("grasp.left.jpg"));
}

#[test]
fn altered_image_loses_only_its_grasp() {
    let (report, ..) = damaged(&[ProblemKind::Altered], |root, ids| {
        let path = root.join(format!("grasps/{}/initial.right.jpg", ids[0]));
        let mut bytes = fs::read(&path).unwrap();
        let middle = bytes.len() / 2;
        bytes[middle] ^= 1;
        fs::write(path, bytes).unwrap();
    });
    assert!(has_losses(&report));
}

#[test]
fn torn_record_is_rebuilt_from_the_index() {
    let (report, dir, ids) = damaged(
        &[ProblemKind::UnreadableRecord, ProblemKind::Index],
        |root, ids| {
            let path = root.join(format!("grasps/{}/grasp.json", ids[2]));
            let bytes = fs::read(&path).unwrap();
            fs::write(path, &bytes[..bytes.len() / 2]).unwrap();
        },
    );
    assert!(!has_losses(&report));
    assert!(kinds(&report).contains(&ActionKind::Rebuild));
    let record = Dataset::open(dir.path()).unwrap().grasp(&ids[2]).unwrap();
    assert_eq!(record.object, "sponge");
    assert_eq!(record.outcome, Outcome::Slip);
    assert_eq!(record.files.len(), 7);
    assert!(record.note.contains("the images and the index"));
}

#[test]
fn invalid_record_keeps_its_valid_fields() {
    let (_, dir, ids) = damaged(
        &[ProblemKind::UnreadableRecord, ProblemKind::Index],
        |root, ids| {
            let path = root.join(format!("grasps/{}/grasp.json", ids[0]));
            let text = fs::read_to_string(&path).unwrap();
            fs::write(path, text.replace("\"scene\": \"table\"", "\"scene\": 5")).unwrap();
        },
    );
    let record = Dataset::open(dir.path()).unwrap().grasp(&ids[0]).unwrap();
    assert_eq!(record.object, "mug");
    assert_eq!(record.scene, "table", "from the index");
    assert_eq!(record.initial.cameras[&Role::Left].serial, "S-left");
}

#[test]
fn renamed_directory_is_renamed_back() {
    let (report, dir, ids) = damaged(
        &[ProblemKind::IdMismatch, ProblemKind::Index],
        |root, ids| {
            let grasps = root.join("grasps");
            fs::rename(grasps.join(ids[1].as_str()), grasps.join("favourite")).unwrap();
        },
    );
    assert!(kinds(&report).contains(&ActionKind::Rename));
    assert!(!has_losses(&report));
    assert!(Dataset::open(dir.path()).unwrap().grasp(&ids[1]).is_ok());
}

#[test]
fn copied_grasp_is_moved_to_trash() {
    for name in [
        "0-copy",
        "ID (conflicted copy)",
        "ID.sync-conflict-20261125-101010-A",
    ] {
        let (report, ..) = damaged(&[ProblemKind::DuplicateId], |root, ids| {
            let copy = root.join("grasps").join(name.replace("ID", &ids[0]));
            fs::create_dir(&copy).unwrap();
            for entry in fs::read_dir(root.join(format!("grasps/{}", ids[0]))).unwrap() {
                let entry = entry.unwrap();
                fs::copy(entry.path(), copy.join(entry.file_name())).unwrap();
            }
        });
        assert!(!has_losses(&report));
        assert_eq!(report.grasps, 3);
    }
}

#[test]
fn extra_files_and_torn_saves_are_moved_to_trash() {
    let (report, ..) = damaged(&[ProblemKind::ExtraFile, ProblemKind::Torn], |root, ids| {
        fs::write(root.join(format!("grasps/{}/notes.txt", ids[0])), "mine").unwrap();
        fs::write(root.join("grasps/readme.txt"), "also mine").unwrap();
        let torn = root.join("grasps/.tmp-2026-11-20T10-20-00Z-0000");
        fs::create_dir(&torn).unwrap();
        fs::write(torn.join("initial.left.jpg"), [0xff, 0xd8]).unwrap();
        fs::write(
            root.join(format!("grasps/{}/.grasp.json.partial", ids[1])),
            "{",
        )
        .unwrap();
    });
    assert_eq!(kinds(&report), [ActionKind::SetAside].into());
    assert_eq!(report.actions.len(), 4);
    assert!(!has_losses(&report));
}

#[test]
fn torn_index_is_rewritten() {
    let (report, ..) = damaged(&[ProblemKind::Index], |root, _| {
        let path = root.join("metadata.jsonl");
        let bytes = fs::read(&path).unwrap();
        fs::write(path, &bytes[..bytes.len() - 40]).unwrap();
    });
    assert_eq!(kinds(&report), [ActionKind::Reindex].into());
}

#[test]
fn missing_descriptor_is_rewritten() {
    let (report, dir, _) = damaged(&[ProblemKind::Descriptor], |root, _| {
        fs::remove_file(root.join("dataset.toml")).unwrap();
    });
    assert_eq!(kinds(&report), [ActionKind::WriteDescriptor].into());
    let dataset = Dataset::open(dir.path()).unwrap();
    assert_eq!(dataset.descriptor().rig, "bench");
}

#[test]
fn frozen_camera_is_reported() {
    let dir = tempfile::tempdir().unwrap();
    let (mut writer, _) = DatasetWriter::open_or_create(dir.path(), &new_dataset()).unwrap();
    let initial = capture(1);
    let mut grasp = capture(2);
    let left = Role::Left;
    grasp.cameras.get_mut(&left).unwrap().frame.data = initial.cameras[&left].frame.data.clone();
    let pending = writer.save_initial(&initial, Vec::new()).unwrap();
    writer.save_grasp(&pending, &grasp, meta("mug")).unwrap();
    drop(writer);
    let report = verify(dir.path(), &|_, _| {}).unwrap();
    assert_eq!(report.unlabelled, 1);
    let [problem] = report.problems.as_slice() else {
        panic!("{:?}", report.problems);
    };
    assert_eq!(problem.kind, ProblemKind::DuplicateContent);
    assert!(problem.file.as_ref().unwrap().ends_with("initial.left.jpg"));
}

#[test]
fn image_damaged_by_the_camera_is_reported() {
    let dir = tempfile::tempdir().unwrap();
    let (mut writer, _) = DatasetWriter::open_or_create(dir.path(), &new_dataset()).unwrap();
    let mut initial = capture(1);
    let left = Role::Left;
    let frame = &mut initial.cameras.get_mut(&left).unwrap().frame;
    frame.data = frame.data[..frame.data.len() - 30].to_vec().into();
    let pending = writer.save_initial(&initial, Vec::new()).unwrap();
    writer
        .save_grasp(&pending, &capture(2), meta("mug"))
        .unwrap();
    drop(writer);
    assert_eq!(problems(dir.path()), [ProblemKind::DamagedImage].into());
}

#[test]
fn altered_and_missing_calibrations_are_reported() {
    let (dir, _) = dataset();
    let path = fs::read_dir(dir.path().join("calibration"))
        .unwrap()
        .next()
        .unwrap()
        .unwrap()
        .path();
    fs::write(&path, "unit = 2\n").unwrap();
    assert_eq!(problems(dir.path()), [ProblemKind::Calibration].into());
    fs::remove_file(&path).unwrap();
    assert_eq!(problems(dir.path()), [ProblemKind::Calibration].into());
}

#[test]
fn object_in_two_splits_is_a_leak() {
    let (dir, ids) = dataset();
    let plan = SplitPlan {
        name: "fold".into(),
        by: GroupKey::Object,
        seed: 3,
        fractions: BTreeMap::from([("train".into(), 0.5), ("test".into(), 0.5)]),
    };
    let dataset = Dataset::open(dir.path()).unwrap();
    let file = split(&dataset, &plan).unwrap();
    assert_eq!(file.grasps().count(), 3);
    assert_eq!(problems(dir.path()), BTreeSet::new());
    let path = dir.path().join("splits/fold.json");
    let text = fs::read_to_string(&path).unwrap();
    // A grasp of the training split is relabelled with an object of the test split.
    let object = |id: &GraspId| dataset.grasp(id).unwrap().object;
    let train = file.splits["train"].grasps.first().unwrap();
    let test = file.splits["test"].grasps.first().unwrap();
    let record = dir.path().join(format!("grasps/{train}/grasp.json"));
    let json = fs::read_to_string(&record).unwrap();
    let changed = json.replace(
        object(train).as_str(),
        &format!(" {}", object(test).to_uppercase()),
    );
    fs::write(&record, changed).unwrap();
    super::reindex(dir.path()).unwrap();
    let found = [ProblemKind::Name, ProblemKind::Leak].into();
    assert_eq!(problems(dir.path()), found);
    fs::write(
        &path,
        text.replace(ids[0].as_str(), "2020-01-01T00-00-00Z-0000"),
    )
    .unwrap();
    assert!(problems(dir.path()).contains(&ProblemKind::Split));
}

#[test]
fn loaded_frames_equal_sent_frames() {
    let (dir, ids) = dataset();
    let dataset = Dataset::open(dir.path()).unwrap();
    let record = dataset.grasp(&ids[0]).unwrap();
    let sent = capture(2);
    for role in [Role::Left, Role::Depth] {
        let frame = dataset
            .load_frame(&record, super::Stage::Grasp, role)
            .unwrap();
        assert_eq!(frame.data, sent.cameras[&role].frame.data, "{role}");
    }
    let colour = Role::Rgb;
    let frame = dataset
        .load_frame(&record, super::Stage::Grasp, colour)
        .unwrap();
    let mut decoder = Decoder::new().unwrap();
    assert_eq!(
        decoder.decode_full(&frame).unwrap(),
        decoder.decode_full(&sent.cameras[&colour].frame).unwrap(),
    );
    let path = dataset
        .image_path(&record, super::Stage::Grasp, colour)
        .unwrap();
    assert!(
        path.shown()
            .ends_with(format!("grasps/{}/grasp.rgb.png", ids[0]))
    );
    let depth = Role::Depth;
    assert_eq!(
        dataset.image_path(&record, super::Stage::Initial, depth),
        None
    );
}

/// YUYV frames reach inference with the same pixels live and after a restart.
#[test]
fn stored_yuyv_frames_decode_like_live_frames() {
    let dir = tempfile::tempdir().unwrap();
    let mut sent = capture(1);
    for (role, salt) in [(Role::Left, 7_u8), (Role::Right, 11)] {
        let frame = &mut sent.cameras.get_mut(&role).unwrap().frame;
        frame.format = PixelFormat::Yuyv;
        frame.data = (0..=255_u8)
            .map(|i| i.wrapping_mul(salt))
            .collect::<Vec<_>>()
            .into();
    }
    let (mut writer, _) = DatasetWriter::open_or_create(dir.path(), &new_dataset()).unwrap();
    let fresh = writer.save_initial(&sent, Vec::new()).unwrap();
    drop(writer);
    let (writer, report) = DatasetWriter::open_or_create(dir.path(), &new_dataset()).unwrap();
    let resumed = report.pending.unwrap();
    assert_eq!(resumed, fresh);
    assert_eq!(resumed.stage.cameras[&Role::Left].format, PixelFormat::Yuyv);
    let frames = writer.pending_frames(&resumed).unwrap();
    let mut decoder = Decoder::new().unwrap();
    let crop = Some(&CropProfile::GSMINI_SEVENTH);
    for role in [Role::Left, Role::Right] {
        let live = decoder.decode(&sent.cameras[&role].frame, crop, 8, 6);
        assert_eq!(decoder.decode(&frames[&role], crop, 8, 6), live, "{role}");
        assert!(live.is_ok(), "{role}: {live:?}");
    }
}

#[test]
fn missing_items_are_errors_not_panics() {
    let (dir, ids) = dataset();
    let (mut writer, report) = DatasetWriter::open_or_create(dir.path(), &new_dataset()).unwrap();
    assert_eq!(report.counts.by_object["mug"][&Outcome::Slip], 1);
    assert!(writer.free_bytes().unwrap() > 0);
    let at = "2026-11-20T12:00:00Z".parse().unwrap();
    let missing = GraspId::parse("2020-01-01T00-00-00Z-0000").unwrap();
    let pending = writer.save_initial(&capture(20), Vec::new()).unwrap();
    for error in [
        writer
            .set_outcome(&missing, Outcome::Slip, at, None)
            .unwrap_err(),
        writer.undo_grasp(&missing).unwrap_err(),
        writer.trash_grasp(&missing).unwrap_err(),
        writer.redo_grasp(&missing, None).unwrap_err(),
        writer.restore_initial(&missing).unwrap_err(),
    ] {
        assert_eq!(error.kind(), ErrorKind::NotFound, "{error}");
    }
    fs::remove_dir_all(dir.path()).unwrap();
    for error in [
        writer.save_initial(&capture(21), Vec::new()).unwrap_err(),
        writer
            .save_grasp(&pending, &capture(22), meta("mug"))
            .unwrap_err(),
        writer
            .set_outcome(&ids[0], Outcome::Stable, at, None)
            .unwrap_err(),
        writer.undo_grasp(&ids[0]).unwrap_err(),
        writer.trash_grasp(&ids[0]).unwrap_err(),
        writer.discard_initial(&pending).unwrap_err(),
        writer.put_calibration("a = 1").unwrap_err(),
        writer.log_event(&serde_json::json!({})).unwrap_err(),
        writer.pending_frames(&pending).unwrap_err(),
    ] {
        assert_eq!(error.kind(), ErrorKind::NotFound, "{error}");
    }
}

#[test]
fn directories_without_a_dataset_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let refused = |path: &Path| {
        DatasetWriter::open_or_create(path, &new_dataset())
            .map(|_| ())
            .unwrap_err()
    };
    let file = dir.path().join("file");
    fs::write(&file, "").unwrap();
    assert_eq!(refused(&file).kind(), ErrorKind::Input);
    let foreign = dir.path().join("foreign");
    fs::create_dir(&foreign).unwrap();
    fs::write(foreign.join("thesis.pdf"), "").unwrap();
    let error = refused(&foreign);
    assert!(error.to_string().contains("thesis.pdf"), "{error}");
    assert!(!foreign.join(".lock").exists());
    let newer = dir.path().join("newer");
    fs::create_dir(&newer).unwrap();
    fs::write(newer.join("dataset.toml"), "schema = 99\n").unwrap();
    let error = refused(&newer);
    assert!(error.to_string().contains("update gripcast"), "{error}");
    let deep = dir.path().join("a/b/c");
    DatasetWriter::open_or_create(&deep, &new_dataset()).unwrap();
    assert!(Dataset::open(&deep).is_ok());
}

#[test]
fn second_writer_error_names_the_first() {
    let (dir, _) = dataset();
    let _first = DatasetWriter::open_or_create(dir.path(), &new_dataset()).unwrap();
    let Err(error) = DatasetWriter::open_or_create(dir.path(), &new_dataset()) else {
        panic!("two writers");
    };
    assert_eq!(error.kind(), ErrorKind::Busy);
    assert!(error.to_string().contains(&std::process::id().to_string()));
    let notes = verify(dir.path(), &|_, _| {}).unwrap().notes;
    assert!(notes[0].contains("is writing the dataset"), "{notes:?}");
}
