//! Tests with generated frames.

use image::RgbImage;

use super::*;
use crate::demo::object::objects;
use crate::demo::plan::DemoSettings;
use crate::demo::reality::SimulatedCandidate;
use crate::demo::selection::Candidate;
use gripcast_dataset::verify;
use gripcast_geometry::Pose;
use gripcast_imaging::encode_jpeg;
use gripcast_pose::synthetic::test_camera;
use gripcast_sim::grasp::{GraspOutcome, GripperState, Snapshot, StageName};

fn object() -> DemoObject {
    let settings = DemoSettings {
        seed: 1,
        quick: true,
        shared: None,
        jobs: 1,
    };
    objects(&settings).unwrap().remove(0)
}

fn chosen(number: usize, outcome: GraspOutcome) -> SelectedGrasp {
    let above = Pose::from_translation(glam::DVec3::Z * 0.03);
    SelectedGrasp {
        object: 0,
        candidate: Candidate {
            number,
            placed: GripperState {
                t_world_gripper: above,
                opening_m: 0.06,
            },
            stop_force_n: 30.0,
        },
        simulated: SimulatedCandidate {
            key: String::new(),
            outcome,
            lifted_m: 0.05,
            force_n: [30.0, 31.0],
            pre_lift: Some(Snapshot {
                stage: StageName::Adjustment,
                t_s: 1.0,
                t_world_object: Pose::IDENTITY,
                t_world_gripper: above,
                opening_m: 0.04,
                gels: [Vec::new(), Vec::new()],
            }),
            cpu_s: 1.0,
        },
    }
}

/// Frames that differ from each other and from those of other grasps.
fn frames(number: usize) -> GraspFrames {
    let jpeg = |[width, height]: [u32; 2], shade: usize| {
        let image = RgbImage::from_fn(width, height, |x, y| {
            image::Rgb([x as u8, y as u8, (shade + 16 * number) as u8])
        });
        encode_jpeg(&image, 50).unwrap()
    };
    let gel = |shade| jpeg(FRAME, shade);
    let hand = super::super::images::HAND_CAMERA.map(|n| n as u32);
    GraspFrames {
        tactile: [[gel(0), gel(1)], [gel(2), gel(3)]],
        images: Images {
            hand: [jpeg(hand, 4), jpeg(hand, 5)],
            table: jpeg(TABLE_CAMERA.map(|n| n as u32), 6),
            intrinsics: test_camera(1280, 720),
        },
    }
}

fn record(folder: &Path, object: &DemoObject, scene: &DemoScene, all: &[SelectedGrasp]) {
    let recorder = Recorder::open(folder, 1, false).unwrap();
    for one in all {
        if recorder.recorded.contains(&grasp_name(object, one)) {
            continue;
        }
        let frames = frames(one.candidate.number);
        let [initial, grasp] = recorder.captures(object, one, frames, None).unwrap();
        recorder
            .store(object, scene, one, &initial, &grasp)
            .unwrap();
    }
    recorder.finish().unwrap();
}

#[test]
fn interrupted_recording_resumes_to_the_same_dataset() {
    let object = object();
    let scene = DemoScene::new(&object, 1).unwrap();
    let all = [
        chosen(3, GraspOutcome::Success),
        chosen(5, GraspOutcome::Eject),
    ];
    let folders = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
    let [once, twice] = folders.each_ref().map(|f| f.path().join("dataset"));
    record(&once, &object, &scene, &all);
    record(&twice, &object, &scene, &all[..1]);
    // Interrupted between the two frames of the second grasp.
    {
        let recorder = Recorder::open(&twice, 1, false).unwrap();
        let captures = recorder
            .captures(&object, &all[1], frames(5), None)
            .unwrap();
        recorder
            .writer()
            .save_initial(&captures[0], Vec::new())
            .unwrap();
    }
    record(&twice, &object, &scene, &all);
    for folder in [&once, &twice] {
        let report = verify(folder, &|_, _| {}).unwrap();
        assert_eq!((report.grasps, report.unlabelled), (2, 0));
        assert!(report.problems.is_empty(), "{:?}", report.problems);
    }
    let read = |folder: &Path| -> Vec<_> {
        let all = Dataset::open(folder).unwrap();
        all.grasps().unwrap().map(|g| g.unwrap()).collect()
    };
    let records = read(&once);
    assert_eq!(records, read(&twice));
    let outcomes: Vec<Outcome> = records.iter().map(|r| r.outcome).collect();
    assert_eq!(outcomes, [Outcome::Stable, Outcome::Slip]);
    let truth = records[1].truth.as_ref().unwrap();
    assert_eq!(
        (truth.clip.as_str(), truth.outcome.as_str()),
        ("jack-005", "eject")
    );
    assert_eq!(truth.friction, object.friction);
    let descriptor = Dataset::open(&once).unwrap().descriptor().clone();
    assert!(descriptor.label_definition.starts_with("SIMULATED"));
    assert!(records[0].note.starts_with("Simulated, not real"));
    assert!(records[0].calibration.contains_key(&Role::External));
}

#[test]
fn grasps_of_other_settings_are_detected() {
    let object = object();
    let scene = DemoScene::new(&object, 1).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("dataset");
    record(&path, &object, &scene, &[chosen(3, GraspOutcome::Success)]);
    let recorder = Recorder::open(&path, 1, false).unwrap();
    let names = |text: &str| BTreeSet::from([text.to_owned()]);
    assert_eq!(recorder.unexpected_grasp(&names("jack-003")), None);
    assert_eq!(
        recorder.unexpected_grasp(&names("jack-004")),
        Some(&"jack-003".to_owned())
    );
}
