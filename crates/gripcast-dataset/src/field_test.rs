//! Field arrays and lift frames of stored grasps: written, read, damaged, rebuilt, undone.

use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;

use super::sample::{capture_with_fields, lift, meta, new_dataset};
use super::{
    Dataset, DatasetWriter, GraspId, GraspRecord, LiftVerdict, MARKERS, Outcome, ProblemKind,
    Stage, recover, verify,
};
use gripcast_base::error::ErrorKind;
use gripcast_imaging::{PixelFormat, Role};

struct Stored {
    dir: tempfile::TempDir,
    id: GraspId,
}

impl Stored {
    /// A grasp with fields and lift frames.
    fn new() -> (Self, DatasetWriter) {
        let dir = tempfile::tempdir().unwrap();
        let (mut writer, _) = DatasetWriter::open_or_create(dir.path(), &new_dataset()).unwrap();
        let initial = capture_with_fields(1);
        let pending = writer.save_initial(&initial, Vec::new()).unwrap();
        let closed = capture_with_fields(2);
        let record = writer.save_grasp(&pending, &closed, meta("mug")).unwrap();
        writer.append_lift(&record.id, &lift(1), 2.0).unwrap();
        let id = record.id;
        (Self { dir, id }, writer)
    }

    fn file(&self, name: &str) -> PathBuf {
        self.dir.path().join(format!("grasps/{}/{name}", self.id))
    }

    fn record(&self) -> (Dataset, GraspRecord) {
        let dataset = Dataset::open(self.dir.path()).unwrap();
        let record = dataset.grasp(&self.id).unwrap();
        (dataset, record)
    }

    fn problems(&self) -> Vec<(ProblemKind, String)> {
        let report = verify(self.dir.path(), &|_, _| {}).unwrap();
        let problems = report.problems.into_iter();
        problems.map(|p| (p.kind, p.detail)).collect()
    }

    fn edit(&self, from: &str, to: &str) {
        let path = self.file("grasp.json");
        let text = fs::read_to_string(&path).unwrap();
        assert!(text.contains(from), "{text}");
        fs::write(path, text.replacen(from, to, 1)).unwrap();
    }
}

#[test]
fn fields_and_lift_are_read_as_they_were_written() {
    let (stored, writer) = Stored::new();
    drop(writer);
    let (dataset, record) = stored.record();
    let [expected, _] = [capture_with_fields(1), capture_with_fields(2)];
    let array = dataset.field(&record, Stage::Initial, Role::Left, MARKERS);
    assert_eq!(array.unwrap(), expected.fields[0].values);
    let described = &record.grasp.fields[&Role::Left][MARKERS];
    assert_eq!(described.columns[2], "dx_px");
    assert_eq!(described.m_per_px, Some(2.9e-5));
    assert_eq!(record.grasp.shear, expected.shear);
    assert_eq!(record.grasp.force, expected.force);
    let missing = dataset.field(&record, Stage::Grasp, Role::Right, MARKERS);
    assert_eq!(missing.unwrap_err().kind(), ErrorKind::NotFound);

    let kept = record.lift.as_ref().unwrap();
    assert_eq!((kept.requested_s, kept.cameras.len()), (2.0, 2));
    for (role, sent) in lift(1) {
        let read = dataset.lift_frames(&record, role).unwrap();
        assert_eq!(read.len(), sent.len());
        for (read, sent) in read.iter().zip(&sent) {
            assert_eq!(
                (&read.data[..], read.sequence),
                (&sent.data[..], sent.sequence)
            );
            assert_eq!(read.driver_time_ns, sent.driver_time_ns);
        }
        let all: Vec<u8> = sent.iter().flat_map(|f| f.data.to_vec()).collect();
        assert_eq!(dataset.lift_bytes(&record, role).unwrap(), all);
    }
    let summary = super::summary(&dataset).unwrap();
    assert_eq!((summary.schema, summary.lifts), (2, 1));
    assert_eq!(summary.fields[MARKERS], 1);
    let missing = dataset.lift_frames(&record, Role::Rgb).unwrap_err();
    assert_eq!(missing.kind(), ErrorKind::NotFound);
    assert_eq!(stored.problems(), []);
}

#[test]
fn verdict_in_the_lift_is_stored_with_the_label_and_stays() {
    let (stored, mut writer) = Stored::new();
    let verdict = LiftVerdict {
        p_stable: 0.25,
        threshold: 0.5,
        frame_time_ns: 7,
        alarm_time_ns: Some(6),
    };
    let later = LiftVerdict {
        frame_time_ns: 9,
        ..verdict
    };
    let labels = [
        (Outcome::Slip, None, None),
        (Outcome::Slip, Some(verdict), Some(verdict)),
        (Outcome::Stable, None, Some(verdict)),
        (Outcome::Slip, Some(later), Some(verdict)),
    ];
    for (outcome, given, expected) in labels {
        let at = jiff::Timestamp::UNIX_EPOCH;
        let record = writer.set_outcome(&stored.id, outcome, at, given).unwrap();
        assert_eq!((record.outcome, record.lift_verdict), (outcome, expected));
        assert_eq!(stored.record().1, record);
    }
    drop(writer);
    assert_eq!(stored.problems(), []);
}

