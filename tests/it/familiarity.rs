//! Out-of-distribution scores of the shipped classifier on real tactile images.
//!
//! The outcomes of real lifts are unknown, so the tests only check whether such images count as
//! in distribution.

use std::path::{Path, PathBuf};

use gripcast_imaging::{CropProfile, TactileDifference, crop_and_resize, decode_png_rgb};
use gripcast_nn::predict::{Model, SHIPPED};
use image::RgbImage;

use gripcast_testing::shared;

/// Real frames of three sensors that touch nothing.
const NO_CONTACT: [&str; 3] = [
    "data/gsmini_taxim_ball/nocontact.png",
    "data/gsmini_normalflow/background.png",
    "data/gsmini_ai4ce_bg/background.png",
];

fn image(path: &Path) -> RgbImage {
    let image = decode_png_rgb(&std::fs::read(path).unwrap()).unwrap();
    crop_and_resize(&image, &CropProfile::FULL, 320, 240).unwrap()
}

/// Sorted PNG files of a directory whose names start with `prefix`.
fn images(folder: &Path, prefix: &str) -> Vec<PathBuf> {
    let all = std::fs::read_dir(folder).unwrap();
    let mut found: Vec<PathBuf> = all.map(|entry| entry.unwrap().path()).collect();
    found.retain(|path| {
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        name.starts_with(prefix) && name.ends_with(".png")
    });
    found.sort();
    found
}

/// Out-of-distribution score of each grasp image relative to `initial`.
fn ood_scores(initial: &Path, grasps: &[PathBuf]) -> Vec<f64> {
    let model = Model::by_name(SHIPPED).unwrap();
    let detector = model.ood_detector().unwrap();
    let initial = image(initial);
    let score = |grasp: &PathBuf| {
        let difference = TactileDifference::between(&initial, &image(grasp)).unwrap();
        detector.score(&difference).unwrap()
    };
    grasps.iter().map(score).collect()
}

fn fraction_ood(scores: &[f64]) -> f64 {
    scores.iter().filter(|score| **score > 1.0).count() as f64 / scores.len() as f64
}

/// The presses come from the sensor that the simulated profile was fitted to, so this checks the
/// threshold for that sensor. No presses of another Mini without markers are available; only the
/// no-contact frames below come from other sensors.
#[test]
fn real_presses_of_a_gelsight_mini_are_in_distribution() {
    let Some(folder) = shared("data/gsmini_taxim_ball") else {
        return;
    };
    let open = folder.join("nocontact.png");
    let presses = images(&folder, "ball_");
    assert!(presses.len() >= 24);
    let found = ood_scores(&open, &presses);
    eprintln!(
        "false positives: {:.3} of {}",
        fraction_ood(&found),
        found.len()
    );
    assert!(fraction_ood(&found) <= 0.05, "{found:.2?}");
    for item in NO_CONTACT {
        let Some(open) = shared(item) else { return };
        let still = ood_scores(&open, std::slice::from_ref(&open));
        assert!(still[0] <= 1.0, "{item}: {still:.2?}");
    }
}

#[test]
fn initial_frame_of_another_sensor_is_ood() {
    let Some(opens) = NO_CONTACT
        .map(shared)
        .into_iter()
        .collect::<Option<Vec<_>>>()
    else {
        return;
    };
    for (at, initial) in opens.iter().enumerate() {
        let others: Vec<PathBuf> = [&opens[..at], &opens[at + 1..]].concat();
        let found = ood_scores(initial, &others);
        assert!(
            fraction_ood(&found) == 1.0,
            "{}: {found:.2?}",
            initial.display()
        );
    }
}

#[test]
fn gel_with_markers_is_ood() {
    let Some(folder) = shared("data/gsmini_feats_marker") else {
        return;
    };
    let open = folder.join("nocontact_train_sensor.png");
    let found = ood_scores(&open, &[folder.join("cuboid_10-2-284.png")]);
    assert!(found[0] > 1.0, "{found:.2?}");
}

#[test]
fn gel_of_other_colours_is_ood() {
    let Some(folder) = shared("data/fots_ball") else {
        return;
    };
    let found = ood_scores(&folder.join("no_contact.png"), &images(&folder, "press_"));
    assert!(found.len() >= 28);
    assert!(fraction_ood(&found) >= 0.95, "{found:.2?}");
}
