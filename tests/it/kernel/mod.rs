//! The unmodified program against the real USB, UVC and HID drivers of a Linux kernel, with
//! emulated devices, in virtual time. `docs/how-to/kernel-tests.md` tells how it works.

mod faults;
mod guest;
mod images;

use std::fs;
use std::path::Path;

use gripcast_dataset::{Outcome as Label, StageRecord};
use gripcast_imaging::Role;

use self::guest::{Outcome, SavedGrasp, kernel, run};
use self::images::Images;

/// Returns the image that a sensor sent: its input file with the number in a comment segment after
/// the first marker.
fn sent_image(number: u64, dir: &Path, kind: &str) -> Vec<u8> {
    let mut files: Vec<_> = fs::read_dir(dir.join(kind))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    files.sort();
    let file = fs::read(&files[(number % files.len() as u64) as usize]).unwrap();
    let comment = [[0xff, 0xfe, 0, 10].as_slice(), &number.to_be_bytes()].concat();
    [&file[..2], &comment, &file[2..]].concat()
}

fn camera_file(stage: &StageRecord, role: Role, dir: &Path) -> Vec<u8> {
    let record = &stage.cameras[&role];
    fs::read(dir.join(record.file.as_str())).unwrap()
}

/// Serial numbers of the left and the right sensor.
const SERIALS: [&str; 2] = ["2BNN4ZE7", "28F5K4RR"];

/// Asserts that the tactile images of a grasp are the bytes sent by the sensor of that role.
fn assert_as_sent(grasp: &SavedGrasp, images: &Images) {
    assert_as_sent_by(SERIALS, grasp, images);
}

/// As [`assert_as_sent`], for sensors with these serial numbers.
fn assert_as_sent_by(serials: [&str; 2], grasp: &SavedGrasp, images: &Images) {
    for (role, serial, dir) in [
        (Role::Left, serials[0], &images.left),
        (Role::Right, serials[1], &images.right),
    ] {
        for (stage, kind) in [
            (&grasp.record.initial, "free"),
            (&grasp.record.grasp, "pressed"),
        ] {
            let place = format!("{}: {role} {kind}", grasp.dir.display());
            assert_eq!(stage.cameras[&role].serial, serial, "{place}");
            let saved = camera_file(stage, role, &grasp.dir);
            let number = u64::from_be_bytes(saved[6..14].try_into().unwrap());
            let is_as_sent = saved == sent_image(number, dir, kind);
            assert!(is_as_sent, "{place}: image {number} is not as sent");
        }
    }
}

/// Asserts that the tactile images of a grasp are bytes sent by the sensor of that role, with or
/// without contact.
fn assert_complete_as_sent(grasp: &SavedGrasp, images: &Images) {
    for (role, dir) in [(Role::Left, &images.left), (Role::Right, &images.right)] {
        for stage in [&grasp.record.initial, &grasp.record.grasp] {
            let saved = camera_file(stage, role, &grasp.dir);
            let number = u64::from_be_bytes(saved[6..14].try_into().unwrap());
            let is_as_sent = ["free", "pressed"]
                .iter()
                .any(|kind| saved == sent_image(number, dir, kind));
            let place = grasp.dir.display();
            assert!(is_as_sent, "{place}: {role} {number} is not as sent");
        }
    }
    assert_depth_as_sent(grasp);
}

/// Asserts that the depth image is one complete image of the emulator: pixel (x, y) of image n
/// holds 400 + (x + y + n) mod 256, the first four n in digits to the base of 256.
fn assert_depth_as_sent(grasp: &SavedGrasp) {
    let record = &grasp.record.grasp.cameras[&Role::Depth];
    let depth = image::open(grasp.dir.join(record.file.as_str()))
        .unwrap()
        .to_luma16();
    let number = u32::from(depth.get_pixel(0, 0).0[0]) - 400;
    for (x, y, pixel) in depth.enumerate_pixels() {
        let level = u32::from(pixel.0[0]);
        match (x, y) {
            (0..4, 0) => assert!((400..656).contains(&level), "({x}, {y}): {level}"),
            _ => assert_eq!(level, 400 + (x + y + number) % 256, "({x}, {y})"),
        }
    }
}

/// Asserts that all files of the records exist with their digests and no partial files exist.
fn assert_dataset_is_clean(outcome: &Outcome) {
    let dataset = outcome.out.join("dataset");
    let verified = std::process::Command::new(env!("CARGO_BIN_EXE_gripcast"))
        .args(["dataset", "verify", "--json"])
        .arg(&dataset)
        .output()
        .unwrap();
    assert!(
        verified.status.success(),
        "{outcome}\n{}{}",
        String::from_utf8_lossy(&verified.stdout),
        String::from_utf8_lossy(&verified.stderr)
    );
}

