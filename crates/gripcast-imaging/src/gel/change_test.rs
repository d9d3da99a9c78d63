use image::RgbImage;

use super::*;
use crate::{GelContact, gel_image};

const NOISE: f32 = 0.2;

fn contact(centre: [f32; 2], radius: f32, strength: f32) -> GelContact {
    GelContact {
        centre_x: centre[0],
        centre_y: centre[1],
        radius,
        strength,
    }
}

fn gel(seed: u64, strength: f32) -> RgbImage {
    gel_image(320, 240, seed, contact([0.5, 0.5], 0.12, strength))
}

fn pressed(seed: u64, centre: [f32; 2], radius: f32, strength: f32) -> RgbImage {
    gel_image(320, 240, seed, contact(centre, radius, strength))
}

/// Multiplies each channel; positions are −1 to 1 from left to right and top to bottom.
fn lit(image: &RgbImage, gain: impl Fn(f32, f32, usize) -> f32) -> RgbImage {
    let mut image = image.clone();
    for (x, y, pixel) in image.enumerate_pixels_mut() {
        let (x, y) = (x as f32 / 159.5 - 1.0, y as f32 / 119.5 - 1.0);
        for (c, level) in pixel.0.iter_mut().enumerate() {
            *level = (f32::from(*level) * gain(x, y, c) + 0.5) as u8;
        }
    }
    image
}

/// Adds markers: dark dots of 7 pixels radius on a lattice of 32 pixels, shifted by `(dx, dy)`.
fn with_markers(image: &RgbImage, dx: f32, dy: f32) -> RgbImage {
    lit(image, |x, y, _| {
        let (u, v) = ((x + 1.0) * 159.5 - dx, (y + 1.0) * 119.5 - dy);
        let (u, v) = (u.rem_euclid(32.0) - 16.0, v.rem_euclid(32.0) - 16.0);
        0.3 + 0.7 * ((u.hypot(v) - 7.0) / 2.0 + 0.5).clamp(0.0, 1.0)
    })
}

fn kind(initial: &RgbImage, now: &RgbImage) -> ChangeKind {
    let change = change(initial, now);
    change.kind(MIN_CONTACT_FRACTION)
}

fn change(initial: &RgbImage, now: &RgbImage) -> GelChange {
    let [initial, now] = [initial, now].map(|image| GelCells::new(image).unwrap());
    GelChange::between(&initial, &now, NOISE)
}

type Gain = fn(f32, f32, usize) -> f32;

/// Changes of light, exposure and white balance.
const LIGHTS: [(&str, Gain); 14] = [
    ("gradient to the right", |x, _, _| 1.0 + 0.1 * x),
    ("gradient to the left", |x, _, _| 1.0 - 0.1 * x),
    ("gradient down", |_, y, _| 1.0 + 0.1 * y),
    ("diagonal gradient", |x, y, _| 1.0 + 0.07 * (x + y)),
    ("steep gradient", |x, _, _| 1.0 + 0.3 * x),
    ("exposure 1.2", |_, _, _| 1.2),
    ("exposure 0.8", |_, _, _| 0.8),
    ("exposure 0.5", |_, _, _| 0.5),
    ("exposure 1.6", |_, _, _| 1.6),
    ("white balance", |_, _, c| [1.2, 1.0, 0.85][c]),
    (
        "red lamp dim",
        |_, y, c| if c == 0 { 0.7 - 0.3 * y } else { 1.0 },
    ),
    (
        "green gradient",
        |x, _, c| if c == 1 { 1.0 + 0.2 * x } else { 1.0 },
    ),
    ("vignette", |x, y, _| 1.0 - 0.15 * (x * x + y * y)),
    ("blue lamp off", |_, _, c| if c == 2 { 0.1 } else { 1.0 }),
];

#[test]
fn noise_is_no_change() {
    for seed in 2..12 {
        let change = change(&gel(1, 0.0), &gel(seed, 0.0));
        assert_eq!(change.kind(MIN_CONTACT_FRACTION), ChangeKind::Unchanged);
        assert_eq!(change.contact_fraction, 0.0);
    }
}

#[test]
fn illumination_is_not_contact() {
    for (name, gain) in LIGHTS {
        let now = lit(&gel(2, 0.0), gain);
        assert_eq!(kind(&gel(1, 0.0), &now), ChangeKind::Illumination, "{name}");
        let markers = with_markers(&gel(1, 0.0), 0.0, 0.0);
        let now = lit(&with_markers(&gel(2, 0.0), 0.0, 0.0), gain);
        assert_eq!(
            kind(&markers, &now),
            ChangeKind::Illumination,
            "markers, {name}"
        );
    }
}

