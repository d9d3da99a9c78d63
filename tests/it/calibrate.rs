//! The command `gripcast calibrate`.

use std::fs;
use std::path::Path;
use std::process::Command;

use glam::{DMat3, DQuat, DVec3};
use gripcast_geometry::Pose;
use gripcast_imaging::{Intrinsics, encode_png_grey8, encode_png_rgb};
use gripcast_pose::synthetic::{ImageConditions, PlacedBoard, render, test_camera};
use gripcast_pose::{BoardFile, Body, load_intrinsics};
use gripcast_tactile::force::ForceCalibration;
use gripcast_tactile::{PressDepth, SensorProfile, TactileRenderer};

use crate::json_schema::assert_schema;
use crate::program::{gripcast, json, stderr, succeed};

const TAGS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/calib/boards/gripper-umi.toml");

fn calibrate(words: &str) -> Command {
    let mut command = gripcast();
    command.arg("calibrate").args(words.split_whitespace());
    command
}

/// Exit code and stderr.
fn failure(command: &mut Command) -> (i32, String) {
    let output = command.output().unwrap();
    (output.status.code().unwrap(), stderr(&output))
}

fn camera() -> Intrinsics {
    test_camera(1280, 720)
}

#[test]
fn intrinsics_round_trip_in_all_formats() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    let mut camera = camera();
    camera.model = gripcast_imaging::DistortionModel::BrownConrady;
    camera.coefficients = [1e-7, -1.0 / 3.0, 0.0007, -0.0004, 0.08];
    camera.save(&at("a.toml")).unwrap();
    let mut from = "a.toml";
    let mut all = Vec::new();
    for (to, name) in [("ros", "b.yaml"), ("opencv", "c.yml"), ("toml", "d.toml")] {
        let words = format!(
            "convert {} --to {to} --out {}",
            at(from).display(),
            at(name).display()
        );
        succeed(&mut calibrate(&words));
        assert_eq!(load_intrinsics(&at(name)).unwrap(), camera);
        let shown = json(&succeed(&mut calibrate(&format!(
            "show {} --json",
            at(name).display()
        ))));
        assert_eq!(shown["format"], to);
        assert_eq!(shown["width"], 1280);
        assert_eq!(shown["coefficients"][0], 1e-7);
        all.push(shown);
        from = name;
    }
    assert_schema("calibrate show", &all.iter().collect::<Vec<_>>());
    assert_eq!(
        fs::read(at("a.toml")).unwrap(),
        fs::read(at("d.toml")).unwrap()
    );
}

#[test]
fn invalid_intrinsics_are_rejected() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name).display().to_string();
    camera().save(Path::new(&at("a.toml"))).unwrap();
    let sizeless = "%YAML:1.0\n---\nK: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   \
                    data: [ 900., 0., 640., 0., 900., 360., 0., 0., 1. ]\n\
                    D: !!opencv-matrix\n   rows: 1\n   cols: 4\n   dt: d\n   data: [ 0., 0., 0., 0. ]\n";
    fs::write(at("k.yml"), sizeless).unwrap();
    fs::write(at("no.yaml"), "hello\n").unwrap();
    let out = at("o");
    for (words, code, expected) in [
        (format!("show {}", at("missing.yaml")), 1, "missing.yaml"),
        (
            format!("show {}", at("no.yaml")),
            1,
            "unknown camera file format",
        ),
        (format!("show {}", at("k.yml")), 1, "--size 1280x720"),
        (format!("show {} --size 12,7", at("k.yml")), 2, "640x480"),
        (
            format!("show {} --size 640x480", at("a.toml")),
            1,
            "1280×720",
        ),
        (
            format!("convert {} --to xml --out {out}", at("a.toml")),
            2,
            "opencv",
        ),
        (
            format!(
                "convert {} --to ros --camera-name a:b --out {out}",
                at("a.toml")
            ),
            2,
            "letters, digits",
        ),
        (
            format!(
                "convert {} --to ros --out /proc/nonexistent/o",
                at("a.toml")
            ),
            1,
            "/proc/nonexistent/o",
        ),
    ] {
        let (found, message) = failure(&mut calibrate(&words));
        assert_eq!(found, code, "{words}: {message}");
        assert!(message.contains(expected), "{words}: {message}");
    }
    let words = format!(
        "convert {} --size 1280x720 --to toml --out {out}",
        at("k.yml")
    );
    succeed(&mut calibrate(&words));
    assert_eq!(load_intrinsics(Path::new(&out)).unwrap().fx, 900.0);
}

