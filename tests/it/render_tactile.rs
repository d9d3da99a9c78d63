//! Calibration of the tactile renderer on real presses.

use gripcast_tactile::SensorProfile;
use gripcast_tactile::calibrate::{CalibrateOptions, CalibrationReport, Split, run};

use gripcast_testing::shared;

fn fots(max_fitted: Option<usize>, seed: u64) -> Option<CalibrationReport> {
    let options = CalibrateOptions {
        split: Split::Random {
            train_fraction: 0.5,
            max_fitted,
            seed,
        },
        ..CalibrateOptions::from_folder(shared("data/fots_ball")?)
    };
    Some(run(&options).unwrap().report)
}

#[test]
fn half_of_the_presses_explain_the_rest() {
    let Some(report) = fots(None, 0) else { return };
    assert_eq!((report.fitted, report.held_out), (14, 14));
    assert!(report.score.fve >= 0.92, "{:?}", report.score);
    assert!(report.score.patch_psnr_db >= 29.0, "{:?}", report.score);
    // PSNR of the background alone.
    assert!((report.score.no_contact_psnr_db - 17.5).abs() < 0.3);
}

#[test]
fn five_presses_reach_usable_fve() {
    let Some(report) = fots(Some(5), 1) else {
        return;
    };
    assert_eq!(report.fitted, 5);
    assert!(report.score.fve >= 0.88, "{:?}", report.score);
}

#[test]
fn contacts_of_real_mini_are_detected() {
    let Some(folder) = shared("data/gsmini_taxim_ball") else {
        return;
    };
    let mut options = CalibrateOptions::from_folder(folder);
    options.read.ball_diameter_m = Some(4e-3);
    options.read.size = Some((320, 240));
    options.read.find_contacts = true;
    let result = run(&options).unwrap();
    assert!(
        result.report.skipped.is_empty(),
        "{:?}",
        result.report.skipped
    );
    assert_eq!(result.report.contacts_found, 24);
    assert!(result.report.score.fve >= 0.92, "{:?}", result.report.score);
    let shipped = SensorProfile::gelsight_mini().unwrap();
    assert_eq!(shipped.background.image, result.profile.background.image);
}

#[test]
fn press_in_place_of_the_no_contact_image_is_found() {
    let Some(folder) = shared("data/fots_ball") else {
        return;
    };
    let dir = tempfile::tempdir().unwrap();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        std::fs::copy(&path, dir.path().join(path.file_name().unwrap())).unwrap();
    }
    let [press, free] = ["press_0010.png", "no_contact.png"].map(|name| dir.path().join(name));
    std::fs::copy(press, free).unwrap();
    let error = run(&CalibrateOptions::from_folder(dir.path())).unwrap_err();
    assert!(error.to_string().contains("it shows a contact"), "{error}");
}
