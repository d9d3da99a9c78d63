//! Recording with frames that cost nothing to make.

use image::RgbImage;

use super::*;
use crate::demo::object::objects;
use crate::demo::plan::DemoSettings;
use crate::demo::reality::Simulated;
use crate::demo::sampler::Candidate;
use gripcast_dataset::verify;
use gripcast_geometry::Pose;
use gripcast_imaging::encode_jpeg;
use gripcast_pose::synthetic::test_camera;
use gripcast_sim::grasp::{GraspOutcome, Placed, Snapshot, StageName};

fn object() -> DemoObject {
    let settings = DemoSettings {
        seed: 1,
        quick: true,
        shared: None,
        jobs: 1,
    };
    objects(&settings).unwrap().remove(0)
}

fn chosen(number: usize, outcome: GraspOutcome) -> Chosen {
    let above = Pose::from_translation(glam::DVec3::Z * 0.03);
    Chosen {
        object: 0,
        candidate: Candidate {
            number,
            placed: Placed {
                t_world_gripper: above,
                opening_m: 0.06,
            },
            stop_force_n: 30.0,
        },
        simulated: Simulated {
            key: String::new(),
            outcome,
            lifted_m: 0.05,
            force_n: [30.0, 31.0],
            grasped: Some(Snapshot {
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

/// Frames that differ from each other and from those of another grasp.
fn shot(number: usize) -> Shot {
    let jpeg = |[width, height]: [u32; 2], shade: usize| {
        let image = RgbImage::from_fn(width, height, |x, y| {
            image::Rgb([x as u8, y as u8, (shade + 16 * number) as u8])
        });
        encode_jpeg(&image, 50).unwrap()
    };
    let gel = |shade| jpeg(FRAME, shade);
    let hand = super::super::images::HAND.map(|n| n as u32);
    Shot {
        tactile: [[gel(0), gel(1)], [gel(2), gel(3)]],
        images: Images {
            hand: [jpeg(hand, 4), jpeg(hand, 5)],
            beside: jpeg(BESIDE.map(|n| n as u32), 6),
            intrinsics: test_camera(1280, 720),
        },
    }
}

fn record(folder: &Path, object: &DemoObject, stand: &Stand, all: &[Chosen]) {
    let recorder = Recorder::open(folder, 1, false).unwrap();
    for one in all {
        if recorder.recorded.contains(&film(object, one)) {
            continue;
        }
        let shot = shot(one.candidate.number);
        let [initial, grasp] = recorder.captures(object, one, shot, None).unwrap();
        recorder
            .store(object, stand, one, &initial, &grasp)
            .unwrap();
    }
    recorder.finish().unwrap();
}

#[test]
fn what_is_recorded_is_whole_labelled_and_the_same_after_a_stop() {
    let object = object();
    let stand = Stand::new(&object, 1).unwrap();
    let all = [
        chosen(3, GraspOutcome::Success),
        chosen(5, GraspOutcome::Eject),
    ];
    let folders = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
    let [once, twice] = folders.each_ref().map(|f| f.path().join("dataset"));
    record(&once, &object, &stand, &all);
    record(&twice, &object, &stand, &all[..1]);
    // Stopped between the two frames of the second grasp.
    {
        let recorder = Recorder::open(&twice, 1, false).unwrap();
        let captures = recorder.captures(&object, &all[1], shot(5), None).unwrap();
        recorder
            .writer()
            .save_initial(&captures[0], Vec::new())
            .unwrap();
    }
    record(&twice, &object, &stand, &all);
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
fn grasps_of_another_plan_are_noticed() {
    let object = object();
    let stand = Stand::new(&object, 1).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("dataset");
    record(&path, &object, &stand, &[chosen(3, GraspOutcome::Success)]);
    let recorder = Recorder::open(&path, 1, false).unwrap();
    let names = |text: &str| BTreeSet::from([text.to_owned()]);
    assert_eq!(recorder.foreign(&names("jack-003")), None);
    assert_eq!(
        recorder.foreign(&names("jack-004")),
        Some(&"jack-003".to_owned())
    );
}
