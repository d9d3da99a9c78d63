//! Calibration of a sensor.

use std::fs;
use std::path::{Path, PathBuf};

use gripcast_imaging::encode_png_rgb;
use gripcast_tactile::calibrate::BallContact;
use gripcast_tactile::{FrameNoise, SensorProfile, TactileRenderer};
use serde_json::{Value, json as value};

use super::{png, refused, render};
use crate::json_schema::assert_schema;
use crate::program::{json, succeed};
use gripcast_testing::shared;

/// Presses of a 4 mm ball rendered with the built-in profile.
pub(super) fn rendered_presses(dir: &Path) -> PathBuf {
    let folder = dir.join("ball");
    fs::create_dir(&folder).unwrap();
    let profile = SensorProfile::gelsight_mini().unwrap();
    let mut renderer = TactileRenderer::new(&profile).unwrap();
    let grid = profile.geometry;
    let save = |name: &str, image: &image::RgbImage| {
        fs::write(folder.join(name), encode_png_rgb(image).unwrap()).unwrap();
    };
    let mut presses = Vec::new();
    let radius_px = 1.2e-3 / grid.pixel_m;
    for number in 0..8_u64 {
        let centre = [
            90.0 + 45.0 * (number % 4) as f64,
            80.0 + 75.0 * (number / 4) as f64,
        ];
        let contact = BallContact {
            geometry: grid,
            centre_px: centre,
            radius_px,
            ball_m: 2e-3,
        };
        let press = contact.press(profile.smoothing.sink_length_m);
        let noise = FrameNoise {
            noise_seed: Some(number),
            ..FrameNoise::default()
        };
        let name = format!("press_{number}.png");
        save(&name, &renderer.render(&press, &noise).unwrap());
        presses.push(value!({"file": name, "center_px": centre, "radius_px": radius_px}));
    }
    let nothing = gripcast_tactile::PressDepth::untouched(grid);
    let noise = FrameNoise {
        noise_seed: Some(99),
        ..FrameNoise::default()
    };
    save(
        "no_contact.png",
        &renderer.render(&nothing, &noise).unwrap(),
    );
    let list = value!({
        "no_contact": "no_contact.png",
        "sensor": "rendered",
        "image_size_hw": [grid.height, grid.width],
        "ball_diameter_m": 4e-3,
        "m_per_px": grid.pixel_m,
        "label_origin": "known",
        "presses": presses,
    });
    fs::write(folder.join("presses.json"), list.to_string()).unwrap();
    folder
}

fn calibrate(folder: &Path, flags: &str) -> Value {
    let words = format!("--presses {} --json {flags}", folder.display());
    json(&succeed(&mut render("calibrate", &words)))
}

#[test]
fn calibration_recovers_rendered_sensor() {
    let dir = tempfile::tempdir().unwrap();
    let folder = rendered_presses(dir.path());
    let out = dir.path().join("sensor.toml");
    let report = calibrate(&folder, &format!("--serial AB12 --out {}", out.display()));
    let scored = calibrate(&folder, &format!("--profile {}", out.display()));
    assert_schema("render calibrate", &[&report, &scored]);
    assert_eq!(report["held_out"], 4);
    let fve = report["fve"].as_f64().unwrap();
    assert!(fve > 0.95, "{fve}");
    assert!(
        report["patch_psnr_db"].as_f64().unwrap() > report["no_contact_psnr_db"].as_f64().unwrap()
    );
    let profile = SensorProfile::load(&out).unwrap();
    assert_eq!(profile.serial, "AB12");
    assert!(profile.background.image.is_some());
    assert!(png(out.with_extension("fit.png")).width() > 320);
    // The profile works in `render tactile`.
    let image = dir.path().join("p.png");
    let words = format!(
        "--object builtin:sphere --profile {} --out {}",
        out.display(),
        image.display()
    );
    succeed(&mut render("tactile", &words));
    assert_eq!(png(image).dimensions(), (320, 240));
}