/// Asserts that one labelled grasp was saved as sent and the program succeeded.
fn assert_one_good_grasp(outcome: &Outcome, images: &Images) {
    assert_one_good_grasp_of(SERIALS, outcome, images);
}

/// As [`assert_one_good_grasp`], for sensors with these serial numbers.
fn assert_one_good_grasp_of(serials: [&str; 2], outcome: &Outcome, images: &Images) {
    assert_eq!(outcome.exit_code, Some(0), "{outcome}");
    assert_eq!(outcome.grasps.len(), 1, "{outcome}");
    let grasp = &outcome.grasps[0];
    assert_eq!(grasp.record.object, "mug");
    assert_eq!(grasp.record.outcome, Label::Stable);
    assert_as_sent_by(serials, grasp, images);
    assert_depth_as_sent(grasp);
    assert_dataset_is_clean(outcome);
}

/// Asserts that all cameras except `but` have no sequence gaps, damaged frames or reconnects.
fn assert_others_undisturbed(outcome: &Outcome, but: &[&str]) {
    for role in ["left", "right", "rgb", "depth"] {
        if !but.contains(&role) {
            for counter in ["sequence_gaps", "damaged", "reconnects"] {
                assert_eq!(
                    outcome.counter(role, counter),
                    0,
                    "{role} {counter}: {outcome}"
                );
            }
        }
    }
}

#[test]
fn emulated_cameras_deliver_their_input() {
    let Some(kernel) = kernel() else { return };
    let report = guest::probe(&kernel, images::drawn());
    for (role, name, serial, interface, fps) in [
        (
            "left",
            "GelSight Mini R0B 2BNN-4ZE7: Ge",
            "2BNN4ZE7",
            0,
            25.0,
        ),
        (
            "right",
            "GelSight Mini R0B 28F5-K4RR: Ge",
            "28F5K4RR",
            0,
            25.0,
        ),
        (
            "depth",
            "Intel(R) RealSense(TM) Depth Ca",
            "814412070123",
            0,
            30.0,
        ),
        (
            "rgb",
            "Intel(R) RealSense(TM) Depth Ca",
            "814412070123",
            3,
            30.0,
        ),
    ] {
        let camera = &report["cameras"][role];
        assert_eq!(camera["name"], name, "{report:#}");
        assert_eq!(camera["serial"], serial, "{report:#}");
        assert_eq!(camera["interface"], interface, "{report:#}");
        assert_eq!(camera["identical"], camera["frames"], "{report:#}");
        assert_eq!(camera["sequence_gaps"], 0, "{report:#}");
        let measured = camera["fps"].as_f64().unwrap();
        assert!((measured - fps).abs() < 0.01, "{report:#}");
    }
    assert_eq!(report["hid"], serde_json::json!(["PCsensor FootSwitch"]));
}

#[test]
fn clean_run_saves_two_grasps_as_sent() {
    let Some(kernel) = kernel() else { return };
    let images = images::drawn();
    let outcome = run(&kernel, "clean", "clean", images);
    assert_eq!(outcome.exit_code, Some(0), "{outcome}");
    let labels: Vec<_> = outcome.grasps.iter().map(|g| g.record.outcome).collect();
    assert_eq!(labels, [Label::Stable, Label::Slip], "{outcome}");
    for grasp in &outcome.grasps {
        assert_as_sent(grasp, images);
        assert_depth_as_sent(grasp);
    }
    assert_dataset_is_clean(&outcome);
    assert_others_undisturbed(&outcome, &[]);
    assert_eq!(outcome.session("saved"), 2);
    assert_eq!(outcome.session("refused"), 0);
}

#[test]
fn images_of_a_real_sensor_arrive_as_sent() {
    let Some(kernel) = kernel() else { return };
    let Some(images) = images::real() else {
        return;
    };
    let outcome = run(&kernel, "clean", "real-images", &images);
    assert_eq!(outcome.exit_code, Some(0), "{outcome}");
    assert_eq!(outcome.grasps.len(), 2, "{outcome}");
    for grasp in &outcome.grasps {
        assert_as_sent(grasp, &images);
    }
    assert_dataset_is_clean(&outcome);
}

