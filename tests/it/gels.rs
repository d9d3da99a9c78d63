//! Bad images of gels: the check of a rig, a collection and a prediction name them.

use std::path::{Path, PathBuf};

use image::RgbImage;

use crate::program::{collect_on, gripcast, json, script, stderr, succeed};
use gripcast_imaging::{GelContact, encode_jpeg, encode_png_rgb, gel_image};
use gripcast_testing::shared;

/// Frames of a recording: 4.8 s.
const FRAMES: u64 = 120;

fn gel(i: u64, strength: f32) -> RgbImage {
    let contact = GelContact {
        centre_x: 0.45,
        centre_y: 0.5,
        radius: 0.15,
        strength,
    };
    gel_image(640, 480, i, contact)
}

fn scaled(image: &RgbImage, gain: impl Fn(f32) -> [f32; 3]) -> RgbImage {
    let mut image = image.clone();
    let width = image.width() as f32;
    for (x, _, pixel) in image.enumerate_pixels_mut() {
        let gain = gain(x as f32 / width * 2.0 - 1.0);
        for (level, gain) in pixel.0.iter_mut().zip(gain) {
            *level = (f32::from(*level) * gain + 0.5) as u8;
        }
    }
    image
}

/// Writes a rig whose gels play images; the left one is `left`, the right one good.
fn rig(dir: &Path, left: impl Fn(u64) -> RgbImage) -> PathBuf {
    let mut rig = "schema = 1\nid = \"gels\"\n".to_owned();
    let right = |i: u64| gel(1000 + i, 0.0);
    for (role, image) in [
        ("left", &left as &dyn Fn(u64) -> RgbImage),
        ("right", &right),
    ] {
        let folder = dir.join(role);
        std::fs::create_dir(&folder).unwrap();
        for i in 0..FRAMES {
            let jpeg = encode_jpeg(&image(i), 85).unwrap();
            std::fs::write(folder.join(format!("{i:06}.jpg")), jpeg).unwrap();
        }
        rig += &format!(
            "\n[cameras.{role}]\nsource = \"replay\"\npath = \"{role}\"\nformat = \"MJPG\"\n\
             width = 640\nheight = 480\nfps = 25\ncrop_profile = \"gsmini-seventh-v1\"\n"
        );
    }
    let file = dir.join("rig.toml");
    std::fs::write(&file, rig).unwrap();
    file
}

fn flicker(i: u64) -> RgbImage {
    scaled(&gel(i, 0.0), |_| [if i % 4 < 2 { 1.0 } else { 0.8 }; 3])
}

#[test]
fn rig_check_names_bad_gels() {
    let black = |i: u64| scaled(&gel(i, 0.0), |_| [0.02; 3]);
    let drift = |i: u64| scaled(&gel(i, 0.0), |_| [1.0 + 0.003 * i as f32, 1.0, 1.0]);
    let good = |i: u64| gel(i, 0.0);
    let cases: [(&str, &dyn Fn(u64) -> RgbImage); 4] = [
        ("black", &black),
        ("flickering", &flicker),
        ("drifting", &drift),
        ("", &good),
    ];
    for (problem, image) in cases {
        let dir = tempfile::tempdir().unwrap();
        let rig = rig(dir.path(), image);
        let mut check = gripcast();
        check.args(["rig", "check", "--seconds", "2", "--json", "--rig"]);
        let output = check.arg(&rig).output().unwrap();
        let report = json(&output);
        let [left, right] = [0, 1].map(|i| report["cameras"][i]["gel"].clone());
        let expected: &[&str] = if problem.is_empty() { &[] } else { &[problem] };
        assert_eq!(left["problems"], serde_json::json!(expected), "{report}");
        assert_eq!(right["problems"], serde_json::json!([]), "{report}");
        assert!(right["noise_levels"].as_f64().unwrap() < 1.0, "{report}");
        assert_eq!(output.status.success(), problem.is_empty(), "{report}");
    }
}

