//! Calibration on rendered presses recovers the rendering parameters.

use std::fs;
use std::path::Path;

use image::{Rgb, RgbImage};
use serde_json::{Value, json};

use super::*;
use crate::calibrate::{BallContact, LabelledPress, change_between, score, score_profile};
use crate::{FrameNoise, TactileRenderer};
use crate::{NormalOrder, PositionOrder, SensorGeometry, Smoothing};
use gripcast_base::error::ErrorKind;
use gripcast_imaging::encode_png_rgb;

const GEOMETRY: SensorGeometry = SensorGeometry {
    width: 160,
    height: 120,
    pixel_m: 1e-4,
    gel_thickness_m: 4e-3,
};
const BALL_M: f64 = 2.5e-3;

/// A sensor with known shading that varies along x.
fn truth() -> SensorProfile {
    let no_contact = RgbImage::from_fn(160, 120, |x, y| {
        Rgb([90 + (x / 4) as u8, 120 - (y / 4) as u8, 100 + (y / 5) as u8])
    });
    SensorProfile {
        frame_rate_hz: None,
        gel: ProfileGel::default(),
        markers: None,
        schema: SCHEMA,
        name: "made up".to_owned(),
        serial: String::new(),
        crop_profile: CropProfile::FULL,
        provenance: "made up".to_owned(),
        noise_std: [1.0; 3],
        geometry: GEOMETRY,
        smoothing: Smoothing {
            sink_length_m: 1e-3,
            sigma_m: 1e-4,
        },
        drift: Drift::default(),
        shading: ShadingModel::Polynomial(PolynomialShading {
            normal: NormalOrder::Linear,
            position: PositionOrder::Linear,
            steepest: 1.0,
            red: vec![0.0, 0.0, 0.0, -70.0, -20.0, 0.0, 10.0, 0.0, 0.0],
            green: vec![60.0, 0.0, 10.0, 35.0, 0.0, 0.0, 10.0, 0.0, 0.0],
            blue: vec![-60.0, 15.0, 0.0, 35.0, 0.0, 0.0, 10.0, 0.0, 0.0],
        }),
        background: Background {
            file: None,
            fit: BackgroundFit::from_image(&no_contact, 2),
            image: Some(no_contact),
        },
        fitted_to: Vec::new(),
    }
}

fn contact(i: usize) -> BallContact {
    BallContact {
        geometry: GEOMETRY,
        centre_px: [45.0 + (i * 29 % 71) as f64, 40.0 + (i * 17 % 43) as f64],
        radius_px: 11.0 + (i % 4) as f64,
        ball_m: BALL_M,
    }
}

fn image(i: usize) -> RgbImage {
    let noise = FrameNoise {
        gain: [1.03, 0.98, 1.0],
        offset: [-2.0, 1.0, 0.5],
        noise_seed: Some(i as u64),
    };
    let press = contact(i).press(truth().smoothing.sink_length_m);
    let mut renderer = TactileRenderer::new(&truth()).unwrap();
    renderer.render(&press, &noise).unwrap()
}

fn save(path: &Path, image: &RgbImage) {
    fs::write(path, encode_png_rgb(image).unwrap()).unwrap();
}

/// A folder of `count` presses; `change` may alter the list before it is written.
fn folder(count: usize, change: impl FnOnce(&Path, &mut Value)) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    save(
        &folder.path().join("no_contact.png"),
        truth().background.image.as_ref().unwrap(),
    );
    let mut presses = Vec::new();
    for i in 0..count {
        let file = format!("press_{i}.png");
        save(&folder.path().join(&file), &image(i));
        let contact = contact(i);
        presses.push(json!({
            "file": file, "center_px": contact.centre_px, "radius_px": contact.radius_px,
        }));
    }
    let mut list = json!({
        "no_contact": "no_contact.png", "ball_diameter_m": 2.0 * BALL_M, "m_per_px": 1e-4,
        "presses": presses,
    });
    change(folder.path(), &mut list);
    if !list.is_null() {
        fs::write(folder.path().join("presses.json"), list.to_string()).unwrap();
    }
    folder
}

fn options(folder: &tempfile::TempDir) -> CalibrateOptions {
    CalibrateOptions {
        name: "made-up".to_owned(),
        ..CalibrateOptions::from_folder(folder.path())
    }
}

