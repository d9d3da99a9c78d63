use super::*;
use crate::calibrate::BallContact;

fn mini() -> TactileRenderer {
    TactileRenderer::new(&SensorProfile::gelsight_mini().unwrap()).unwrap()
}

fn ball(renderer: &TactileRenderer) -> PressDepth {
    let contact = BallContact {
        geometry: renderer.geometry(),
        centre_px: [170.0, 110.0],
        radius_px: 15.0,
        ball_m: 2e-3,
    };
    contact.press_sunk_by(2e-4)
}

#[test]
fn no_contact_renders_the_background() {
    let profile = SensorProfile::gelsight_mini().unwrap();
    let mut renderer = mini();
    let press = PressDepth::untouched(renderer.geometry());
    let image = renderer.render(&press, &FrameNoise::default()).unwrap();
    assert_eq!(Some(image), profile.background.image);
}

#[test]
fn press_changes_only_its_surroundings() {
    let mut renderer = mini();
    let press = ball(&renderer);
    let change = renderer.change(&press).unwrap();
    let at = |x: usize, y: usize| {
        change
            .iter()
            .map(|p| p[y * 320 + x].abs())
            .fold(0.0, f32::max)
    };
    assert!(at(180, 110) > 20.0 || at(170, 120) > 20.0);
    assert!(at(10, 10) < 1.0 && at(310, 230) < 1.0);
}

#[test]
fn opposite_slopes_change_red_oppositely() {
    let mut renderer = mini();
    let press = ball(&renderer);
    let change = renderer.change(&press).unwrap();
    let largest = |sign: f32| change[0].iter().map(|v| v * sign).fold(0.0, f32::max);
    assert!(largest(1.0) > 20.0 && largest(-1.0) > 20.0);
}

#[test]
fn image_depends_on_seed_not_on_earlier_frames() {
    let mut renderer = mini();
    let press = ball(&renderer);
    let noise = FrameNoise {
        noise_seed: Some(11),
        ..FrameNoise::default()
    };
    let first = renderer.render(&press, &noise).unwrap();
    let untouched = PressDepth::untouched(renderer.geometry());
    renderer.render(&untouched, &noise).unwrap();
    assert_eq!(renderer.render(&press, &noise).unwrap(), first);
    assert_eq!(mini().render(&press, &noise).unwrap(), first);
    let other = FrameNoise {
        noise_seed: Some(12),
        ..noise
    };
    assert_ne!(renderer.render(&press, &other).unwrap(), first);
}

#[test]
fn noise_has_std_of_the_profile() {
    let mut renderer = mini();
    let press = PressDepth::untouched(renderer.geometry());
    let still = renderer.render(&press, &FrameNoise::default()).unwrap();
    let noise = FrameNoise {
        noise_seed: Some(1),
        ..FrameNoise::default()
    };
    let noisy = renderer.render(&press, &noise).unwrap();
    let expected = SensorProfile::gelsight_mini().unwrap().noise_std;
    for c in 0..3 {
        let square: f64 = still
            .pixels()
            .zip(noisy.pixels())
            .map(|(a, b)| (f64::from(a.0[c]) - f64::from(b.0[c])).powi(2))
            .sum();
        let found = (square / 76_800.0).sqrt();
        // Rounding adds 1/12 to the variance.
        let expected = (expected[c].powi(2) + 1.0 / 12.0).sqrt();
        assert!((found - expected).abs() < 0.05, "{found} {expected}");
    }
}

#[test]
fn gain_and_offset_apply_and_saturate() {
    let mut renderer = mini();
    let press = PressDepth::untouched(renderer.geometry());
    let noise = FrameNoise {
        gain: [0.0; 3],
        offset: [300.0, -5.0, 77.0],
        noise_seed: None,
    };
    let image = renderer.render(&press, &noise).unwrap();
    assert!(image.pixels().all(|p| p.0 == [255, 0, 77]));
}

#[test]
fn press_on_another_grid_is_refused() {
    let mut renderer = mini();
    let mut geometry = renderer.geometry();
    geometry.pixel_m *= 2.0;
    let other_grid = PressDepth::untouched(geometry);
    let text = renderer.change(&other_grid).unwrap_err().to_string();
    assert!(text.contains("grid"), "{text}");
    let mut short = PressDepth::untouched(renderer.geometry());
    short.depth_m.pop();
    assert!(renderer.change(&short).is_err());
}

#[test]
fn non_finite_depths_are_tolerated() {
    let mut renderer = mini();
    let mut press = ball(&renderer);
    press.depth_m[40_000] = f32::NAN;
    press.depth_m[40_001] = f32::INFINITY;
    press.depth_m[40_002] = -1.0;
    renderer.render(&press, &FrameNoise::default()).unwrap();
}

#[test]
fn marker_gel_looks_like_a_real_frame() {
    let item = "data/gsmini_feats_marker/nocontact_train_sensor.png";
    let Some(path) = gripcast_testing::shared(item) else {
        return;
    };
    let real = gripcast_imaging::decode_png_rgb(&std::fs::read(path).unwrap()).unwrap();
    let name = crate::SensorName::by_name("gelsight-mini-markers").unwrap();
    let mut renderer = TactileRenderer::new(&name.profile().unwrap()).unwrap();
    let press = PressDepth::untouched(renderer.geometry());
    let ours = renderer.render(&press, &FrameNoise::default()).unwrap();
    let dark = |image: &RgbImage| {
        let pixels = image.pixels().zip(planes(&renderer));
        let dark = pixels.filter(|(pixel, bare)| f32::from(pixel[1]) < 0.65 * **bare);
        dark.count() as f64 / f64::from(image.width() * image.height())
    };
    let (found, expected) = (dark(&ours), dark(&real));
    assert!((found / expected - 1.0).abs() < 0.25, "{found} {expected}");
    let mean =
        |image: &RgbImage| image.iter().map(|v| f64::from(*v)).sum::<f64>() / image.len() as f64;
    assert!(
        (mean(&ours) - mean(&real)).abs() < 4.0,
        "{} {}",
        mean(&ours),
        mean(&real)
    );
}

/// Green levels of the untouched gel without gel markers.
fn planes(renderer: &TactileRenderer) -> impl Iterator<Item = &f32> {
    renderer.untouched[1].iter()
}