/// Images of the gripper from its front, the first two with closed fingers.
fn photograph(folder: &Path, count: u32) {
    let board = BoardFile::load(Path::new(TAGS)).unwrap();
    for i in 0..count {
        let along = f64::from(i) / f64::from(count - 1);
        let (a, e) = (1.4 * along - 0.7, 0.35 + 0.35 * (5.0 * along).sin());
        let towards = DVec3::new(a.sin() * e.cos(), -a.cos() * e.cos(), -e.sin());
        let z = -towards;
        let x = z.cross(DVec3::NEG_Z).normalize();
        let axes = DMat3::from_cols(x, z.cross(x), z);
        let roll = DQuat::from_rotation_z(0.3 * (9.0 * along).cos());
        let eye = DVec3::new(0.0, -0.03, -0.12) + towards * 0.45;
        let t_camera_gripper = Pose::new(DQuat::from_mat3(&axes) * roll, eye).inverse();
        let opening = if i < 2 {
            0.0
        } else {
            0.07 * (0.5 + 0.5 * (7.0 * along).sin())
        };
        let placed = [
            (Body::Gripper, 0.0),
            (Body::FingerLeft, -0.5),
            (Body::FingerRight, 0.5),
        ];
        let placed = placed.map(|(body, by)| PlacedBoard {
            board: &board.board,
            body,
            dictionary: &board.dictionary,
            t_camera_body: t_camera_gripper * Pose::from_translation(DVec3::X * (by * opening)),
        });
        let image = render(
            &camera(),
            &placed,
            &ImageConditions::default(),
            u64::from(i),
        );
        let name = folder.join(format!("{i:02}.png"));
        fs::write(name, encode_png_grey8(&image.image).unwrap()).unwrap();
    }
}

#[test]
fn tags_are_calibrated_from_a_folder() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name).display().to_string();
    let photos = dir.path().join("photos");
    fs::create_dir(&photos).unwrap();
    photograph(&photos, 10);
    camera().save(Path::new(&at("camera.toml"))).unwrap();
    let run = |more: &str| {
        calibrate(&format!(
            "gripper --tags {TAGS} --intrinsics {} --images {} --out {} {more}",
            at("camera.toml"),
            photos.display(),
            at("gripper.toml")
        ))
    };
    let report = json(&succeed(&mut run("--closed 00.png 01 --json")));
    assert_schema("calibrate gripper", &[&report]);
    assert_eq!(report["images"], 10);
    assert_eq!(report["opening_zero_from"], "fingers");
    assert!(report["rms_px"].as_f64().unwrap() < 0.15, "{report}");
    let calibrated = BoardFile::load(Path::new(&at("gripper.toml"))).unwrap();
    assert_eq!(calibrated.board.name, "gripper-umi-calibrated");
    assert_eq!(report["hash"], calibrated.board.hash());
    let described = BoardFile::load(Path::new(TAGS)).unwrap();
    for (a, b) in calibrated
        .board
        .markers
        .iter()
        .zip(&described.board.markers)
    {
        assert_eq!((a.id, a.body), (b.id, b.body));
        assert!(a.center_m().distance(b.center_m()) < 5e-4, "{}", a.id);
    }

    // A damaged image is skipped and named.
    fs::write(photos.join("99.jpg"), [0xff, 0xd8, 0xff, 0x00]).unwrap();
    let (code, message) = failure(&mut run("--closed 00.png"));
    assert_eq!(code, 3, "{message}");
    assert!(
        message.contains("99.jpg is not used") && message.contains("1 images"),
        "{message}"
    );
    let (code, message) = failure(&mut run("--closed 0.png"));
    assert_eq!(code, 2);
    assert!(message.contains("00.png"), "{message}");

    // Of another size.
    let small = image::GrayImage::new(640, 480);
    fs::write(photos.join("98.png"), encode_png_grey8(&small).unwrap()).unwrap();
    let (code, message) = failure(&mut run(""));
    assert_eq!(code, 1);
    assert!(
        message.contains("98.png") && message.contains("640×480"),
        "{message}"
    );
}