#[test]
fn known_shading_is_recovered() {
    let folder = folder(10, |_, _| ());
    let result = run(&options(&folder)).unwrap();
    let report = &result.report;
    assert_eq!((report.fitted, report.held_out), (5, 5));
    assert!(report.score.fve > 0.97, "{report:?}");
    assert!(report.score.patch_psnr_db > 35.0, "{report:?}");
    assert!(report.score.no_contact_psnr_db < 30.0);
    assert!(result.report.skipped.is_empty());
    // Gain and offset are the rendered ones; the noise is that of one frame (the no-contact image
    // has none, so the difference is divided by √2).
    let fit = report.fit.as_ref().unwrap();
    assert!((fit.gain_mean[0] - 1.03).abs() < 0.02, "{report:?}");
    assert!((fit.noise_std[0] - 0.75).abs() < 0.2, "{report:?}");
    assert_eq!(result.image.width() % 4, 0);
    result.profile.validate().unwrap();
    // Deterministic, and depends on the split.
    assert_eq!(run(&options(&folder)).unwrap().profile, result.profile);
    let other = CalibrateOptions {
        split: Split::Random {
            train_fraction: 0.5,
            max_fitted: None,
            seed: 5,
        },
        ..options(&folder)
    };
    assert_ne!(run(&other).unwrap().report.score, report.score);
}

#[test]
fn contacts_are_detected_without_labels() {
    let folder = folder(4, |_, list| *list = Value::Null);
    let mut read = ReadOptions::from_folder(folder.path());
    let text = PressSet::read(&read).unwrap_err().to_string();
    assert!(text.contains("ball"), "{text}");
    read.ball_diameter_m = Some(2.0 * BALL_M);
    read.pixel_m = Some(1e-4);
    let set = PressSet::read(&read).unwrap();
    assert_eq!(set.presses.len(), 4, "{:?}", set.skipped);
    for (i, press) in set.presses.iter().enumerate() {
        let known = contact(i);
        let [x, y] = [0, 1].map(|k| press.centre_px[k] - known.centre_px[k]);
        assert!(x.hypot(y) < 1.0, "{press:?}");
        assert!((press.radius_px - known.radius_px).abs() < 2.0, "{press:?}");
    }
}

#[test]
fn leds_are_fitted() {
    let folder = folder(8, |_, _| ());
    let options = CalibrateOptions {
        model: ModelChoice::Leds,
        ..options(&folder)
    };
    let result = run(&options).unwrap();
    assert_eq!(result.report.model, "leds");
    assert!(result.report.score.fve > 0.6, "{:?}", result.report.score);
}

#[test]
fn unusable_presses_are_skipped_with_reason() {
    let folder = folder(9, |path, list| {
        save(
            &path.join("press_1.png"),
            &RgbImage::from_pixel(160, 120, Rgb([255; 3])),
        );
        save(&path.join("press_2.png"), &RgbImage::new(80, 60));
        save(
            &path.join("press_3.png"),
            &RgbImage::from_fn(160, 120, |x, y| {
                Rgb([(x * 7 % 251) as u8, (y * 5 % 241) as u8, 9])
            }),
        );
        save(
            &path.join("press_4.png"),
            truth().background.image.as_ref().unwrap(),
        );
        fs::remove_file(path.join("press_5.png")).unwrap();
        let presses = list["presses"].as_array_mut().unwrap();
        presses[6]["center_px"] = json!([155.0, 400.0]);
        presses[7]["radius_px"] = Value::Null;
        presses[8]["radius_px"] = json!(40.0);
    });
    let read = ReadOptions::from_folder(folder.path());
    let set = PressSet::read(&read).unwrap();
    assert_eq!(set.presses.len(), 1);
    let expected = [
        "saturated",
        "80×60",
        "another sensor",
        "nothing changes",
        "cannot read",
        "off the image",
        "invalid label",
        "ball's radius",
    ];
    for (skipped, expected) in set.skipped.iter().zip(expected) {
        assert!(skipped.reason.contains(expected), "{skipped:?}");
    }
    let error = run(&options(&folder)).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Input);
    assert!(error.to_string().contains("at least 2"), "{error}");
}