#[test]
fn contact_is_detected_under_any_light() {
    for (name, gain) in LIGHTS {
        // A blue lamp that is off takes its shading along.
        let now = lit(&gel(2, 0.6), gain);
        assert_eq!(kind(&gel(1, 0.0), &now), ChangeKind::Contact, "{name}");
    }
}

#[test]
fn light_small_large_and_edge_contacts_are_detected() {
    for (name, centre, radius, strength) in [
        ("light", [0.5, 0.5], 0.12, 0.1),
        ("small", [0.4, 0.6], 0.05, 0.3),
        ("third of the gel", [0.5, 0.5], 0.3, 0.3),
        ("half of the gel", [0.5, 0.5], 0.4, 0.3),
        ("most of the gel", [0.5, 0.5], 0.6, 0.5),
        ("all of the gel", [0.5, 0.5], 0.8, 0.5),
        ("at the left edge", [0.0, 0.5], 0.15, 0.3),
        ("in the corner", [1.0, 1.0], 0.15, 0.3),
        ("below the gel", [0.5, 1.05], 0.15, 0.5),
    ] {
        let now = pressed(2, centre, radius, strength);
        assert_eq!(kind(&gel(1, 0.0), &now), ChangeKind::Contact, "{name}");
        let markers = with_markers(&now, 1.5, 0.5);
        let initial = with_markers(&gel(1, 0.0), 0.0, 0.0);
        assert_eq!(
            kind(&initial, &markers),
            ChangeKind::Contact,
            "markers, {name}"
        );
    }
}

/// A contact that is smaller than a strict limit is no change of light either.
#[test]
fn contact_below_a_strict_limit_is_not_illumination() {
    let change = GelChange {
        contact_fraction: 0.02,
        illumination_levels: 9.0,
        is_other_gel: false,
        view_problem: None,
    };
    assert_eq!(change.kind(0.01), ChangeKind::Contact);
    assert_eq!(change.kind(0.05), ChangeKind::Unchanged);
}

#[test]
fn another_gel_is_not_contact() {
    let plain = gel(1, 0.0);
    let markers = with_markers(&gel(2, 0.0), 0.0, 0.0);
    let others = with_markers(&gel(3, 0.0), 14.0, 11.0);
    assert_eq!(kind(&markers, &others), ChangeKind::OtherGel);
    assert_eq!(kind(&plain, &markers), ChangeKind::OtherGel);
    assert_eq!(kind(&markers, &plain), ChangeKind::OtherGel);
}

#[test]
fn relaxing_markers_are_not_contact() {
    let initial = with_markers(&gel(1, 0.0), 0.0, 0.0);
    for shift in [0.1, 0.3] {
        let now = with_markers(&gel(2, 0.0), shift, -shift);
        assert_eq!(kind(&initial, &now), ChangeKind::Unchanged, "{shift}");
    }
}

#[test]
fn black_and_white_gels_are_not_contact() {
    let gel = gel(1, 0.0);
    for level in [0, 2, 255] {
        let even = RgbImage::from_pixel(320, 240, image::Rgb([level; 3]));
        assert_eq!(kind(&gel, &even), ChangeKind::Illumination, "{level}");
        assert_eq!(kind(&even, &gel), ChangeKind::Illumination, "{level}");
        assert_eq!(kind(&even, &even), ChangeKind::Unchanged, "{level}");
    }
}

#[test]
fn noisy_gel_needs_more_structure() {
    let [initial, now] = [gel(1, 0.0), gel(2, 0.1)].map(|i| GelCells::new(&i).unwrap());
    let fraction = |noise| GelChange::between(&initial, &now, noise).contact_fraction;
    assert!(fraction(0.2) >= MIN_CONTACT_FRACTION);
    assert_eq!(fraction(3.0), 0.0);
}

#[test]
fn sizes_and_small_images() {
    assert!(GelCells::new(&RgbImage::new(79, 60)).is_err());
    let large = gel_image(1280, 960, 2, contact([0.5, 0.5], 0.12, 0.6));
    let bare = gel_image(1281, 963, 3, contact([0.5, 0.5], 0.12, 0.0));
    assert_eq!(kind(&gel(1, 0.0), &large), ChangeKind::Contact);
    assert_eq!(kind(&gel(1, 0.0), &bare), ChangeKind::Unchanged);
}
