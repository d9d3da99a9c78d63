//! Detection in images with known corners.

use glam::DVec2;
use image::{GrayImage, Luma};
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64;

use super::*;
use crate::synthetic::{
    GraspScene, ImageConditions, SyntheticImage, gripper_markers, ring_board, test_camera,
};
use crate::{Body, Detection, Dictionary, MarkerDetector as _};

fn dictionary(name: &str) -> Dictionary {
    Dictionary::by_name(name).unwrap()
}

fn every_id(dictionary: &Dictionary) -> Vec<u32> {
    (0..dictionary.len() as u32).collect()
}

fn image(dictionary: &Dictionary, index: u64) -> SyntheticImage {
    let board = ring_board(dictionary);
    let gripper = gripper_markers(dictionary, [Body::Gripper; 2]);
    let scene = GraspScene::random(&board, &gripper, dictionary, 3, index);
    scene.render(&test_camera(1280, 720), &ImageConditions::default(), index)
}

fn detector(dictionary: &Dictionary, ids: &[u32]) -> ApriltagDetector {
    ApriltagDetector::new(dictionary, ids, ApriltagSettings::default()).unwrap()
}

fn corner_errors(found: &[Detection], truth: &[Detection]) -> Vec<DVec2> {
    let pair = |t: &Detection| {
        let d = found.iter().find(|d| d.id == t.id)?;
        Some(
            (0..4)
                .map(|i| d.corners_px[i] - t.corners_px[i])
                .collect::<Vec<_>>(),
        )
    };
    truth.iter().filter_map(pair).flatten().collect()
}

#[test]
fn detects_all_dictionaries_without_pixel_offset() {
    for name in [
        "36h11",
        "DICT_APRILTAG_36h11",
        "36h11_border2",
        "DICT_6X6_250",
        "DICT_5X5_100",
        "DICT_4X4_1000",
        "DICT_7X7_1000",
        "DICT_ARUCO_MIP_36h12",
        "DICT_APRILTAG_36h10",
        "36h10_border2",
    ] {
        let searched = dictionary(name);
        let rendered = image(&searched, 1);
        assert!(rendered.truth.len() >= 12, "{}", rendered.truth.len());
        let found = detector(&searched, &every_id(&searched))
            .detect(&rendered.image)
            .unwrap();
        for truth in &rendered.truth {
            assert!(
                found.iter().any(|d| d.id == truth.id),
                "{} {}",
                name,
                truth.id
            );
        }
        let errors = corner_errors(&found, &rendered.truth);
        // Another pixel convention would shift all corners by half a pixel.
        let bias = errors.iter().sum::<DVec2>() / errors.len() as f64;
        assert!(bias.length() < 0.03, "{} {bias}", name);
        let worst = errors.iter().map(|e| e.length()).fold(0.0, f64::max);
        assert!(worst < 0.5, "{} {worst}", name);
    }
}

#[test]
fn reports_whitelisted_ids_only() {
    let searched = dictionary("36h11");
    let rendered = image(&searched, 1);
    let allowed = [3, 5, 41, 5, 500];
    let found = detector(&searched, &allowed)
        .detect(&rendered.image)
        .unwrap();
    let ids: Vec<u32> = found.iter().map(|d| d.id).collect();
    let expected: Vec<u32> = rendered
        .truth
        .iter()
        .map(|d| d.id)
        .filter(|id| allowed.contains(id))
        .collect();
    assert!(!expected.is_empty());
    // A marker that is occluded at its edge may be detected as well.
    assert!(expected.iter().all(|id| ids.contains(id)), "{ids:?}");
    assert!(ids.iter().all(|id| allowed.contains(id)), "{ids:?}");
    for (ids, expected) in [
        (&[][..], "no marker ids"),
        (&[2, 587][..], "id 587 is not in"),
    ] {
        let result = ApriltagDetector::new(&searched, ids, ApriltagSettings::default());
        let text = result.err().unwrap().to_string();
        assert!(text.contains(expected), "{text}");
    }
}

#[test]
fn corrects_one_bit_in_large_distance_dictionaries() {
    for (name, expected) in [("DICT_6X6_250", Some(1)), ("DICT_4X4_50", None)] {
        let dictionary = dictionary(name);
        let rendered = image(&dictionary, 2);
        let id = rendered.truth[0].id;
        let mut codes: Vec<u64> = (0..50).map(|id| dictionary.code(id).unwrap()).collect();
        codes[id as usize] ^= 1 << 6;
        let side = dictionary.bits_per_side();
        let wrong = Dictionary::from_codes(name, side, 1, codes).unwrap();
        let hamming = |dictionary: &Dictionary| {
            let found = detector(dictionary, &[id]).detect(&rendered.image).unwrap();
            found.first().map(|d| d.hamming)
        };
        assert_eq!(hamming(&dictionary), Some(0), "{name}");
        assert_eq!(hamming(&wrong), expected, "{name}");
    }
}

#[test]
fn survives_noise_patterns_and_extreme_sizes() {
    let searched = dictionary("36h11");
    let mut random = Pcg64::seed_from_u64(9);
    for decimate in [1, 2, 4] {
        let settings = ApriltagSettings {
            decimate,
            ..ApriltagSettings::default()
        };
        let mut detector = ApriltagDetector::new(&searched, &[0, 1, 2], settings).unwrap();
        for (width, height) in [(0, 0), (31, 300), (1, 16_385)] {
            let error = detector.detect(&GrayImage::new(width, height)).unwrap_err();
            assert!(error.to_string().contains("each side"), "{error}");
        }
        for (width, height) in [(32, 32), (33, 47), (2001, 32), (64, 3001), (321, 243)] {
            let blank = GrayImage::from_pixel(width, height, Luma([128]));
            assert!(detector.detect(&blank).unwrap().is_empty());
            let noise = GrayImage::from_fn(width, height, |_, _| Luma([random.random::<u8>()]));
            detector.detect(&noise).unwrap();
            let checks = GrayImage::from_fn(width, height, |x, y| {
                Luma([if (x / 5 + y / 5) % 2 == 0 { 255 } else { 0 }])
            });
            detector.detect(&checks).unwrap();
        }
    }
    let settings = ApriltagSettings {
        decimate: 0,
        ..ApriltagSettings::default()
    };
    assert!(ApriltagDetector::new(&searched, &[0], settings).is_err());
}

#[test]
fn detects_low_contrast_markers_with_and_without_noise() {
    let searched = dictionary("36h11");
    let board = ring_board(&searched);
    let gripper = gripper_markers(&searched, [Body::Gripper; 2]);
    let scene = GraspScene::random(&board, &gripper, &searched, 3, 1);
    for (levels, noise) in [([40.0, 22.0, 30.0], 0.5), ([120.0, 60.0, 90.0], 5.0)] {
        let conditions = ImageConditions {
            levels,
            noise,
            ..ImageConditions::default()
        };
        let rendered = scene.render(&test_camera(1280, 720), &conditions, 5);
        let found = detector(&searched, &every_id(&searched))
            .detect(&rendered.image)
            .unwrap();
        let missed = rendered
            .truth
            .iter()
            .filter(|truth| found.iter().all(|d| d.id != truth.id));
        assert!(missed.count() <= 1, "{levels:?} {}", found.len());
    }
}
