//! `gripcast tactile track` on folders, videos of a stand-in for ffmpeg, and invalid recordings.

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::Output;

use gripcast_base::files::npy;
use gripcast_imaging::{GelContact, encode_png_rgb, gel_image};
use image::RgbImage;
use serde_json::Value;

use crate::json_schema::assert_schema;
use crate::program::{gripcast, stderr};

/// A gel with dots 30 px apart that moved by `shift` px; pressed where they did.
fn gel(shift: [f32; 2], seed: u64) -> RgbImage {
    let contact = GelContact {
        centre_x: 0.5,
        centre_y: 0.5,
        radius: 0.35,
        strength: if shift == [0.0; 2] { 0.0 } else { 0.8 },
    };
    let mut image = gel_image(320, 240, seed, contact);
    for (x, y, pixel) in image.enumerate_pixels_mut() {
        let offset = |at: f32| (at + 15.0).rem_euclid(30.0) - 15.0;
        let distance = offset(x as f32 - 12.0 - shift[0]).hypot(offset(y as f32 - 14.0 - shift[1]));
        let darkness = 0.66 * ((8.0 - distance) / 4.0).clamp(0.0, 1.0);
        pixel.0 = pixel
            .0
            .map(|level| (f32::from(level) * (1.0 - darkness)) as u8);
    }
    image
}

/// Frames of a gel that is pressed and released.
fn frames() -> Vec<RgbImage> {
    let shifts = [0.0, 3.0, 6.0, 9.0, 4.0, 0.0, 0.0];
    let image = |(i, shift): (usize, &f32)| gel([*shift, -0.5 * shift], i as u64);
    shifts.iter().enumerate().map(image).collect()
}

fn folder(dir: &Path) -> PathBuf {
    let folder = dir.join("frames");
    fs::create_dir(&folder).unwrap();
    for (i, image) in frames().iter().enumerate() {
        // Sorted by value, not by letter: 8, 9, 10, 11, …
        let name = format!("f{}.png", i + 8);
        fs::write(folder.join(name), encode_png_rgb(image).unwrap()).unwrap();
    }
    folder
}

fn track(recording: &Path, more: &[&str]) -> Output {
    let mut command = gripcast();
    command.args(["tactile", "track"]).arg(recording).args(more);
    command.output().unwrap()
}

fn summary(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout).unwrap_or_else(|_| panic!("{}", stderr(output)))
}

#[test]
fn a_folder_becomes_csv_parquet_and_npy_with_an_overlay() {
    let dir = tempfile::tempdir().unwrap();
    let recording = folder(dir.path());
    let path = |name: &str| dir.path().join(name).display().to_string();
    let (csv, strip) = (path("out.csv"), path("strip.png"));
    let more = [
        "--out",
        &csv,
        "--overlay",
        &strip,
        "--m-per-px",
        "3e-5",
        "--json",
    ];
    let output = track(&recording, &more);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let report = summary(&output);
    assert_eq!(report["source"], "markers");
    assert_eq!(report["frames"], 7);
    assert_eq!(report["tracked_fraction"], 1.0);
    assert!(
        (report["pitch_px"].as_f64().unwrap() - 30.0).abs() < 0.3,
        "{report}"
    );
    let largest = report["max_displacement_px"].as_f64().unwrap();
    assert!((largest - 9.0_f64.hypot(4.5)).abs() < 1.0, "{report}");
    assert!(
        report["return_drift_px"].as_f64().unwrap() < 0.2,
        "{report}"
    );
    assert!(fs::metadata(&strip).unwrap().len() > 10_000);
    let markerless = track(
        &recording,
        &["--out", &csv, "--profile", "gelsight-mini", "--json"],
    );
    let problems = &summary(&markerless)["problems"];
    assert!(
        problems.to_string().contains("the sensor profile has none"),
        "{problems}"
    );
    assert_schema("tactile track", &[&report, &summary(&markerless)]);

    let text = fs::read_to_string(&csv).unwrap();
    let mut lines = text.lines();
    let header: Vec<&str> = lines.next().unwrap().split(',').collect();
    let column = |name: &str| header.iter().position(|column| *column == name).unwrap();
    let rows: Vec<Vec<&str>> = lines.map(|line| line.split(',').collect()).collect();
    let dx = |frame: &str| -> Vec<f64> {
        let rows = rows.iter().filter(|row| row[0] == frame);
        rows.map(|row| row[column("dx_px")].parse().unwrap())
            .collect()
    };
    let (third, last) = (dx("3"), dx("6"));
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    assert!((mean(&third) - 9.0).abs() < 0.2, "{}", mean(&third));
    assert!(mean(&last).abs() < 0.1, "{}", mean(&last));

    let array = path("out.npy");
    assert!(track(&recording, &["--out", &array]).status.success());
    let array = npy::Array::from_npy(&fs::read(&array).unwrap()).unwrap();
    let [rows, columns] = ["rows", "columns"].map(|key| report[key].as_u64().unwrap() as usize);
    assert_eq!(array.shape(), [7, rows, columns, 5]);
    let parquet = path("out.parquet");
    assert!(track(&recording, &["--out", &parquet]).status.success());
    assert!(fs::read(&parquet).unwrap().starts_with(b"PAR1"));
}

