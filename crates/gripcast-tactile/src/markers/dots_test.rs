//! Tests of drawn gel markers.

use image::RgbImage;

use super::*;
use crate::markers::pattern::sample_pattern;
use crate::{FrameNoise, PressDepth, SensorProfile, TactileRenderer};

/// The shipped sensor with a grey gel and the given markers.
fn renderer(pattern: MarkerPattern) -> TactileRenderer {
    let mut profile = SensorProfile::gelsight_mini().unwrap();
    profile.background.image = Some(RgbImage::from_pixel(320, 240, image::Rgb([200; 3])));
    profile.markers = Some(pattern);
    TactileRenderer::new(&profile).unwrap()
}

fn drawn(
    pattern: &MarkerPattern,
    motion: &dyn Fn([f64; 2]) -> [f64; 2],
) -> (RgbImage, MarkerField) {
    let mut renderer = renderer(pattern.clone());
    let press = PressDepth::untouched(renderer.geometry());
    renderer
        .render_with_markers(&press, &FrameNoise::default(), motion)
        .unwrap()
}

/// Weighted centre and covariance of the darkness within `reach` pixels of a point, and its sum.
fn moments(image: &RgbImage, channel: usize, at: [f32; 2], reach: f64) -> ([f64; 2], [f64; 3]) {
    let (mut sum, mut first, mut second) = (0.0, [0.0; 2], [0.0; 3]);
    for (column, row, pixel) in image.enumerate_pixels() {
        let (x, y) = (f64::from(column), f64::from(row));
        if (x - f64::from(at[0])).hypot(y - f64::from(at[1])) > reach {
            continue;
        }
        let w = 200.0 - f64::from(pixel[channel]);
        sum += w;
        first = [first[0] + w * x, first[1] + w * y];
        second = [
            second[0] + w * x * x,
            second[1] + w * y * y,
            second[2] + w * x * y,
        ];
    }
    let [x, y] = first.map(|v| v / sum);
    let [xx, yy, xy] = second.map(|v| v / sum);
    ([x, y], [xx - x * x, yy - y * y, xy - x * y])
}

use gripcast_shear::MarkerField;

fn flat() -> MarkerPattern {
    MarkerPattern {
        depth_m: 0.0,
        ..sample_pattern()
    }
}

#[test]
fn dots_lie_where_the_field_says() {
    let motion = |[x, y]: [f64; 2]| {
        [
            2e-5 + 0.03 * x - 0.02 * y,
            1e-4 * (200.0 * x).sin() + 0.01 * y,
        ]
    };
    let (image, field) = drawn(&flat(), &motion);
    let mut seen = 0;
    for marker in field.markers.iter().flatten() {
        let [x, y] = marker.position_px;
        if !(15.0..305.0).contains(&x) || !(15.0..225.0).contains(&y) {
            continue;
        }
        let (centre, _) = moments(&image, 1, marker.position_px, 12.0);
        let off = (centre[0] - f64::from(x)).hypot(centre[1] - f64::from(y));
        assert!(off < 0.03, "{off} px at {x}, {y}");
        seen += 1;
    }
    assert!(seen > 30, "{seen}");
}

#[test]
fn stretched_skin_makes_ellipses() {
    let (image, field) = drawn(&flat(), &|[x, y]| [0.3 * x, -0.1 * y]);
    let nearest = field.markers.iter().flatten().min_by_key(|m| {
        let [x, y] = m.position_px.map(|c| c - 120.0);
        (x.hypot(y) * 100.0) as i64
    });
    let (_, [xx, yy, xy]) = moments(&image, 0, nearest.unwrap().position_px, 14.0);
    let ratio = (xx / yy).sqrt();
    assert!((ratio - 1.3 / 0.9).abs() < 0.04, "{ratio}");
    assert!(xy.abs() < 0.05 * yy);
}

#[test]
fn dot_has_the_darkness_and_diameter_of_its_pattern() {
    let pattern = flat();
    let (image, field) = drawn(&pattern, &|_| [0.0; 2]);
    let marker = field
        .markers
        .iter()
        .flatten()
        .nth(field.columns * 3 + 4)
        .unwrap();
    let [x, y] = marker.position_px;
    let level = |x: f32, y: f32| {
        1.0 - f64::from(image.get_pixel(x.round() as u32, y.round() as u32)[0]) / 200.0
    };
    assert!(
        (level(x, y) - pattern.darkness).abs() < 0.01,
        "{}",
        level(x, y)
    );
    // The area of a disc of the diameter, dimmed by the darkness.
    let mut area = 0.0;
    for (column, row, pixel) in image.enumerate_pixels() {
        if (column as f32 - x).hypot(row as f32 - y) < 13.0 {
            area += 1.0 - f64::from(pixel[0]) / 200.0;
        }
    }
    let radius_px = 0.5 * pattern.diameter_m / field.m_per_px;
    let sigma_px = pattern.edge_m / EDGE_SIGMAS / field.m_per_px;
    let expected = pattern.darkness * std::f64::consts::PI * (radius_px.powi(2) + sigma_px.powi(2));
    assert!((area / expected - 1.0).abs() < 0.02, "{area} {expected}");
}

#[test]
fn deep_layer_shifts_the_channels_away_from_their_lamps() {
    let pattern = MarkerPattern {
        depth_m: 1e-4,
        ..sample_pattern()
    };
    let (image, field) = drawn(&pattern, &|_| [0.0; 2]);
    let marker = field
        .markers
        .iter()
        .flatten()
        .nth(field.columns * 3 + 4)
        .unwrap();
    let at = |channel: usize| {
        let (centre, _) = moments(&image, channel, marker.position_px, 12.0);
        [0, 1].map(|axis| centre[axis] - f64::from(marker.position_px[axis]))
    };
    let shift_px = 1e-4 / field.m_per_px;
    // Red from above, green from the right, blue from below, as on real frames.
    for (channel, [x, y]) in [(0, [0.0, 1.0]), (1, [-1.0, 0.0]), (2, [0.0, -1.0])] {
        let [dx, dy] = at(channel);
        assert!(
            (dx - x * shift_px).abs() < 0.4 && (dy - y * shift_px).abs() < 0.4,
            "{dx} {dy}"
        );
    }
}

#[test]
fn folded_motion_leaves_dots_whole() {
    let (image, _) = drawn(&flat(), &|[x, y]| [-3.0 * x, 5.0 * y]);
    assert!(image.pixels().any(|pixel| pixel[0] < 100));
}

#[test]
fn profile_without_markers_has_no_field() {
    let mut renderer = TactileRenderer::new(&SensorProfile::gelsight_mini().unwrap()).unwrap();
    let press = PressDepth::untouched(renderer.geometry());
    let error = renderer
        .render_with_markers(&press, &FrameNoise::default(), &|_| [0.0; 2])
        .unwrap_err();
    assert!(error.to_string().contains("no gel markers"), "{error}");
}