#[test]
fn lost_frames_are_counted() {
    let Some(kernel) = kernel() else { return };
    let outcome = run(&kernel, "frames-lost", "frames-lost", images::drawn());
    assert_one_good_grasp(&outcome, images::drawn());
    assert_eq!(outcome.sent["left"]["error-bit"], 2);
    assert_eq!(outcome.counter("left", "sequence_gaps"), 2, "{outcome}");
    assert_eq!(outcome.counter("right", "sequence_gaps"), 3, "{outcome}");
    assert_eq!(outcome.counter("rgb", "late"), 1, "{outcome}");
    assert_others_undisturbed(&outcome, &["left", "right", "rgb"]);
}

#[test]
fn truncated_images_are_counted_and_never_saved() {
    let Some(kernel) = kernel() else { return };
    let outcome = run(&kernel, "truncated", "truncated", images::drawn());
    assert_one_good_grasp(&outcome, images::drawn());
    for role in ["left", "right"] {
        assert_eq!(outcome.counter(role, "damaged"), 6, "{role}: {outcome}");
    }
    assert_eq!(outcome.session("refused"), 2, "{outcome}");
    assert_others_undisturbed(&outcome, &["left", "right"]);
}

#[test]
fn corrupted_images_are_never_saved() {
    let Some(kernel) = kernel() else { return };
    let outcome = run(&kernel, "corrupted", "corrupted", images::drawn());
    assert_one_good_grasp(&outcome, images::drawn());
    for role in ["left", "right"] {
        assert_eq!(outcome.counter(role, "damaged"), 6, "{role}: {outcome}");
    }
    assert_eq!(outcome.session("refused"), 2, "{outcome}");
    assert_others_undisturbed(&outcome, &["left", "right"]);
}

#[test]
fn frozen_image_is_detected_and_grasp_is_saved_later() {
    let Some(kernel) = kernel() else { return };
    let outcome = run(&kernel, "frozen", "frozen", images::drawn());
    assert_one_good_grasp(&outcome, images::drawn());
    assert_eq!(outcome.sent["left"]["freeze"], 75, "{outcome}");
    assert_eq!(outcome.counter("left", "duplicates"), 75, "{outcome}");
    assert_others_undisturbed(&outcome, &["left"]);
}

#[test]
fn silent_camera_recovers() {
    let Some(kernel) = kernel() else { return };
    let outcome = run(&kernel, "silent", "silent", images::drawn());
    assert_one_good_grasp(&outcome, images::drawn());
    assert_eq!(outcome.sent["left"]["silent"], 75, "{outcome}");
    assert_eq!(outcome.counter("left", "reconnects"), 1, "{outcome}");
    assert_others_undisturbed(&outcome, &["left"]);
}

#[test]
fn sensor_unplugged_while_idle_reconnects() {
    let Some(kernel) = kernel() else { return };
    let outcome = run(&kernel, "replug-idle", "replug-idle", images::drawn());
    assert_one_good_grasp(&outcome, images::drawn());
    assert_eq!(outcome.counter("left", "reconnects"), 1, "{outcome}");
    assert_others_undisturbed(&outcome, &["left"]);
}

#[test]
fn sensor_unplugged_after_initial_keeps_the_initial_frame() {
    let Some(kernel) = kernel() else { return };
    let outcome = run(&kernel, "replug-between", "replug-between", images::drawn());
    assert_one_good_grasp(&outcome, images::drawn());
    assert_eq!(outcome.counter("right", "reconnects"), 1, "{outcome}");
    assert_others_undisturbed(&outcome, &["right"]);
}

#[test]
fn sensor_unplugged_during_save_leaves_complete_grasp() {
    let Some(kernel) = kernel() else { return };
    let outcome = run(
        &kernel,
        "unplug-during-save",
        "unplug-during-save",
        images::drawn(),
    );
    assert_one_good_grasp(&outcome, images::drawn());
    assert_eq!(outcome.grasps[0].record.grasp.trigger, "pedal");
    assert_eq!(outcome.counter("right", "reconnects"), 1, "{outcome}");
    assert_others_undisturbed(&outcome, &["right"]);
}

#[test]
fn roles_follow_serials_rather_than_ports() {
    let Some(kernel) = kernel() else { return };
    let outcome = run(&kernel, "swapped-ports", "swapped-ports", images::drawn());
    assert_one_good_grasp(&outcome, images::drawn());
    assert_others_undisturbed(&outcome, &[]);
}