#[test]
fn the_last_frame_can_be_the_initial_one() {
    let dir = tempfile::tempdir().unwrap();
    let recording = folder(dir.path());
    for i in 8..11 {
        fs::remove_file(recording.join(format!("f{i}.png"))).unwrap();
    }
    let out = dir.path().join("out.csv").display().to_string();
    let output = track(&recording, &["--initial", "last", "--out", &out, "--json"]);
    let report = summary(&output);
    assert_eq!(report["frames"], 4);
    let largest = report["max_displacement_px"].as_f64().unwrap();
    assert!((largest - 9.0_f64.hypot(4.5)).abs() < 1.0, "{report}");
    let beyond = track(&recording, &["--initial", "4", "--out", &out]);
    assert_eq!(beyond.status.code(), Some(2));
    assert!(
        stderr(&beyond).contains("there are 4 frames"),
        "{}",
        stderr(&beyond)
    );
}

#[test]
fn damaged_and_resized_frames_are_left_out_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let recording = folder(dir.path());
    fs::write(recording.join("f10.png"), b"no image").unwrap();
    let small = image::imageops::thumbnail(&gel([2.0, 0.0], 3), 160, 120);
    fs::write(recording.join("f12.png"), encode_png_rgb(&small).unwrap()).unwrap();
    let out = dir.path().join("out.csv").display().to_string();
    let output = track(&recording, &["--out", &out, "--json"]);
    assert_eq!(output.status.code(), Some(3), "{}", stderr(&output));
    let report = summary(&output);
    assert_eq!(report["frames"], 5);
    let left_out = report["left_out_frames"].as_array().unwrap();
    assert_eq!(left_out.len(), 2);
    assert_eq!(left_out[0]["name"], "f10.png");
    assert!(
        left_out[1]["why"].as_str().unwrap().contains("160×120"),
        "{report}"
    );
}

/// The recorded image without contact is of another unit than the one with the cuboid: its dots are
/// smaller and the whole lattice stands elsewhere.
#[test]
fn recorded_image_of_another_sensor_is_left_out() {
    let Some(folder) = gripcast_testing::shared("data/gsmini_feats_marker") else {
        return;
    };
    let dir = tempfile::tempdir().unwrap();
    let recording = dir.path().join("recording");
    fs::create_dir(&recording).unwrap();
    for (i, name) in ["nocontact_train_sensor.png", "cuboid_10-2-284.png"]
        .iter()
        .enumerate()
    {
        fs::copy(folder.join(name), recording.join(format!("{i}.png"))).unwrap();
    }
    let out = dir.path().join("out.csv").display().to_string();
    let output = track(&recording, &["--out", &out, "--json"]);
    assert_eq!(output.status.code(), Some(3), "{}", stderr(&output));
    let report = summary(&output);
    let why = report["left_out_frames"][0]["why"].as_str().unwrap();
    assert!(why.contains("another sensor or scale"), "{report}");
}