#[test]
fn named_presses_and_existing_profiles_are_scored() {
    let dir = tempfile::tempdir().unwrap();
    let folder = rendered_presses(dir.path());
    let out = dir.path().join("sensor.toml");
    let report = calibrate(
        &folder,
        &format!(
            "--train 1-3,press_4 --test 8 press_5.png --out {}",
            out.display()
        ),
    );
    let roles = |report: &Value| -> Vec<(u64, String)> {
        let rows = report["presses"].as_array().unwrap().iter();
        let row = |row: &Value| {
            let role = row["role"].as_str().unwrap().to_owned();
            (row["number"].as_u64().unwrap(), role)
        };
        rows.map(row).collect()
    };
    let fitted = [1, 2, 3, 5].map(|number| (number, "fitted".to_owned()));
    let scored = [6, 8].map(|number| (number, "held_out".to_owned()));
    let mut all = [&fitted[..], &scored[..]].concat();
    all.sort();
    assert_eq!(roles(&report), all);
    assert_eq!(report["unused"], value!(["press_3.png", "press_6.png"]));
    // The profile knows its presses.
    let image = dir.path().join("scored.png");
    let words = format!("--profile {} --out {}", out.display(), image.display());
    let report = calibrate(&folder, &words);
    assert_eq!(
        (&report["fitted"], &report["held_out"]),
        (&value!(4), &value!(4))
    );
    assert!(report["fve"].as_f64().unwrap() > 0.9, "{report}");
    assert!(png(image).width() > 320);
    let report = calibrate(&folder, "--profile gelsight-mini --test 1");
    assert_eq!(report["scored_on"], "held_out");
    assert!(report["fve"].as_f64().unwrap() > 0.9, "{report}");
    for (words, expected) in [
        ("--profile gelsight-mini --train 1", "--train"),
        ("--train 1 --seed 3 --out a.toml", "--seed"),
        ("--train 9 --out a.toml", "names none of the 8 presses"),
        (
            "--train 1,2 --test 2 --out a.toml",
            "both to fit and to score",
        ),
        ("--train 1,2", "--out"),
    ] {
        let words = format!("--presses {} {words}", folder.display());
        let (code, message) = refused(&mut render("calibrate", &words));
        assert_eq!(code, 2, "{message}");
        assert!(message.contains(expected), "{expected}: {message}");
    }
}

#[test]
fn unusable_presses_are_reported() {
    let dir = tempfile::tempdir().unwrap();
    let folder = rendered_presses(dir.path());
    let out = dir.path().join("s.toml").display().to_string();
    let presses = folder.display();
    let nowhere = dir.path().join("nowhere");
    let (code, message) = refused(&mut render(
        "calibrate",
        &format!("--presses {} --out {out}", nowhere.display()),
    ));
    assert_eq!(code, 1, "{message}");
    let (code, message) = refused(&mut render(
        "calibrate",
        &format!("--presses {presses} --train-fraction 0 --out {out}"),
    ));
    assert_eq!(code, 2, "{message}");
    // One press of another sensor: the others are fitted and the exit code is 3.
    let other = image::RgbImage::from_pixel(320, 240, image::Rgb([250, 10, 200]));
    fs::write(folder.join("press_3.png"), encode_png_rgb(&other).unwrap()).unwrap();
    let (code, message) = refused(&mut render(
        "calibrate",
        &format!("--presses {presses} --out {out}"),
    ));
    assert_eq!(code, 3, "{message}");
    assert!(message.contains("press_3.png"), "{message}");
}

#[test]
fn real_presses_reach_measured_fve() {
    let Some(folder) = shared("data/fots_ball") else {
        return;
    };
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("s.toml").display().to_string();
    let half = calibrate(&folder, &format!("--out {out}"));
    // Measured 0.949.
    assert!(half["fve"].as_f64().unwrap() >= 0.93, "{}", half["fve"]);
    assert!(half["patch_psnr_db"].as_f64().unwrap() >= 26.0);
    let five = calibrate(&folder, &format!("--max-fitted 5 --out {out}"));
    assert_eq!(five["fitted"], 5);
    assert!(five["fve"].as_f64().unwrap() >= 0.70, "{}", five["fve"]);
}