#[test]
fn lift_is_kept_once_and_without_damaged_frames() {
    let (stored, mut writer) = Stored::new();
    let again = writer.append_lift(&stored.id, &lift(3), 2.0).unwrap_err();
    assert!(again.to_string().contains("kept already"), "{again}");
    let reopened = writer.undo_grasp(&stored.id).unwrap();
    assert_eq!(reopened.files.len(), 4, "three images and the field");
    let undone = writer.append_lift(&stored.id, &lift(3), 2.0).unwrap_err();
    assert_eq!(undone.kind(), ErrorKind::NotFound);

    let other = writer.save_grasp(&reopened, &capture_with_fields(4), meta("mug"));
    let id = other.unwrap().id;
    let none = writer.append_lift(&id, &BTreeMap::new(), 2.0).unwrap_err();
    assert_eq!(none.kind(), ErrorKind::Input);
    let mut frames = lift(5);
    let left = frames.get_mut(&Role::Left).unwrap();
    let cut = left[1].data.len() / 2;
    left[1].data = left[1].data[..cut].to_vec().into();
    for frame in frames.get_mut(&Role::Right).unwrap() {
        frame.data = (0..=255)
            .map(|i: u8| i ^ frame.sequence as u8)
            .collect::<Vec<u8>>()
            .into();
        frame.format = PixelFormat::Yuyv;
    }
    let record = writer.append_lift(&id, &frames, 1.5).unwrap();
    let cameras = &record.lift.as_ref().unwrap().cameras;
    let sequences: Vec<u32> = cameras[&Role::Left]
        .frames
        .iter()
        .map(|f| f.sequence)
        .collect();
    assert_eq!(sequences, [5, 7]);
    assert_eq!(cameras[&Role::Right].file, "lift.right.pngs");
    let dataset = Dataset::open(stored.dir.path()).unwrap();
    let read = dataset.lift_frames(&record, Role::Right).unwrap();
    assert_eq!((read.len(), read[0].format), (3, PixelFormat::Rgb));
    drop(writer);
    assert_eq!(stored.problems(), []);
}

#[test]
fn unrecorded_lift_is_removed_at_the_next_start() {
    let (stored, writer) = Stored::new();
    drop(writer);
    let (_, mut record) = stored.record();
    record.lift = None;
    record.files.retain(|name, _| !name.starts_with("lift."));
    let json = super::record_file::to_json(&record).unwrap();
    fs::write(stored.file("grasp.json"), json).unwrap();
    let kinds: Vec<ProblemKind> = stored
        .problems()
        .into_iter()
        .map(|(kind, _)| kind)
        .collect();
    assert_eq!(kinds, [ProblemKind::Torn; 2]);
    drop(DatasetWriter::open(stored.dir.path()).unwrap());
    assert!(!stored.file("lift.left.mjpeg").exists());
    assert_eq!(stored.problems(), []);
}

#[test]
fn fields_and_lifts_other_than_recorded_are_found() {
    let (stored, writer) = Stored::new();
    drop(writer);
    stored.edit("\"dx_px\",", "");
    stored.edit(
        "\"height\": 8,\n        \"width\": 16",
        "\"height\": 9,\n        \"width\": 16",
    );
    let found = stored.problems();
    let expected = [
        (
            ProblemKind::DamagedImage,
            "lift frame 0: expected 16×9 pixels as recorded",
        ),
        (ProblemKind::DamagedField, "4 names and 5 units"),
    ];
    for (kind, text) in expected {
        let is_found = found
            .iter()
            .any(|(k, detail)| *k == kind && detail.contains(text));
        assert!(is_found, "{kind:?} {text}: {found:?}");
    }
    let (dataset, record) = stored.record();
    let field = dataset.field(&record, Stage::Grasp, Role::Left, MARKERS);
    assert_eq!(field.unwrap_err().kind(), ErrorKind::Input);
}

#[test]
fn rebuilt_record_keeps_what_it_still_describes() {
    let (stored, writer) = Stored::new();
    drop(writer);
    let (_, before) = stored.record();
    // A key that no version has: the record is unreadable, its contents are there.
    stored.edit("\"note\": \"\"", "\"remark\": \"\"");
    fs::write(stored.file("lift.right.mjpeg"), b"torn").unwrap();
    let report = recover(stored.dir.path(), false).unwrap();
    assert_eq!(report.grasps, 1, "{report:?}");
    let (dataset, after) = stored.record();
    assert_eq!(after.grasp.fields, before.grasp.fields);
    assert_eq!(after.grasp.shear, before.grasp.shear);
    let kept: Vec<Role> = after
        .lift
        .as_ref()
        .unwrap()
        .cameras
        .keys()
        .copied()
        .collect();
    assert_eq!(kept, [Role::Left]);
    assert!(dataset.lift_frames(&after, Role::Left).is_ok());
    assert!(!stored.file("lift.right.mjpeg").exists(), "set aside");
    assert_eq!(stored.problems(), []);
}