#[test]
fn flickering_gel_is_refused_at_the_initial_frame() {
    let dir = tempfile::tempdir().unwrap();
    let rig = rig(dir.path(), flicker);
    let steps = "stop-on-refusal\nwait live\nsleep 2\ntrigger\nwait saved\nquit\n";
    let mut collect = collect_on(&rig, &script(dir.path(), steps), &dir.path().join("d"));
    let output = collect.output().unwrap();
    assert!(!output.status.success());
    let told = stderr(&output);
    assert!(
        told.contains("left: brightness or colour flickers"),
        "{told}"
    );
    assert!(!told.contains("right: brightness"), "{told}");
}

/// Saves the images of a grasp and predicts it.
fn predicted(model: &str, images: [&RgbImage; 4]) -> serde_json::Value {
    let dir = tempfile::tempdir().unwrap();
    let mut predict = gripcast();
    predict.args([
        "predict",
        "images",
        "--already-cropped",
        "--json",
        "--model",
        model,
    ]);
    let flags = [
        "--initial-left",
        "--initial-right",
        "--grasp-left",
        "--grasp-right",
    ];
    for (flag, image) in flags.into_iter().zip(images) {
        let file = dir.path().join(format!("{flag}.png"));
        std::fs::write(&file, encode_png_rgb(image).unwrap()).unwrap();
        predict.arg(flag).arg(file);
    }
    let rgb = dir.path().join("rgb.png");
    std::fs::write(&rgb, encode_png_rgb(&RgbImage::new(320, 240)).unwrap()).unwrap();
    if model == "gripcast-vt" {
        predict.arg("--rgb").arg(rgb);
    }
    json(&succeed(&mut predict))
}

#[test]
fn illumination_is_unsure_and_contact_is_predicted() {
    let [left, right] = [gel(1, 0.0), gel(2, 0.0)];
    for model in ["baseline-contact", "gripcast-vt"] {
        for gain in [
            (|x| [1.0 + 0.1 * x; 3]) as fn(f32) -> [f32; 3],
            |_| [1.2; 3],
            |_| [0.8; 3],
            |_| [1.2, 1.0, 0.85],
        ] {
            let [now_left, now_right] = [scaled(&gel(3, 0.0), gain), scaled(&gel(4, 0.0), gain)];
            let report = predicted(model, [&left, &right, &now_left, &now_right]);
            assert_eq!(report["predicted"], "unsure", "{report}");
            let reason = report["unsure_reason"].as_str().unwrap();
            assert!(reason.contains("the light on the left gel"), "{report}");
        }
        let report = predicted(model, [&left, &right, &gel(3, 0.8), &gel(4, 0.8)]);
        assert!(report["unsure_reason"].is_null(), "{report}");
        let one = predicted(model, [&left, &right, &gel(3, 0.8), &gel(4, 0.0)]);
        assert_ne!(one["predicted"], "stable", "{one}");
    }
    let both = predicted(
        "baseline-contact",
        [&left, &right, &gel(3, 0.8), &gel(4, 0.8)],
    );
    assert_eq!(both["predicted"], "stable", "{both}");
}

#[test]
fn backgrounds_of_two_sensors_are_unsure() {
    let files = [
        "data/gsmini_taxim_ball/nocontact.png",
        "data/gsmini_ai4ce_bg/background.png",
        "data/gsmini_normalflow/background.png",
        "data/gsmini_feats_marker/nocontact_train_sensor.png",
    ];
    let images: Option<Vec<RgbImage>> = files
        .iter()
        .map(|file| Some(image::open(shared(file)?).unwrap().to_rgb8()))
        .collect();
    let Some(images) = images else { return };
    for (i, initial) in images.iter().enumerate() {
        for now in images.iter().skip(i + 1) {
            let report = predicted("baseline-contact", [initial, initial, now, now]);
            assert_eq!(report["predicted"], "unsure", "{report}");
        }
    }
}