#[test]
fn full_disk_is_reported_and_keeps_saved_grasps() {
    let Some(kernel) = kernel() else { return };
    let outcome = run(&kernel, "disk-full", "disk-full", images::drawn());
    assert_eq!(outcome.exit_code, Some(3), "{outcome}");
    assert_eq!(outcome.grasps.len(), 1, "{outcome}");
    assert_as_sent(&outcome.grasps[0], images::drawn());
    let overridden = &outcome.grasps[0].record.overridden_guards;
    assert!(
        overridden.iter().all(|g| g.guard == "disk_low"),
        "{overridden:?}"
    );
    assert_eq!(overridden.len(), 2, "{overridden:?}");
    assert_dataset_is_clean(&outcome);
    assert_eq!(outcome.session("failed"), 1, "{outcome}");
}

#[test]
fn read_only_disk_is_reported_and_keeps_saved_grasps() {
    let Some(kernel) = kernel() else { return };
    let outcome = run(&kernel, "read-only", "read-only", images::drawn());
    assert_eq!(outcome.exit_code, Some(3), "{outcome}");
    assert_eq!(outcome.grasps.len(), 1, "{outcome}");
    assert_as_sent(&outcome.grasps[0], images::drawn());
    assert_eq!(outcome.grasps[0].record.outcome, Label::Stable);
    assert_dataset_is_clean(&outcome);
    assert_eq!(outcome.session("failed"), 1, "{outcome}");
    let second = &outcome.second_start;
    assert_eq!(second["exit_code"], 1, "{second:#}");
    let message = second["stderr"].as_str().unwrap();
    assert!(message.contains("read-only"), "{message}");
    assert!(!message.contains("panicked"), "{message}");
}

#[test]
fn bouncing_pedal_triggers_once_per_press() {
    let Some(kernel) = kernel() else { return };
    let outcome = run(&kernel, "pedal-bounce", "pedal-bounce", images::drawn());
    assert_one_good_grasp(&outcome, images::drawn());
    let grasp = &outcome.grasps[0].record;
    assert_eq!(
        [&grasp.initial.trigger, &grasp.grasp.trigger],
        ["pedal", "pedal"]
    );
    assert_eq!(outcome.session("initials"), 1, "{outcome}");
    assert_eq!(outcome.session("saved"), 1, "{outcome}");
}

/// Returns the median memory in a section of the run.
fn median_kib(memory: &[(f64, f64)]) -> f64 {
    let mut kib: Vec<f64> = memory.iter().map(|(_, kib)| *kib).collect();
    kib.sort_by(f64::total_cmp);
    kib[kib.len() / 2]
}

/// `GRIPCAST_SOAK_S` sets the duration: guest and host clocks run at about the same speed.
#[test]
fn random_faults_lose_no_saved_grasp() {
    const SECONDS: u64 = 60;
    const SEED: u64 = 9;
    let Some(kernel) = kernel() else { return };
    let number = |name, otherwise| {
        std::env::var(name).map_or(otherwise, |text| {
            text.parse().unwrap_or_else(|_| panic!("{name}={text}"))
        })
    };
    let seconds = number("GRIPCAST_SOAK_S", SECONDS);
    let seed = number("GRIPCAST_SOAK_SEED", SEED);
    let images = images::drawn();
    let outcome = guest::soak(&kernel, seconds, seed, images);
    assert_eq!(outcome.exit_code, Some(0), "{outcome}");
    assert_dataset_is_clean(&outcome);
    assert_eq!(
        outcome.session("saved"),
        outcome.grasps.len() as u64,
        "{outcome}"
    );
    for grasp in &outcome.grasps {
        assert_complete_as_sent(grasp, images);
    }
    // The last one and, in spite of the faults, some before it.
    assert!(outcome.grasps.len() > 1, "{outcome}");
    let last = outcome.grasps.last().unwrap();
    assert_eq!(last.record.outcome, Label::Stable, "{outcome}");

    let comebacks: Vec<f64> = outcome.came_back_s.values().flatten().copied().collect();
    assert!(
        comebacks.iter().all(|s| *s <= 2.0),
        "{:?}: {outcome}",
        outcome.came_back_s
    );
    let memory = outcome.memory_kib();
    eprintln!(
        "{seconds} s: {} grasps, sent {:?}, cameras back after {:?} s, memory {memory:?} KiB",
        outcome.grasps.len(),
        outcome.sent,
        outcome.came_back_s
    );
    if memory.len() >= 40 {
        // What is allocated once, by the first reconnects, is there after a quarter.
        let quarter = memory.len() / 4;
        let (early, late) = (
            median_kib(&memory[quarter..2 * quarter]),
            median_kib(&memory[memory.len() - quarter..]),
        );
        assert!(late <= 1.05 * early, "{early} KiB became {late} KiB");
    }
}
