//! The command `gripcast calibrate intrinsics`.

use std::fs;
use std::path::Path;
use std::process::Command;

use glam::{DQuat, DVec3};
use gripcast_capture::camera::{CameraIdentity, Recorder, StreamInfo};
use gripcast_geometry::Pose;
use gripcast_imaging::{DistortionModel, Frame, Intrinsics, PixelFormat, Role, encode_png_grey8};
use gripcast_pose::BoardFile;
use gripcast_pose::synthetic::{ImageConditions, render_board};
use image::GrayImage;
use image::imageops::flip_horizontal;
use serde_json::Value;

use crate::json_schema::assert_schema;
use crate::program::{gripcast, json, stderr, succeed};

const LENS: Intrinsics = Intrinsics {
    width: 640,
    height: 480,
    fx: 571.0,
    fy: 569.5,
    cx: 325.0,
    cy: 236.0,
    model: DistortionModel::BrownConrady,
    coefficients: [0.05, -0.08, 0.0, 0.0, 0.0],
};

/// Creates a board by `board charuco` in `dir`.
fn board(dir: &Path) -> BoardFile {
    let path = dir.join("c.svg");
    let mut command = gripcast();
    command
        .args(["board", "charuco", "--squares", "8x6", "--square-mm", "28"])
        .arg("--out")
        .arg(path);
    succeed(&mut command);
    BoardFile::load(&dir.join("c.toml")).unwrap()
}

/// Views of a board, tilted in all directions.
fn images(board: &BoardFile) -> Vec<GrayImage> {
    let facing = DQuat::from_rotation_x(std::f64::consts::PI);
    let conditions = ImageConditions {
        noise: 1.0,
        ..ImageConditions::default()
    };
    (0..9u32)
        .map(|k| {
            let azimuth = 0.7 * f64::from(k);
            let axis = DVec3::new(azimuth.cos(), azimuth.sin(), 0.0);
            let tilt = 0.5 * f64::from(u8::from(k > 0));
            let depth = 0.35 + 0.02 * f64::from(k);
            let at = [k % 3, k / 3].map(|c| f64::from(c) - 1.0);
            let at = DVec3::new(0.2 * at[0], 0.15 * at[1], 1.0) * depth;
            let pose = Pose::new(DQuat::from_axis_angle(axis, tilt) * facing, at);
            render_board(&LENS, board, &pose, &conditions, u64::from(k)).image
        })
        .collect()
}

fn save(dir: &Path, name: &str, image: &GrayImage) {
    fs::create_dir_all(dir).unwrap();
    fs::write(dir.join(name), encode_png_grey8(image).unwrap()).unwrap();
}

fn calibrate(dir: &Path, more: &[&str]) -> Command {
    let mut command = gripcast();
    command
        .current_dir(dir)
        .args(["calibrate", "intrinsics", "--board", "c.toml"])
        .args(["--out", "lens.toml", "--json"])
        .args(more);
    command
}

fn count(report: &Value, list: &str) -> usize {
    report[list].as_array().unwrap().len()
}

fn assert_found(dir: &Path) {
    let found = Intrinsics::load(&dir.join("lens.toml")).unwrap();
    assert!((found.fx / LENS.fx - 1.0).abs() < 5e-3, "{found:?}");
    assert!((found.cx - LENS.cx).abs() < 3.0, "{found:?}");
}