#[test]
fn unusable_folder_is_explained() {
    let empty = tempfile::tempdir().unwrap();
    let missing = CalibrateOptions::from_folder(empty.path().join("nowhere"));
    assert_eq!(run(&missing).unwrap_err().kind(), ErrorKind::NotFound);
    let text = run(&options(&empty)).unwrap_err().to_string();
    assert!(text.contains("no_contact.png"), "{text}");
    fs::write(empty.path().join("presses.json"), "{\"presses\": [NaN]}").unwrap();
    let text = run(&options(&empty)).unwrap_err().to_string();
    assert!(text.contains("presses.json"), "{text}");
    let none = folder(0, |_, _| ());
    let text = run(&options(&none)).unwrap_err().to_string();
    assert!(text.contains("none of 0"), "{text}");
    let tiny = folder(1, |_, list| list["ball_diameter_m"] = json!(4.7));
    let text = run(&options(&tiny)).unwrap_err().to_string();
    assert!(text.contains("found 4700 mm"), "{text}");
    for fraction in [0.0, -1.0, 1.5, f64::NAN] {
        let options = CalibrateOptions {
            split: Split::Random {
                train_fraction: fraction,
                max_fitted: None,
                seed: 0,
            },
            ..options(&tiny)
        };
        assert_eq!(run(&options).unwrap_err().kind(), ErrorKind::Usage);
    }
}

#[test]
fn perfect_and_empty_renderer_have_defined_scores() {
    let mut renderer = TactileRenderer::new(&truth()).unwrap();
    let free = truth().background.image.unwrap();
    let presses = (0..3)
        .map(|i| LabelledPress {
            number: i + 1,
            sha256: String::new(),
            file: i.to_string(),
            image: {
                let press = contact(i).press(1e-3);
                renderer.render(&press, &FrameNoise::default()).unwrap()
            },
            centre_px: contact(i).centre_px,
            radius_px: contact(i).radius_px,
            is_detected: false,
        })
        .collect();
    let set = super::super::press_set::test_set(GEOMETRY, BALL_M, free.clone(), presses);
    let nothing = score(&set, &[0, 1, 2], &mut |_| {
        Ok(std::array::from_fn(|_| vec![0.0; 160 * 120]))
    })
    .unwrap();
    assert_eq!(nothing.fve, 0.0);
    assert_eq!(nothing.patch_l1, nothing.no_contact_l1);
    let perfect = score(&set, &[0, 1, 2], &mut |contact| {
        let press = contact.press(1e-3);
        let image = renderer.render(&press, &FrameNoise::default())?;
        Ok(change_between(&image, &free))
    })
    .unwrap();
    assert!(perfect.fve > 0.995, "{perfect:?}");
}

fn named(train: &[&str], test: &[&str]) -> Split {
    let words = |names: &[&str]| names.iter().map(|&name| name.to_owned()).collect();
    Split::Named {
        train: words(train),
        test: words(test),
    }
}

/// Numbers of the presses of a role.
fn numbers(report: &CalibrationReport, role: Role) -> Vec<usize> {
    let rows = report.presses.iter().filter(|row| row.role == role);
    rows.map(|row| row.number).collect()
}

#[test]
fn named_presses_are_fitted_and_scored() {
    let folder = folder(8, |_, _| ());
    let of = |split: Split| {
        run(&CalibrateOptions {
            split,
            ..options(&folder)
        })
    };
    let result = of(named(&["press_0.png", "2-4", "press_5"], &["7"])).unwrap();
    let report = &result.report;
    assert_eq!(numbers(report, Role::Fitted), [1, 2, 3, 4, 6]);
    assert_eq!(numbers(report, Role::HeldOut), [7]);
    assert_eq!(report.unused, ["press_4.png", "press_7.png"]);
    assert_eq!(report.scored_on, Role::HeldOut);
    assert_eq!(report.score.fve, report.presses[5].score.fve);
    let train = report.train.as_ref().unwrap();
    assert!(train.fve > 0.9 && report.score.fve > 0.9, "{report:?}");
    let files = result.profile.fitted_to.iter().map(|press| &*press.file);
    let fitted = [
        "press_0.png",
        "press_1.png",
        "press_2.png",
        "press_3.png",
        "press_5.png",
    ];
    assert_eq!(files.collect::<Vec<_>>(), fitted);
    // An empty list means all others.
    let report = of(named(&["1-6"], &[])).unwrap().report;
    assert_eq!(numbers(&report, Role::HeldOut), [7, 8]);
    let report = of(named(&[], &["1-6"])).unwrap().report;
    assert_eq!(numbers(&report, Role::Fitted), [7, 8]);
    for (split, expected) in [
        (named(&["1-6"], &["6-7"]), "press_5.png is named both"),
        (named(&["9"], &[]), "`9` names none of the 8 presses"),
        (named(&["4-2"], &[]), "`4-2`"),
        (named(&["press_9.png"], &[]), "press_0.png to press_7.png"),
        (named(&[], &[]), "no press is named"),
    ] {
        let error = of(split).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Usage);
        assert!(error.to_string().contains(expected), "{error}");
    }
}

