use image::RgbImage;

use super::*;
use crate::synthetic_gel;

const INTERVAL_NS: u64 = 40_000_000;

fn gel(i: u64) -> RgbImage {
    synthetic_gel(320, 240, 100 + i, 0.0)
}

fn scaled(image: &RgbImage, gain: [f32; 3]) -> RgbImage {
    let mut image = image.clone();
    for pixel in image.pixels_mut() {
        for (level, gain) in pixel.0.iter_mut().zip(gain) {
            *level = (f32::from(*level) * gain + 0.5) as u8;
        }
    }
    image
}

/// State after `frames` frames of 40 ms.
fn state_after(frames: u64, image: impl Fn(u64) -> RgbImage) -> GelState {
    let mut monitor = GelMonitor::default();
    for i in 0..frames {
        monitor.add(GelCells::new(&image(i)).unwrap(), i * INTERVAL_NS);
    }
    monitor.state().unwrap().clone()
}

fn problems(image: impl Fn(u64) -> RgbImage) -> Vec<GelProblem> {
    state_after(60, image).problems
}

#[test]
fn healthy_gel_has_no_problem() {
    let state = state_after(60, gel);
    assert_eq!(state.problems, []);
    let noise = state.noise_levels.unwrap();
    assert!((0.1..0.4).contains(&noise), "{noise}");
    assert!(
        state
            .level
            .iter()
            .all(|level| (60.0..160.0).contains(level))
    );
    assert_eq!((state.flicker, state.drift_per_s), (0.0, 0.0));
}

#[test]
fn black_lamp_dead_saturated_and_noise_are_named() {
    let noise = |i: u64| {
        RgbImage::from_fn(320, 240, |x, y| {
            let bits = gripcast_base::random::scramble(i << 40 ^ u64::from(y) << 20 ^ u64::from(x));
            image::Rgb([bits as u8, (bits >> 8) as u8, (bits >> 16) as u8])
        })
    };
    let half_white = |i: u64| {
        let mut image = gel(i);
        for (x, _, pixel) in image.enumerate_pixels_mut() {
            if x < 160 {
                *pixel = image::Rgb([255; 3]);
            }
        }
        image
    };
    let cases: [(GelProblem, &dyn Fn(u64) -> RgbImage); 6] = [
        (GelProblem::Black, &|i| scaled(&gel(i), [0.02; 3])),
        (GelProblem::Black, &|_| RgbImage::new(320, 240)),
        (GelProblem::LampDead, &|i| scaled(&gel(i), [0.05, 1.0, 1.0])),
        (GelProblem::Saturated, &|i| scaled(&gel(i), [4.0; 3])),
        (GelProblem::Saturated, &half_white),
        (GelProblem::Noisy, &noise),
    ];
    for (problem, image) in cases {
        let found = problems(image);
        assert!(found.contains(&problem), "{problem:?}: {found:?}");
    }
    assert_eq!(
        problems(|i| scaled(&gel(i), [0.05, 1.0, 1.0])),
        [GelProblem::LampDead]
    );
}

#[test]
fn fast_slow_and_beating_flicker_is_named() {
    let gain = |gain: f32| [gain; 3];
    type Light<'a> = &'a dyn Fn(u64) -> [f32; 3];
    let cases: [(&str, Light<'_>); 5] = [
        ("every two frames", &|i| {
            gain(if i % 4 < 2 { 1.0 } else { 0.8 })
        }),
        ("every frame", &|i| {
            gain(if i % 2 == 0 { 1.0 } else { 0.97 })
        }),
        ("slow", &|i| gain(1.0 + 0.1 * (i as f32 / 4.0).sin())),
        ("beat of 50 Hz and 25 fps", &|i| {
            gain(1.0 + 0.03 * (i as f32 * 0.7).sin())
        }),
        ("of green", &|i| {
            [1.0, if i % 6 < 3 { 1.0 } else { 0.94 }, 1.0]
        }),
    ];
    for (name, gain) in cases {
        let state = state_after(110, |i| scaled(&gel(i), gain(i)));
        assert_eq!(state.problems, [GelProblem::Flickering], "{name}");
        assert!(state.flicker > 0.02, "{name}");
    }
}

#[test]
fn drift_of_any_channel_is_named() {
    for gain in [
        |t: f32| [1.0 + 0.2 * t, 1.0, 1.0 - 0.1 * t],
        |t: f32| [1.0, 1.0 - 0.05 * t, 1.0],
        |t: f32| [1.0, 1.0, 1.0 + 0.05 * t],
        |t: f32| [1.0 - 0.1 * t; 3],
    ] {
        let found = problems(|i| scaled(&gel(i), gain(i as f32 * 0.04)));
        assert_eq!(found, [GelProblem::Drifting]);
    }
}

#[test]
fn one_step_of_exposure_and_contact_are_no_problem() {
    let step = |i: u64| scaled(&gel(i), [if i < 30 { 1.0 } else { 0.8 }; 3]);
    assert_eq!(problems(step), []);
    // The gripper closes within half a second, holds and opens.
    let strength = |i: u64| match i {
        0..20 => 0.0,
        20..32 => (i - 20) as f32 / 12.0,
        32..45 => 1.0,
        _ => 0.0,
    };
    for frames in 2..60 {
        let grasp = |i: u64| synthetic_gel(320, 240, 7, strength(i));
        assert_eq!(state_after(frames, grasp).problems, [], "{frames}");
    }
}

#[test]
fn flicker_ends_with_the_window() {
    let mut monitor = GelMonitor::default();
    for i in 0..200 {
        let gain = if i < 60 && i % 4 < 2 { 0.8 } else { 1.0 };
        let cells = GelCells::new(&scaled(&gel(i), [gain; 3])).unwrap();
        monitor.add(cells, i * INTERVAL_NS);
        if i == 59 {
            assert_eq!(monitor.state().unwrap().problems, [GelProblem::Flickering]);
        }
    }
    assert_eq!(monitor.state().unwrap().problems, []);
}

#[test]
fn pause_and_time_going_back_start_a_new_window() {
    let mut monitor = GelMonitor::default();
    for (i, time_ns) in [(0, 0), (1, INTERVAL_NS), (2, 9_000_000_000), (3, 5)] {
        monitor.add(GelCells::new(&gel(i)).unwrap(), time_ns);
    }
    assert_eq!(monitor.state().unwrap().noise_levels, None);
}