#[test]
fn recordings_without_frames_and_invalid_scales_are_explained() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out.csv").display().to_string();
    let empty = track(dir.path(), &["--out", &out]);
    assert_eq!(empty.status.code(), Some(1));
    assert!(
        stderr(&empty).contains("no .png or .jpg images"),
        "{}",
        stderr(&empty)
    );
    let recording = folder(dir.path());
    for scale in ["nan", "0", "-1"] {
        let output = track(&recording, &["--out", &out, "--m-per-px", scale]);
        assert_eq!(
            output.status.code(),
            Some(2),
            "{scale}: {}",
            stderr(&output)
        );
    }
    let suffix = track(&recording, &["--out", "out.txt"]);
    assert_eq!(suffix.status.code(), Some(2));
    assert!(!Path::new(&out).exists());
}

/// Tracks a video with a stand-in for ffmpeg that runs `script`.
fn track_video(dir: &Path, script: Option<&str>) -> Output {
    let video = dir.join("finger.avi");
    fs::write(&video, b"RIFF").unwrap();
    let programs = dir.join("programs");
    fs::create_dir_all(&programs).unwrap();
    if let Some(script) = script {
        let program = programs.join("ffmpeg");
        fs::write(&program, format!("#!/bin/sh\n{script}\n")).unwrap();
        fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
    }
    let mut command = gripcast();
    command.env("PATH", format!("{}:/bin:/usr/bin", programs.display()));
    if script.is_none() {
        command.env("PATH", &programs);
    }
    command.args(["tactile", "track"]).arg(&video);
    command
        .arg("--out")
        .arg(dir.join("video.csv"))
        .arg("--json");
    command.output().unwrap()
}

#[test]
fn videos_come_from_ffmpeg_and_its_complaints_are_reported() {
    let dir = tempfile::tempdir().unwrap();
    let missing = track_video(dir.path(), None);
    assert_eq!(missing.status.code(), Some(1));
    assert!(
        stderr(&missing).contains("apt install ffmpeg"),
        "{}",
        stderr(&missing)
    );

    let mut stream = Vec::new();
    for image in frames() {
        stream.extend(b"P6\n320 240\n255\n");
        stream.extend(image.as_raw());
    }
    let ppm = dir.path().join("frames.ppm");
    fs::write(&ppm, &stream).unwrap();
    let whole = track_video(dir.path(), Some(&format!("cat {}", ppm.display())));
    assert_eq!(whole.status.code(), Some(0), "{}", stderr(&whole));
    assert_eq!(summary(&whole)["frames"], 7);

    let complain = format!("cat {}; echo 'bitstream error' >&2", ppm.display());
    let damaged = track_video(dir.path(), Some(&complain));
    assert_eq!(damaged.status.code(), Some(3), "{}", stderr(&damaged));
    let report = summary(&damaged);
    assert!(
        report["damage"]
            .as_str()
            .unwrap()
            .contains("bitstream error"),
        "{report}"
    );

    for (message, code) in [
        ("[avi] [warning] Packet corrupt (stream = 0, dts = 77).", 3),
        ("[swscaler] [warning] deprecated pixel format used", 0),
    ] {
        let script = format!("cat {}; echo '{message}' >&2", ppm.display());
        let output = track_video(dir.path(), Some(&script));
        assert_eq!(output.status.code(), Some(code), "{message}");
    }

    fs::write(&ppm, &stream[..stream.len() - 1000]).unwrap();
    let cut = track_video(dir.path(), Some(&format!("cat {}", ppm.display())));
    assert_eq!(cut.status.code(), Some(3), "{}", stderr(&cut));
    assert_eq!(summary(&cut)["frames"], 6);

    let nothing = track_video(dir.path(), Some("echo 'moov atom not found' >&2; exit 1"));
    assert_eq!(nothing.status.code(), Some(1));
    assert!(
        stderr(&nothing).contains("moov atom not found"),
        "{}",
        stderr(&nothing)
    );
}