#[test]
fn unusable_press_to_score_is_not_replaced_by_fitted_ones() {
    let folder = folder(5, |path, _| {
        fs::remove_file(path.join("press_4.png")).unwrap()
    });
    let of = |split: Split| {
        run(&CalibrateOptions {
            split,
            ..options(&folder)
        })
    };
    let text = of(named(&["1-4"], &["5"])).unwrap_err().to_string();
    assert!(
        text.contains("none of 1 presses") && text.contains("press_4.png"),
        "{text}"
    );
    // Nor does a press that is not named make the result partial.
    assert!(
        of(named(&["1-3"], &["4"]))
            .unwrap()
            .report
            .skipped
            .is_empty()
    );
    let report = of(named(&["1-3"], &["4-5"])).unwrap().report;
    assert_eq!((report.skipped[0].number, report.held_out), (5, 1));
    let text = of(named(&["1", "5"], &["4"])).unwrap_err().to_string();
    assert!(text.contains("found 1; 1 unusable (press_4.png"), "{text}");
}

#[test]
fn existing_profile_is_scored_without_fitting() {
    let folder = folder(6, |_, _| ());
    let read = ReadOptions::from_folder(folder.path());
    let (report, image) = score_profile(&truth(), &read, &[]).unwrap();
    assert!(report.score.fve > 0.97, "{report:?}");
    assert_eq!((report.fitted, report.held_out), (0, 6));
    assert_eq!(report.scored_on, Role::Unknown);
    assert!(report.fit.is_none() && image.width() > 4);
    assert!(
        report.notes[0].contains("does not record its presses"),
        "{report:?}"
    );
    // A fitted profile knows its presses: they are left out of the means.
    let fitted = run(&CalibrateOptions {
        split: named(&["1-4"], &[]),
        ..options(&folder)
    });
    let fitted = fitted.unwrap();
    let (report, _) = score_profile(&fitted.profile, &read, &[]).unwrap();
    assert_eq!(numbers(&report, Role::Fitted), [1, 2, 3, 4]);
    assert_eq!(report.score.fve, fitted.report.score.fve);
    assert!(
        report.notes[0].contains("left out of the means"),
        "{report:?}"
    );
    let (report, _) = score_profile(&fitted.profile, &read, &["2".to_owned()]).unwrap();
    assert_eq!(report.scored_on, Role::Fitted);
    assert!(report.notes[0].contains("flatter"), "{report:?}");
    assert_eq!(report.unused.len(), 5);
    // The grid is that of the profile; another aspect ratio is refused.
    let mut turned = truth();
    (turned.geometry.width, turned.geometry.height) = (120, 160);
    let text = score_profile(&turned, &read, &[]).unwrap_err().to_string();
    assert!(text.contains("stretches"), "{text}");
    // A profile of another sensor explains nothing.
    let mut other = truth();
    if let ShadingModel::Polynomial(shading) = &mut other.shading {
        std::mem::swap(&mut shading.red, &mut shading.blue);
    }
    let (report, _) = score_profile(&other, &read, &[]).unwrap();
    let notes = report.notes.join("\n");
    assert!(notes.contains("explains little"), "{notes}");
}

#[test]
fn doubtful_scales_are_noted() {
    let folder = folder(4, |_, list| list["m_per_px"] = Value::Null);
    let mut options = options(&folder);
    options.read.ball_diameter_m = Some(4.0 * BALL_M);
    let report = run(&options).unwrap().report;
    assert!(
        report.notes[0].contains("replaces that of presses.json"),
        "{report:?}"
    );
    assert!(report.notes[1].contains("pass --pixel-mm"), "{report:?}");
    let row = &report.presses[0];
    let (ball, radius) = (2.0 * BALL_M, row.radius_px * report.pixel_m);
    let depth = ball - (ball * ball - radius * radius).sqrt();
    assert!((row.indentation_m - depth).abs() < 1e-9, "{row:?}");
}

#[test]
fn listed_images_are_ordered_by_number() {
    let dir = tempfile::tempdir().unwrap();
    for i in [10, 9, 1] {
        save(&dir.path().join(format!("{i}.png")), &image(i));
    }
    save(
        &dir.path().join("bg.png"),
        truth().background.image.as_ref().unwrap(),
    );
    let mut read = ReadOptions::from_folder(dir.path());
    (read.ball_diameter_m, read.pixel_m) = (Some(2.0 * BALL_M), Some(1e-4));
    let set = PressSet::read(&read).unwrap();
    let files = set.presses.iter().map(|press| &*press.file);
    assert_eq!(files.collect::<Vec<_>>(), ["1.png", "9.png", "10.png"]);
}
