//! The detector against pictures with known corners.

use glam::DVec2;
use image::{GrayImage, Luma};
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64;

use super::*;
use crate::pose::synthetic::{GraspScene, PictureConditions, SyntheticPicture, gripper_markers, ring_board, test_camera};
use crate::pose::{Detection, MarkerDetector as _, Part};

/// Codes of 6×6 cells that differ from each other in every orientation by `min_distance` bits.
fn random_family(count: usize, min_distance: u32) -> MarkerFamily {
    let mut random = Pcg64::seed_from_u64(6);
    let turned = |code: u64, by: u32| {
        let bits = 9 * by;
        ((code << bits) | (code >> (36 - bits))) & ((1 << 36) - 1)
    };
    let mut codes: Vec<u64> = Vec::new();
    while codes.len() < count {
        let code = random.random::<u64>() & ((1 << 36) - 1);
        let far = |other: u64, from: u32| {
            (from..4).all(|by| (code ^ turned(other, by)).count_ones() >= min_distance)
        };
        if far(code, 1) && codes.iter().all(|other| far(*other, 0)) {
            codes.push(code);
        }
    }
    MarkerFamily {
        name: "RANDOM_6X6".into(),
        bits_per_side: 6,
        codes,
        min_distance,
        corrected_bits: 1,
    }
}

fn every_id(family: &MarkerFamily) -> Vec<u32> {
    (0..family.codes.len() as u32).collect()
}

fn picture(family: &MarkerFamily, index: u64) -> SyntheticPicture {
    let board = ring_board(&family.name);
    let gripper = gripper_markers(&family.name, [Part::Body; 2]);
    let scene = GraspScene::random(&board, &gripper, family, 3, index);
    scene.render(&test_camera(1280, 720), &PictureConditions::default(), index)
}

fn detector(family: &MarkerFamily, ids: &[u32]) -> ApriltagDetector {
    ApriltagDetector::new(family, ids, ApriltagSettings::default()).unwrap()
}

fn corner_errors(found: &[Detection], truth: &[Detection]) -> Vec<DVec2> {
    let pair = |t: &Detection| {
        let d = found.iter().find(|d| d.id == t.id)?;
        Some((0..4).map(|i| d.corners_px[i] - t.corners_px[i]).collect::<Vec<_>>())
    };
    truth.iter().filter_map(pair).flatten().collect()
}

#[test]
fn both_families_are_found_with_their_corners_in_our_pixels() {
    for family in [MarkerFamily::tag36h11(), random_family(60, 8)] {
        let seen = picture(&family, 1);
        assert!(seen.truth.len() >= 12, "{}", seen.truth.len());
        let found = detector(&family, &every_id(&family))
            .detect(&seen.picture)
            .unwrap();
        for truth in &seen.truth {
            assert!(found.iter().any(|d| d.id == truth.id), "{} {}", family.name, truth.id);
        }
        let errors = corner_errors(&found, &seen.truth);
        // Another convention shifts all corners by half a pixel.
        let bias = errors.iter().sum::<DVec2>() / errors.len() as f64;
        assert!(bias.length() < 0.03, "{} {bias}", family.name);
        let worst = errors.iter().map(|e| e.length()).fold(0.0, f64::max);
        assert!(worst < 0.5, "{} {worst}", family.name);
    }
}

#[test]
fn the_library_s_own_family_is_ordered_as_ours() {
    let family = MarkerFamily::tag36h11();
    assert_eq!(family.codes.len(), 587);
    assert_eq!(family.codes[0], 0x0000_000d_7e00_984b);
    assert_eq!(family.bits_per_side, 6);
}

#[test]
fn only_the_whitelist_is_reported() {
    let family = MarkerFamily::tag36h11();
    let seen = picture(&family, 1);
    let allowed = [3, 5, 41, 5, 500];
    let found = detector(&family, &allowed).detect(&seen.picture).unwrap();
    let ids: Vec<u32> = found.iter().map(|d| d.id).collect();
    let expected: Vec<u32> = seen
        .truth
        .iter()
        .map(|d| d.id)
        .filter(|id| allowed.contains(id))
        .collect();
    assert!(!expected.is_empty());
    // A marker that is covered at its edge may be found as well.
    assert!(expected.iter().all(|id| ids.contains(id)), "{ids:?}");
    assert!(ids.iter().all(|id| allowed.contains(id)), "{ids:?}");
    for (ids, expected) in [(&[][..], "no marker"), (&[2, 587][..], "0 to 586, not 587")] {
        let refused = ApriltagDetector::new(&family, ids, ApriltagSettings::default());
        let text = refused.err().unwrap().to_string();
        assert!(text.contains(expected), "{text}");
    }
}

#[test]
fn a_wrong_bit_is_corrected_if_the_family_says_so() {
    let mut family = random_family(20, 8);
    let seen = picture(&family, 2);
    let id = seen.truth[0].id;
    family.codes[id as usize] ^= 1 << 20;
    let of_id = |family: &MarkerFamily| {
        let found = detector(family, &[id]).detect(&seen.picture).unwrap();
        found.first().map(|d| d.hamming)
    };
    assert_eq!(of_id(&family), Some(1));
    family.corrected_bits = 0;
    assert_eq!(of_id(&family), None);
}

#[test]
fn pictures_without_sense_do_no_harm() {
    let family = MarkerFamily::tag36h11();
    let mut random = Pcg64::seed_from_u64(9);
    for decimate in [1, 2, 4] {
        let settings = ApriltagSettings {
            decimate,
            refine_edges: true,
        };
        let mut detector = ApriltagDetector::new(&family, &[0, 1, 2], settings).unwrap();
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
        refine_edges: true,
    };
    assert!(ApriltagDetector::new(&family, &[0], settings).is_err());
}