#[test]
fn lens_is_calibrated_from_a_folder() {
    let dir = tempfile::tempdir().unwrap();
    let board = board(dir.path());
    let folder = dir.path().join("images");
    let all = images(&board);
    for (k, image) in all.iter().enumerate() {
        save(&folder, &format!("{k}.png"), image);
    }
    let run = || calibrate(dir.path(), &["--images", "images"]);
    let report = json(&succeed(&mut run()));
    assert!(report["rms_px"].as_f64().unwrap() < 0.15, "{report}");
    // Images similar to others are excluded and listed.
    let views = count(&report, "views");
    assert!(views >= 7, "{report}");
    assert_eq!(views + count(&report, "left_out"), all.len());
    assert_found(dir.path());

    fs::write(folder.join("torn.jpg"), [0xff, 0xd8, 0xff]).unwrap();
    save(&folder, "empty.png", &GrayImage::new(640, 480));
    let output = run().output().unwrap();
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(3), "{message}");
    assert!(
        message.contains("torn.jpg") && message.contains("empty.png: no marker"),
        "{message}"
    );
    let some = json(&output);
    let left_out = count(&some, "left_out");
    assert_eq!(left_out, all.len() + 2 - views);
    assert_schema("calibrate intrinsics", &[&report, &some]);

    save(&folder, "z-small.png", &GrayImage::new(320, 240));
    let output = run().output().unwrap();
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(
        message.contains("640×480 first, then z-small.png (320×240)"),
        "{message}"
    );
}

#[test]
fn invalid_images_are_reported() {
    let dir = tempfile::tempdir().unwrap();
    let board = board(dir.path());
    let folder = dir.path().join("images");
    let images = images(&board);
    save(&folder, "0.png", &flip_horizontal(&images[0]));
    let failure = |folder: &str| {
        let output = calibrate(dir.path(), &["--images", folder])
            .output()
            .unwrap();
        (output.status.code(), stderr(&output))
    };
    let (code, message) = failure("images");
    assert!(code == Some(1) && message.contains("mirrored"), "{message}");
    save(&folder, "0.png", &images[0]);
    let (code, message) = failure("images");
    assert!(
        code == Some(1) && message.contains("at least 3 usable views"),
        "{message}"
    );
    let (code, message) = failure("nowhere");
    assert!(code == Some(1) && message.contains("nowhere"), "{message}");
    assert!(!dir.path().join("lens.toml").exists());
}

#[test]
fn lens_is_calibrated_from_a_camera() {
    let dir = tempfile::tempdir().unwrap();
    let board = board(dir.path());
    let info = StreamInfo {
        identity: CameraIdentity::default(),
        format: PixelFormat::Grey,
        width: LENS.width,
        height: LENS.height,
        nominal_fps: 30.0,
        depth_unit_m: None,
    };
    let mut recorder = Recorder::create(dir.path(), Role::External, &info).unwrap();
    // Each view twice: the board must be at rest.
    for (k, image) in images(&board).iter().flat_map(|p| [p, p]).enumerate() {
        let frame = Frame {
            format: info.format,
            width: info.width,
            height: info.height,
            data: image.as_raw().clone().into(),
            sequence: k as u32,
            driver_time_ns: k as u64 * 33_000_000,
            received_ns: k as u64 * 33_000_000,
        };
        recorder.write(&frame).unwrap();
    }
    recorder.finish().unwrap();
    let camera = |role: &str, more: &str| {
        format!(
            "\n[cameras.{role}]\nsource = \"replay\"\npath = \"external\"\nunpaced = true\n\
             format = \"GREY\"\nwidth = 640\nheight = 480\nfps = 30\n{more}"
        )
    };
    // Required tactile cameras, which are not opened.
    let tactile = "crop_profile = \"gsmini-seventh-v1\"\n";
    let rig = [
        "schema = 1\nid = \"r\"\n".to_owned(),
        camera("left", tactile),
        camera("right", tactile),
        camera("external", ""),
    ]
    .concat();
    fs::write(dir.path().join("r.toml"), rig).unwrap();
    let words = ["--rig", "./r.toml", "--keep", "kept"];
    let output = succeed(&mut calibrate(dir.path(), &words));
    assert_found(dir.path());
    assert!(
        stderr(&output).contains("tilt the board"),
        "{}",
        stderr(&output)
    );
    let kept = fs::read_dir(dir.path().join("kept")).unwrap().count();
    assert!(
        kept >= 7 && kept == count(&json(&output), "views"),
        "{kept}"
    );
    let other = ["--rig", "./r.toml", "--camera", "rgb"];
    let output = calibrate(dir.path(), &other).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("choose one with --camera: left, right, external"));
}
