//! Accuracy of corner refinement.

use glam::DVec2;
use image::{GrayImage, Luma};
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64;

use super::refine::*;
use crate::synthetic::{
    GraspScene, ImageConditions, SyntheticImage, gripper_markers, ring_board, test_camera,
};
use crate::{Body, Detection, Dictionary};

fn image(index: u64, conditions: &ImageConditions) -> SyntheticImage {
    let dictionary = Dictionary::by_name("36h11").unwrap();
    let board = ring_board(&dictionary);
    let gripper = gripper_markers(&dictionary, [Body::Gripper; 2]);
    let scene = GraspScene::random(&board, &gripper, &dictionary, 21, index);
    scene.render(&test_camera(1280, 720), conditions, index)
}

/// Errors of corners refined from positions up to 1.2 px off.
fn errors(index: u64, conditions: &ImageConditions) -> Vec<DVec2> {
    let rendered = image(index, conditions);
    let mut random = Pcg64::seed_from_u64(index);
    let mut errors = Vec::new();
    for truth in &rendered.truth {
        let mut rough = truth.clone();
        for corner in &mut rough.corners_px {
            let mut off = || random.random_range(-0.85..0.85);
            *corner += DVec2::new(off(), off());
        }
        let found = refine_corners(&rendered.image, &rough);
        errors.extend((0..4).map(|i| found.corners_px[i] - truth.corners_px[i]));
    }
    errors
}

fn quantile(errors: &[DVec2], fraction: f64) -> f64 {
    let mut lengths: Vec<f64> = errors.iter().map(|e| e.length()).collect();
    lengths.sort_by(f64::total_cmp);
    lengths[((lengths.len() - 1) as f64 * fraction) as usize]
}

#[test]
fn refined_corners_are_accurate_and_unbiased() {
    let errors: Vec<DVec2> = (0..4)
        .flat_map(|index| errors(index, &ImageConditions::default()))
        .collect();
    assert!(errors.len() > 150, "{}", errors.len());
    let bias = errors.iter().sum::<DVec2>() / errors.len() as f64;
    assert!(bias.length() < 0.01, "{bias}");
    let (median, p95) = (quantile(&errors, 0.5), quantile(&errors, 0.95));
    assert!(median < 0.04 && p95 < 0.1, "{median} {p95}");
}

#[test]
fn motion_blur_does_not_bias_corners() {
    let moving = ImageConditions {
        motion_px: DVec2::new(2.5, 1.7),
        ..ImageConditions::default()
    };
    let errors = errors(1, &moving);
    assert!(quantile(&errors, 0.5) < 0.08, "{}", quantile(&errors, 0.5));
}

#[test]
fn sharpness_measures_the_blur() {
    let blur = |psf_px: f64, motion_px: DVec2| {
        let conditions = ImageConditions {
            psf_px,
            motion_px,
            ..ImageConditions::default()
        };
        let rendered = image(2, &conditions);
        let corners = &rendered.truth[0].corners_px;
        (
            blur_px(&rendered.image, &rendered.truth).unwrap(),
            edge_quality(&rendered.image, corners).unwrap(),
        )
    };
    let (sharp, marker) = blur(0.7, DVec2::ZERO);
    assert!((0.6..1.0).contains(&sharp), "{sharp}");
    assert!((0.5..0.7).contains(&marker.contrast), "{marker:?}");
    assert_eq!(marker.clipped, 0.0);
    let (soft, _) = blur(1.2, DVec2::ZERO);
    let (along_x, _) = blur(0.7, DVec2::new(3.0, 0.0));
    let (along_y, _) = blur(0.7, DVec2::new(0.0, 3.0));
    for other in [soft, along_x, along_y] {
        assert!(other > 1.2 * sharp, "{other} {sharp}");
    }
    let without_markers = image(2, &ImageConditions::default()).image;
    assert_eq!(blur_px(&without_markers, &[]), None);
}

#[test]
fn clipping_blur_and_darkness_are_noted() {
    let notes = |change: &dyn Fn(f64) -> f64, psf_px: f64| {
        let conditions = ImageConditions {
            psf_px,
            ..ImageConditions::default()
        };
        let mut rendered = image(2, &conditions);
        for level in rendered.image.iter_mut() {
            *level = change(f64::from(*level)).clamp(0.0, 255.0) as u8;
        }
        image_notes(&rendered.image, &rendered.truth).join("; ")
    };
    assert_eq!(notes(&|v| v, 0.7), "");
    assert!(notes(&|v| 1.6 * v, 0.7).contains("overexposed"));
    let blurred = notes(&|v| v, 1.8);
    assert!(blurred.contains("blurred by 1."), "{blurred}");
    let dark = notes(&|v| 0.1 * v, 0.7);
    assert!(dark.contains("contrast"), "{dark}");
}

#[test]
fn detections_without_a_border_are_unchanged() {
    let mut random = Pcg64::seed_from_u64(4);
    let noise = GrayImage::from_fn(200, 100, |_, _| Luma([random.random::<u8>()]));
    let flat = GrayImage::from_pixel(200, 100, Luma([80]));
    let square = |at: f64, side: f64| Detection {
        id: 1,
        corners_px: [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]
            .map(|(x, y)| DVec2::new(at + side * x, at + side * y)),
        hamming: 0,
        margin: 1.0,
    };
    for detection in [
        square(30.0, 40.0),
        square(-20.0, 60.0),
        square(500.0, 40.0),
        square(30.0, 0.0),
        square(30.0, f64::NAN),
        square(1e300, 1e300),
    ] {
        assert_eq!(
            format!("{:?}", refine_corners(&flat, &detection)),
            format!("{detection:?}")
        );
        let moved = refine_corners(&noise, &detection);
        for (a, b) in moved.corners_px.iter().zip(&detection.corners_px) {
            assert!(a.distance(*b) < 4.0 || !b.is_finite());
        }
        let blur = blur_px(&noise, &[detection]).unwrap_or(0.0);
        assert!(blur.is_finite());
    }
}
