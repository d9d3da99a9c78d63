//! Real GelSight images of the shared directory.

use std::path::Path;

use image::RgbImage;

use super::*;
use crate::{CropProfile, Decoder, Frame, PixelFormat, crop_and_resize, decode_png_rgb, jpeg};
use gripcast_testing::shared;

/// Images of gels without contact: five sensors, one with markers.
const BACKGROUNDS: [&str; 5] = [
    "data/fots_ball/no_contact.png",
    "data/gsmini_taxim_ball/nocontact.png",
    "data/gsmini_ai4ce_bg/background.png",
    "data/gsmini_normalflow/background.png",
    "data/gsmini_feats_marker/nocontact_train_sensor.png",
];

fn read(path: &Path) -> RgbImage {
    let image = decode_png_rgb(&std::fs::read(path).unwrap()).unwrap();
    crop_and_resize(&image, &CropProfile::FULL, 320, 240).unwrap()
}

fn backgrounds() -> Option<Vec<RgbImage>> {
    let files = BACKGROUNDS.iter().map(|file| shared(file));
    files.map(|path| Some(read(&path?))).collect()
}

fn change(initial: &RgbImage, now: &RgbImage) -> GelChange {
    let [initial, now] = [initial, now].map(|image| GelCells::new(image).unwrap());
    GelChange::between(&initial, &now, 0.2)
}

#[test]
fn two_sensors_are_not_contact() {
    let Some(gels) = backgrounds() else { return };
    let mut pairs = 0;
    for (i, a) in gels.iter().enumerate() {
        for (j, b) in gels.iter().enumerate().filter(|(j, _)| *j != i) {
            let change = change(a, b);
            let kind = change.kind(MIN_CONTACT_FRACTION);
            let is_marked = i.max(j) == 4;
            let expected = match is_marked {
                true => ChangeKind::OtherGel,
                false => ChangeKind::Illumination,
            };
            assert_eq!(kind, expected, "{i} {j} {change:?}");
            pairs += 1;
        }
    }
    assert_eq!(pairs, 20);
}

#[test]
fn illumination_of_real_gels_is_not_contact() {
    let Some(gels) = backgrounds() else { return };
    type Gain = fn(f32, f32, usize) -> f32;
    let lights: [Gain; 7] = [
        |x, _, _| 1.0 + 0.1 * x,
        |x, _, _| 1.0 - 0.1 * x,
        |_, y, _| 1.0 + 0.1 * y,
        |x, y, _| 1.0 + 0.1 * x * y,
        |_, _, _| 1.2,
        |_, _, _| 0.8,
        |_, _, c| [1.15, 1.0, 0.9][c],
    ];
    for (i, gel) in gels.iter().enumerate() {
        for (j, gain) in lights.iter().enumerate() {
            let mut now = gel.clone();
            for (x, y, pixel) in now.enumerate_pixels_mut() {
                let (x, y) = (x as f32 / 159.5 - 1.0, y as f32 / 119.5 - 1.0);
                for (c, level) in pixel.0.iter_mut().enumerate() {
                    *level = (f32::from(*level) * gain(x, y, c)) as u8;
                }
            }
            let change = change(gel, &now);
            assert_eq!(change.contact_fraction, 0.0, "gel {i} light {j} {change:?}");
        }
    }
}

#[test]
fn real_presses_are_contact() {
    for (folder, initial, prefix, count) in [
        ("data/fots_ball", "no_contact.png", "press_", 28),
        ("data/gsmini_taxim_ball", "nocontact.png", "ball_", 24),
    ] {
        let Some(folder) = shared(folder) else { return };
        let initial = read(&folder.join(initial));
        let mut presses = 0;
        for entry in std::fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            if !path
                .file_name()
                .unwrap()
                .to_str()
                .unwrap()
                .starts_with(prefix)
            {
                continue;
            }
            presses += 1;
            let change = change(&initial, &read(&path));
            let kind = change.kind(MIN_CONTACT_FRACTION);
            assert_eq!(kind, ChangeKind::Contact, "{} {change:?}", path.display());
        }
        assert_eq!(presses, count);
    }
}

#[test]
fn real_gels_have_no_problem() {
    let Some(gels) = backgrounds() else { return };
    for (i, gel) in gels.iter().enumerate() {
        let mut monitor = GelMonitor::default();
        let state = monitor.add(GelCells::new(gel).unwrap(), 0);
        assert_eq!(state.problems, [], "gel {i} {state:?}");
    }
}

#[test]
fn recorded_bad_gels_are_named() {
    use GelProblem::{Black, Drifting, Flickering};
    for (folder, expected) in [
        ("gel-black", &[Black][..]),
        ("gel-flicker", &[Flickering]),
        ("gel-colour-drift", &[Drifting, Flickering]),
    ] {
        let Some(folder) = shared(&format!("field/capture-web/{folder}/left")) else {
            return;
        };
        let mut files: Vec<_> = std::fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .filter(|path| path.extension().is_some_and(|e| e == "jpg"))
            .collect();
        files.sort();
        let mut decoder = Decoder::new().unwrap();
        let mut monitor = GelMonitor::default();
        // The recording is short and repeats.
        for (i, file) in files.iter().cycle().take(60).enumerate() {
            let data = std::fs::read(file).unwrap();
            let header = jpeg::inspect(&data).unwrap();
            let frame = Frame {
                format: PixelFormat::Mjpg,
                width: header.width,
                height: header.height,
                data: data.into(),
                sequence: 0,
                driver_time_ns: 0,
                received_ns: 0,
            };
            let crop = Some(&CropProfile::GSMINI_SEVENTH);
            let image = decoder.decode(&frame, crop, 320, 240).unwrap();
            monitor.add(GelCells::new(&image).unwrap(), i as u64 * 40_000_000);
        }
        let problems = &monitor.state().unwrap().problems;
        let is_named = expected.iter().any(|problem| problems.contains(problem));
        assert!(is_named, "{expected:?}: {:?}", monitor.state());
    }
}