#[test]
fn images_without_tags_are_reported() {
    let dir = tempfile::tempdir().unwrap();
    let photos = dir.path().join("photos");
    fs::create_dir(&photos).unwrap();
    let small = test_camera(640, 360);
    let intrinsics = dir.path().join("camera.toml");
    small.save(&intrinsics).unwrap();
    let run = |tags: &str| {
        let words = format!(
            "gripper --tags {tags} --intrinsics {} --images {} --out {}",
            intrinsics.display(),
            photos.display(),
            dir.path().join("o.toml").display()
        );
        failure(&mut calibrate(&words))
    };
    let (code, message) = run(TAGS);
    assert_eq!(code, 1);
    assert!(message.contains("no .png or .jpg"), "{message}");
    let blank = image::GrayImage::new(640, 360);
    fs::write(photos.join("a.png"), encode_png_grey8(&blank).unwrap()).unwrap();
    let (code, message) = run(TAGS);
    assert_eq!(code, 1);
    assert!(
        message.contains("no marker of any known dictionary"),
        "{message}"
    );
    let (code, message) = run("/proc/nonexistent/tags.toml");
    assert_eq!(code, 1);
    assert!(message.contains("/proc/nonexistent/tags.toml"), "{message}");
    assert!(!dir.path().join("o.toml").exists());
}

/// Writes images of an untouched gel and of a ball of 10 mm radius at three depths.
fn write_presses(dir: &Path) {
    let profile = SensorProfile::gelsight_mini().unwrap();
    let mut renderer = TactileRenderer::new(&profile).unwrap();
    let geometry = renderer.geometry();
    for (seed, (name, depth_m)) in [("open", -1.0), ("a", 4e-4), ("b", 6e-4), ("c", 1e-3)]
        .into_iter()
        .enumerate()
    {
        let mut press = PressDepth::untouched(geometry);
        for (at, depth) in press.depth_m.iter_mut().enumerate() {
            let (column, row) = (at % geometry.width, at / geometry.width);
            let [x, y] = geometry.pixel_to_gel_m(column as f64, row as f64);
            *depth = (depth_m - (x * x + y * y) / 0.02).max(0.0) as f32;
        }
        let image = renderer
            .render(&press, &profile.drift.sample(seed as u64))
            .unwrap();
        let png = encode_png_rgb(&image).unwrap();
        fs::write(dir.join(format!("{name}.png")), png).unwrap();
    }
}

#[test]
fn force_is_calibrated_with_weights() {
    let dir = tempfile::tempdir().unwrap();
    write_presses(dir.path());
    let at = |name: &str| dir.path().join(name).display().to_string();
    let words = |presses: [&str; 3], forces: &str| {
        let presses = presses.map(at).join(",");
        format!(
            "force --initial {} --press {presses} {forces} --serial A1 --out {}",
            at("open.png"),
            at("left.toml")
        )
    };
    // Forces of the ball on a gel of 1 MPa and Poisson's ratio 0.3 by converged finite elements.
    let rising = ["a.png", "b.png", "c.png"];
    let shown = json(&succeed(&mut calibrate(&words(
        rising,
        "--force-n 2.083,4.417,11.879 --json",
    ))));
    assert_schema("calibrate force", &[&shown]);
    let young_pa = shown["young_pa"].as_f64().unwrap();
    assert!((0.4e6..2e6).contains(&young_pa), "{shown}");
    let stored = ForceCalibration::load(&dir.path().join("left.toml")).unwrap();
    assert_eq!((stored.serial.as_str(), stored.presses.len()), ("A1", 3));
    assert_eq!(stored.young_pa, young_pa);

    let weights = "--weights-g 200,500,1200";
    let text = String::from_utf8(succeed(&mut calibrate(&words(rising, weights))).stdout).unwrap();
    assert!(
        text.contains("MPa") && text.contains("force_calibration"),
        "{text}"
    );
    let falling = ["c.png", "b.png", "a.png"];
    let (code, text) = failure(&mut calibrate(&words(falling, weights)));
    assert_eq!(code, 1, "{text}");
    assert!(text.contains("shows less force"), "{text}");
    let (code, text) = failure(&mut calibrate(&words(rising, "--weights-g 200,500")));
    assert_eq!(code, 2, "{text}");
    assert!(text.contains("3 images"), "{text}");
    let untouched = ["open.png", "b.png", "c.png"];
    let (code, text) = failure(&mut calibrate(&words(untouched, weights)));
    assert_eq!(code, 1, "{text}");
    assert!(text.contains("no contact"), "{text}");
}
