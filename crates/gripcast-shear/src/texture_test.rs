use gripcast_base::random::SeedStream;
use gripcast_imaging::{GelContact, gel_image};
use image::RgbImage;

use super::*;

const M_PER_PX: f64 = 3.0e-5;

/// A gel with the print of a rough round object that moved by (x, y) px and rotated by radians
/// about (150, 125).
fn press(seed: u64, [x, y]: [f32; 2], rotation: f32, object: u64) -> RgbImage {
    let none = GelContact {
        centre_x: 0.5,
        centre_y: 0.5,
        radius: 0.1,
        strength: 0.0,
    };
    let mut image = gel_image(320, 240, seed, none);
    let mut random = SeedStream::named(object, "print");
    let bumps: Vec<[f32; 3]> = (0..70)
        .map(|_| {
            let mut next = |from: f64, to: f64| random.between(from, to) as f32;
            [next(-55.0, 55.0), next(-55.0, 55.0), next(-1.0, 1.0)]
        })
        .collect();
    let (sin, cos) = rotation.sin_cos();
    for (column, row, pixel) in image.enumerate_pixels_mut() {
        let [dx, dy] = [column as f32 - 150.0 - x, row as f32 - 125.0 - y];
        let [u, v] = [cos * dx + sin * dy, cos * dy - sin * dx];
        let mut slope = [0.0; 2];
        for [bump_u, bump_v, height] in &bumps {
            let [a, b] = [u - bump_u, v - bump_v];
            let bump = height * (-(a * a + b * b) / 72.0).exp();
            slope = [slope[0] + bump * a / 6.0, slope[1] + bump * b / 6.0];
        }
        // Slopes in the object's frame are close enough to those of a rotated light.
        let shades = [
            40.0 * slope[1],
            30.0 * slope[0] - 15.0 * slope[1],
            -35.0 * slope[0],
        ];
        for (level, shade) in pixel.0.iter_mut().zip(shades) {
            *level = (f32::from(*level) + shade).round().clamp(0.0, 255.0) as u8;
        }
    }
    image
}

fn tracker() -> ShearTracker {
    let none = GelContact {
        centre_x: 0.5,
        centre_y: 0.5,
        radius: 0.1,
        strength: 0.0,
    };
    let initial = gel_image(320, 240, 1, none);
    ShearTracker::new(&initial, M_PER_PX, ExpectedMarkers::None).unwrap()
}

#[test]
fn a_print_that_moves_and_rotates_is_followed_with_its_confidence() {
    let mut tracker = tracker();
    assert_eq!(tracker.source(), ShearSource::Texture);
    for step in 0..8 {
        let [x, y] = [2.5 * step as f32, -1.5 * step as f32];
        let rotation = 0.012 * step as f32;
        let frame = tracker.update(&press(10 + step, [x, y], rotation, 3));
        let summary = frame.summary.unwrap();
        let px = summary
            .mean_displacement_mm
            .map(|mm| (mm / (1e3 * M_PER_PX)) as f32);
        assert!(
            (px[0] - x).hypot(px[1] - y) < 1.0,
            "{step}: {px:?}, expected {x} {y}"
        );
        assert!(
            (0.5 * summary.curl - f64::from(rotation)).abs() < 0.01,
            "{step}: {}",
            summary.curl
        );
        assert!(summary.confidence > 0.6, "{step}: {}", summary.confidence);
        assert_eq!(summary.slip_ratio, None);
    }
}

#[test]
fn without_contact_or_with_another_object_there_is_no_number() {
    let mut tracker = tracker();
    let none = tracker.update(&press(2, [0.0; 2], 0.0, 3).clone());
    assert!(none.summary.is_some());
    let other = tracker.update(&press(3, [0.0; 2], 0.0, 4));
    assert!(
        other.summary.is_none_or(|s| s.confidence < 0.2),
        "{:?}",
        other.summary
    );
    let still = GelContact {
        centre_x: 0.5,
        centre_y: 0.5,
        radius: 0.1,
        strength: 0.0,
    };
    let open = tracker.update(&gel_image(320, 240, 5, still));
    assert_eq!(open.summary, None);
    assert_eq!(open.problems, [ShearProblem::NoContact]);
}
