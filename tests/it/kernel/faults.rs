//! Sensors with one serial number, cameras that vanish or refuse to start, clocks that lie.

use std::fs;

use gripcast_imaging::Role;

use super::guest::{kernel, run};
use super::{
    assert_dataset_is_clean, assert_one_good_grasp, assert_one_good_grasp_of,
    assert_others_undisturbed, camera_file, images,
};

#[test]
fn twin_comes_back_to_its_own_role() {
    const SERIAL: &str = "200901010001";
    let Some(kernel) = kernel() else { return };
    let images = images::drawn();
    let outcome = run(&kernel, "twins-unplugged", "twins-unplugged", images);
    assert_one_good_grasp_of([SERIAL; 2], &outcome, images);
    for role in ["left", "right"] {
        assert_eq!(outcome.counter(role, "reconnects"), 1, "{role}: {outcome}");
    }
    let told = outcome.told();
    assert!(told.contains("FAULT LEFT GELSIGHT"), "{told}");
    assert!(told.contains("no matching camera in port 1-1"), "{told}");
    assert!(told.contains("of right has the same serial"), "{told}");
    assert_others_undisturbed(&outcome, &["left", "right"]);
}

#[test]
fn both_sensors_unplugged_at_once_come_back() {
    let Some(kernel) = kernel() else { return };
    let images = images::drawn();
    let outcome = run(&kernel, "both-unplugged", "both-unplugged", images);
    assert_one_good_grasp(&outcome, images);
    assert_eq!(outcome.session("refused"), 1, "{outcome}");
    let told = outcome.told();
    for role in ["left", "right"] {
        assert_eq!(outcome.counter(role, "reconnects"), 1, "{role}: {outcome}");
        let fault = format!("FAULT {} GELSIGHT", role.to_uppercase());
        assert!(told.contains(&fault), "{told}");
    }
    assert_others_undisturbed(&outcome, &["left", "right"]);
}

#[test]
fn camera_that_refuses_to_start_is_started_again() {
    let Some(kernel) = kernel() else { return };
    let images = images::drawn();
    let outcome = run(&kernel, "commit-stalls", "commit-stalls", images);
    assert_one_good_grasp(&outcome, images);
    assert_eq!(outcome.sent["left"]["stall-commit"], 5, "{outcome}");
    let told = outcome.told();
    assert!(told.contains("FAULT LEFT GELSIGHT"), "{told}");
    assert_others_undisturbed(&outcome, &["left"]);
}

#[test]
fn clocks_of_cameras_that_stand_still_or_jump_do_no_harm() {
    let Some(kernel) = kernel() else { return };
    let images = images::drawn();
    let outcome = run(&kernel, "camera-clocks", "camera-clocks", images);
    assert_one_good_grasp(&outcome, images);
    assert!(outcome.sent["left"]["still-clock"] > 50, "{outcome}");
    assert!(outcome.sent["right"]["jumping-clock"] > 50, "{outcome}");
    assert_eq!(outcome.session("refused"), 0, "{outcome}");
    assert!(!outcome.told().contains("FAULT"), "{outcome}");
    assert_others_undisturbed(&outcome, &[]);
}

/// Pixels of a JPEG, by libjpeg.
fn pixels(jpeg: &[u8]) -> Vec<u8> {
    turbojpeg::decompress(jpeg, turbojpeg::PixelFormat::RGB)
        .unwrap()
        .pixels
}

#[test]
fn harmless_bytes_around_images_are_no_damage() {
    let Some(kernel) = kernel() else { return };
    let images = images::drawn();
    let outcome = run(&kernel, "harmless-bytes", "harmless-bytes", images);
    assert_eq!(outcome.exit_code, Some(0), "{outcome}");
    assert_eq!(outcome.session("refused"), 0, "{outcome}");
    assert!(!outcome.told().contains("FAULT"), "{outcome}");
    assert_others_undisturbed(&outcome, &[]);
    let [grasp] = outcome.grasps.as_slice() else {
        panic!("{outcome}");
    };
    for (role, dir, faults) in [
        (Role::Left, &images.left, &["tail"][..]),
        (Role::Right, &images.right, &["lead", "no-end"][..]),
    ] {
        for fault in faults {
            assert!(outcome.sent[role.name()][*fault] > 10, "{outcome}");
        }
        for (stage, kind) in [
            (&grasp.record.initial, "free"),
            (&grasp.record.grasp, "pressed"),
        ] {
            let saved = camera_file(stage, role, &grasp.dir);
            let as_sent = fs::read_dir(dir.join(kind))
                .unwrap()
                .any(|file| pixels(&fs::read(file.unwrap().path()).unwrap()) == pixels(&saved));
            assert!(as_sent, "{role} {kind}: {outcome}");
        }
    }
    assert_dataset_is_clean(&outcome);
}

#[test]
fn camera_with_damaged_images_is_not_called_unplugged() {
    let Some(kernel) = kernel() else { return };
    let images = images::drawn();
    let outcome = run(&kernel, "always-damaged", "always-damaged", images);
    assert_one_good_grasp(&outcome, images);
    assert_eq!(outcome.session("refused"), 1, "{outcome}");
    let told = outcome.told();
    assert!(told.contains("FAULT LEFT GELSIGHT DAMAGED"), "{told}");
    assert!(!told.contains("PLUG IT IN"), "{told}");
    assert_eq!(outcome.counter("left", "damaged"), 75, "{outcome}");
    assert_others_undisturbed(&outcome, &["left"]);
}

#[test]
fn depth_camera_that_sees_nothing_is_not_called_frozen() {
    let Some(kernel) = kernel() else { return };
    let images = images::drawn();
    let outcome = run(&kernel, "zero-depth", "zero-depth", images);
    assert_eq!(outcome.exit_code, Some(0), "{outcome}");
    assert_eq!(outcome.session("refused"), 0, "{outcome}");
    let [grasp] = outcome.grasps.as_slice() else {
        panic!("{outcome}");
    };
    let depth = &grasp.record.grasp.cameras[&Role::Depth];
    assert_eq!(depth.valid_fraction, Some(0.0), "{outcome}");
    let told = outcome.told();
    assert!(told.contains("depth sees nothing"), "{told}");
    assert!(
        !told.contains("FROZEN") && !told.contains("REPLUG"),
        "{told}"
    );
    assert_eq!(outcome.counter("depth", "reconnects"), 0, "{outcome}");
    assert_others_undisturbed(&outcome, &["depth"]);
}
