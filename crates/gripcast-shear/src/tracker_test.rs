use gripcast_base::random::SeedStream;
use gripcast_imaging::{GelContact, gel_image};
use image::RgbImage;

use super::*;

const M_PER_PX: f64 = 3.0e-5;
const SIZE: [u32; 2] = [320, 240];

/// Dots as on the real gels: darkness 0.66; radii at 90, 50 and 10 % of it as 7 : 9 : 11.8.
#[derive(Clone)]
struct Gel {
    pitch: f32,
    diameter: f32,
    tilt_deg: f32,
    jitter: f32,
    missing: Vec<usize>,
}

impl Gel {
    fn mini() -> Self {
        Self {
            pitch: 44.0,
            diameter: 18.0,
            tilt_deg: -0.6,
            jitter: 0.7,
            missing: Vec::new(),
        }
    }

    /// Positions of the dots of the untouched gel, also some outside the image.
    fn dots(&self) -> Vec<[f32; 2]> {
        let mut random = SeedStream::named(5, "jitter");
        let (sin, cos) = self.tilt_deg.to_radians().sin_cos();
        let count = (400.0 / self.pitch) as i32;
        let mut dots = Vec::new();
        for row in -2..=count {
            for column in -2..=count {
                let [x, y] = [column, row].map(|i| (i as f32 + 0.45) * self.pitch);
                let jitter = [0, 1].map(|_| self.jitter * random.between(-1.0, 1.0) as f32);
                dots.push([cos * x - sin * y + jitter[0], sin * x + cos * y + jitter[1]]);
            }
        }
        let kept = dots
            .iter()
            .enumerate()
            .filter(|(i, _)| !self.missing.contains(i));
        kept.map(|(_, dot)| *dot).collect()
    }

    /// The gel with its dots moved by `motion`.
    fn image(&self, seed: u64, contact: f32, motion: impl Fn([f32; 2]) -> [f32; 2]) -> RgbImage {
        let contact = GelContact {
            centre_x: 0.5,
            centre_y: 0.5,
            radius: 0.25,
            strength: contact,
        };
        let mut image = gel_image(SIZE[0], SIZE[1], seed, contact);
        let radii = [7.0, 9.0, 11.8].map(|r| r / 18.0 * self.diameter);
        let darkness = |distance: f32| {
            let [inner, middle, outer] = radii;
            let fraction = match distance <= middle {
                true => 0.9 - 0.4 * (distance - inner) / (middle - inner),
                false => 0.5 - 0.4 * (distance - middle) / (outer - middle),
            };
            0.66 * fraction.clamp(0.0, 1.0)
        };
        for dot in self.dots() {
            let moved = motion(dot);
            let [x, y] = [0, 1].map(|a| dot[a] + moved[a]);
            let reach = 2.0 * radii[2];
            for row in (y - reach).max(0.0) as u32..=((y + reach).max(0.0) as u32).min(SIZE[1] - 1)
            {
                for column in
                    (x - reach).max(0.0) as u32..=((x + reach).max(0.0) as u32).min(SIZE[0] - 1)
                {
                    // Four samples across a pixel, because small dots have steep edges.
                    let mut dark = 0.0;
                    for sample in 0..16 {
                        let [dx, dy] =
                            [sample % 4, sample / 4].map(|i| (i as f32 + 0.5) / 4.0 - 0.5);
                        dark +=
                            darkness((column as f32 + dx - x).hypot(row as f32 + dy - y)) / 16.0;
                    }
                    for level in &mut image.get_pixel_mut(column, row).0 {
                        *level = (f32::from(*level) * (1.0 - dark)).round() as u8;
                    }
                }
            }
        }
        image
    }
}

fn tracker(gel: &Gel) -> ShearTracker {
    let initial = gel.image(1, 0.0, |_| [0.0; 2]);
    ShearTracker::new(&initial, M_PER_PX, ExpectedMarkers::Unknown).unwrap()
}

/// A smooth field: a translation, a rotation and a stretch about the middle, at most `size` px
/// each.
fn smooth(shift: [f32; 2], size: f32) -> impl Fn([f32; 2]) -> [f32; 2] {
    move |[x, y]| {
        let [u, v] = [(x - 160.0) / 160.0, (y - 120.0) / 160.0];
        let near = (-2.0 * (u * u + v * v)).exp();
        [
            shift[0] + size * near * (u - v),
            shift[1] + size * near * (v + u),
        ]
    }
}

/// Errors of the tracked positions, px, and the fraction of the gel markers that is tracked.
fn errors(frame: &ShearFrame, motion: impl Fn([f32; 2]) -> [f32; 2]) -> (Vec<f32>, f32) {
    let field = frame.field.as_ref().unwrap();
    let errors = field
        .markers
        .iter()
        .flatten()
        .filter(|m| m.confidence > 0.0)
        .map(|marker| {
            let [dx, dy] = marker.displacement_px();
            let expected = motion(marker.rest_px);
            (dx - expected[0]).hypot(dy - expected[1])
        });
    (
        errors.collect(),
        frame.summary.unwrap().tracked_fraction as f32,
    )
}

fn rms(errors: &[f32]) -> f32 {
    (errors.iter().map(|e| e * e).sum::<f32>() / errors.len() as f32).sqrt()
}

#[test]
fn positions_of_rendered_dots_are_within_a_fifth_of_a_pixel() {
    for (pitch, diameter) in [
        (44.0, 18.0),
        (33.0, 12.0),
        (20.0, 8.0),
        (14.0, 5.0),
        (9.0, 2.5),
    ] {
        let gel = Gel {
            pitch,
            diameter,
            jitter: 0.02 * pitch,
            ..Gel::mini()
        };
        let mut tracker = tracker(&gel);
        let found = tracker.pitch_px().unwrap();
        assert!((found / pitch - 1.0).abs() < 0.03, "{found} {pitch}");
        for step in 0..4 {
            let part = step as f32 / 3.0 * 0.1 * pitch;
            let motion = smooth([part, -0.5 * part], part);
            let frame = tracker.update(&gel.image(10 + step, 0.7, &motion));
            let (errors, tracked) = errors(&frame, &motion);
            assert!(
                rms(&errors) < 0.2,
                "pitch {pitch}, step {step}: {}",
                rms(&errors)
            );
            assert!(tracked >= 0.99, "pitch {pitch}, step {step}: {tracked}");
        }
    }
}

#[test]
fn half_a_pitch_a_frame_swaps_no_dots_and_release_returns_them() {
    let gel = Gel::mini();
    let mut tracker = tracker(&gel);
    for angle in 0..8 {
        let (sin, cos) = (angle as f32 * std::f32::consts::FRAC_PI_4).sin_cos();
        for pitches in [0.48, 0.95, 0.5, 0.0] {
            let length = pitches * gel.pitch;
            let motion = smooth([length * cos, length * sin], 2.0 * pitches);
            let frame = tracker.update(&gel.image(20 + angle, 0.6 * pitches, &motion));
            let (errors, tracked) = errors(&frame, &motion);
            let max = errors.iter().copied().fold(0.0, f32::max);
            // A swapped dot is wrong by at least half a pitch, one at the edge of the image by less.
            assert!(max < 2.0, "{angle} {pitches}: {max}");
            assert!(tracked >= 0.99, "{angle} {pitches}: {tracked}");
        }
    }
}

#[test]
fn identities_come_back_after_a_gap_in_which_dots_moved_by_a_pitch() {
    let gel = Gel::mini();
    let mut tracker = tracker(&gel);
    let far = smooth([0.95 * gel.pitch, 0.0], 0.0);
    let jumped = tracker.update(&gel.image(2, 0.6, &far));
    let mean = jumped.summary.unwrap().mean_displacement_mm[0] / (1e3 * M_PER_PX);
    assert!(
        mean.abs() < 0.5 * f64::from(gel.pitch),
        "a jump of a pitch cannot be seen: {mean}"
    );
    let frame = tracker.update(&gel.image(3, 0.0, |_| [0.0; 2]));
    let (errors, tracked) = errors(&frame, |_| [0.0; 2]);
    assert!(rms(&errors) < 0.2, "{}", rms(&errors));
    assert!(tracked >= 0.99);
}

#[test]
fn a_gel_that_is_deformed_from_the_start_is_tracked_and_named() {
    let gel = Gel::mini();
    // A bulge over a few gel markers.
    let pressed = |[x, y]: [f32; 2]| {
        let [u, v] = [(x - 200.0) / 60.0, (y - 100.0) / 60.0];
        [22.0, 24.0].map(|length| length * (-(u * u + v * v)).exp())
    };
    let initial = gel.image(1, 0.9, pressed);
    let mut tracker = ShearTracker::new(&initial, M_PER_PX, ExpectedMarkers::Unknown).unwrap();
    let frame = tracker.update(&gel.image(2, 0.9, pressed));
    assert_eq!(frame.problems, [ShearProblem::DeformedInitial]);
    assert!(frame.summary.unwrap().tracked_fraction >= 0.99);
}

#[test]
fn missing_dots_are_no_gel_markers() {
    let whole = Gel::mini();
    let torn = Gel {
        missing: vec![30, 41, 42, 57],
        ..Gel::mini()
    };
    let count = |gel: &Gel| {
        let frame = tracker(gel).update(&gel.image(4, 0.0, |_| [0.0; 2]));
        let field = frame.field.unwrap();
        assert_eq!(field.markers.len(), field.columns * field.rows);
        field.markers.iter().flatten().count()
    };
    let inside = torn.missing.iter().filter(|at| {
        let [x, y] = whole.dots()[**at];
        (0.0..319.0).contains(&x) && (0.0..239.0).contains(&y)
    });
    assert_eq!(count(&whole), count(&torn) + inside.count());
}

#[test]
fn hidden_dots_are_lost_and_the_others_are_right() {
    let gel = Gel::mini();
    let mut tracker = tracker(&gel);
    let motion = smooth([4.0, 3.0], 1.0);
    let mut image = gel.image(5, 0.0, &motion);
    for (x, _, pixel) in image.enumerate_pixels_mut() {
        if x > 160 {
            pixel.0 = [90, 100, 110];
        }
    }
    let frame = tracker.update(&image);
    let (errors, tracked) = errors(&frame, &motion);
    assert!((0.35..0.65).contains(&tracked), "{tracked}");
    // A dot that is cut by the edge of the hidden part is shifted, and says so.
    let field = frame.field.as_ref().unwrap();
    let markers = field.markers.iter().flatten();
    let tracked = markers
        .filter(|marker| marker.confidence > 0.0)
        .zip(&errors);
    let whole = tracked.clone().filter(|(marker, _)| {
        let [x, y] = marker.position_px;
        let [inside, below] = [gel.diameter, 240.0 - gel.diameter];
        (inside..160.0 - inside).contains(&x) && (inside..below).contains(&y)
    });
    assert!(whole.clone().count() > 8);
    for (marker, error) in whole {
        assert!(*error < 0.3, "{error} {marker:?}");
    }
    let sure = tracked.filter(|(marker, _)| marker.confidence > 0.8);
    assert!(sure.clone().count() > 12);
    for (marker, error) in sure {
        assert!(*error < 3.0, "{error} {marker:?}");
    }
    assert!(errors.iter().all(|error| *error < 6.0), "{errors:?}");
    let many_lost = |problem: &ShearProblem| matches!(problem, ShearProblem::ManyLost { .. });
    assert!(frame.problems.iter().any(many_lost));
    // They are found again.
    let frame = tracker.update(&gel.image(6, 0.0, &motion));
    assert!(frame.summary.unwrap().tracked_fraction >= 0.99);
    assert!(frame.problems.is_empty(), "{:?}", frame.problems);
}

#[test]
fn a_blurred_image_is_named_with_low_confidence() {
    let gel = Gel::mini();
    let mut tracker = tracker(&gel);
    let sharp = tracker.update(&gel.image(7, 0.5, |_| [0.0; 2]));
    assert_eq!(sharp.problems, []);
    let blurred = image::imageops::fast_blur(&gel.image(7, 0.5, |_| [0.0; 2]), 5.0);
    let frame = tracker.update(&blurred);
    assert!(
        frame.problems.contains(&ShearProblem::Blurred),
        "{:?}",
        frame.problems
    );
    assert!(frame.summary.unwrap().confidence < 0.6 * sharp.summary.unwrap().confidence);
}

#[test]
fn a_black_image_and_another_gel_give_no_wild_field() {
    let gel = Gel::mini();
    let other = Gel {
        pitch: 33.0,
        diameter: 12.0,
        ..Gel::mini()
    };
    let mut tracker = tracker(&gel);
    let black = tracker.update(&RgbImage::new(SIZE[0], SIZE[1]));
    assert!(black.summary.is_none());
    assert!(
        matches!(black.problems[..], [ShearProblem::ManyLost { .. }]),
        "{:?}",
        black.problems
    );
    let frame = tracker.update(&other.image(8, 0.0, |_| [0.0; 2]));
    assert!(
        frame.summary.is_none_or(|s| s.confidence < 0.3),
        "{:?}",
        frame.summary
    );
    assert!(!frame.problems.is_empty());
}

fn pattern(pitch_m: f64) -> MarkerPattern {
    MarkerPattern {
        pitch_m: [pitch_m; 2],
        diameter_m: 5.4e-4,
        offset_m: [0.0; 2],
        tilt_deg: 0.0,
        jitter_m: 0.0,
        darkness: 0.66,
        edge_m: 1.4e-4,
        depth_m: 0.0,
    }
}

#[test]
fn a_gel_that_is_not_that_of_the_profile_is_a_problem_of_every_frame() {
    let marked = Gel::mini().image(1, 0.0, |_| [0.0; 2]);
    let plain = gel_image(
        SIZE[0],
        SIZE[1],
        1,
        GelContact {
            centre_x: 0.5,
            centre_y: 0.5,
            radius: 0.2,
            strength: 0.0,
        },
    );
    let (mini, coarse) = (pattern(44.0 * M_PER_PX), pattern(60.0 * M_PER_PX));
    let problems = |image: &RgbImage, expected: ExpectedMarkers<'_>| {
        ShearTracker::new(image, M_PER_PX, expected)
            .unwrap()
            .update(image)
            .problems
    };
    assert_eq!(problems(&marked, ExpectedMarkers::Pattern(&mini)), []);
    assert_eq!(
        problems(&marked, ExpectedMarkers::None),
        [ShearProblem::UnexpectedMarkers]
    );
    assert!(problems(&plain, ExpectedMarkers::Pattern(&mini)).contains(&ShearProblem::NoMarkers));
    let [ShearProblem::OtherPitch { found_px, .. }] =
        problems(&marked, ExpectedMarkers::Pattern(&coarse))[..]
    else {
        panic!("another pitch is a problem");
    };
    assert!((found_px - 44.0).abs() < 1.0);
}

#[test]
fn invalid_scales_and_sizes_are_refused() {
    let image = Gel::mini().image(1, 0.0, |_| [0.0; 2]);
    for scale in [f64::NAN, 0.0, -3e-5, f64::INFINITY] {
        let error = ShearTracker::new(&image, scale, ExpectedMarkers::Unknown).unwrap_err();
        assert!(error.to_string().contains("scale"), "{error}");
    }
    let small = RgbImage::new(40, 30);
    assert!(ShearTracker::new(&small, M_PER_PX, ExpectedMarkers::Unknown).is_err());
    let mut tracker = ShearTracker::new(&image, M_PER_PX, ExpectedMarkers::Unknown).unwrap();
    let frame = tracker.update(&small);
    assert_eq!(frame.field, None);
    assert_eq!(
        frame.problems,
        [ShearProblem::Resized {
            found: [40, 30],
            expected: SIZE,
        }]
    );
}

#[test]
fn image_of_another_gel_has_no_field() {
    let gel = Gel::mini();
    let mut tracker = tracker(&gel);
    let other = Gel {
        pitch: 1.04 * gel.pitch,
        diameter: 1.25 * gel.diameter,
        ..gel.clone()
    };
    let frame = tracker.update(&other.image(2, 12.0, |_| [3.0, 1.0]));
    assert_eq!((&frame.field, frame.summary), (&None, None));
    let [ShearProblem::OtherMarkerSize { ratio }] = frame.problems[..] else {
        panic!("{:?}", frame.problems);
    };
    // The window for the darkness is that of the initial dots.
    assert!((1.15..1.3).contains(&ratio), "{ratio}");
    // The next image of the gel is measured as before.
    let motion = |_| [4.0, -2.0];
    let (errors, tracked) = errors(&tracker.update(&gel.image(3, 12.0, motion)), motion);
    assert!(rms(&errors) < 0.2 && tracked > 0.99);
}

#[test]
fn the_slip_ratio_is_low_while_a_contact_sticks_and_rises_as_its_rim_stays_behind() {
    let gel = Gel {
        pitch: 20.0,
        diameter: 8.0,
        jitter: 0.4,
        ..Gel::mini()
    };
    let mut tracker = tracker(&gel);
    let open = tracker.update(&gel.image(40, 0.0, |_| [0.0; 2]));
    assert_eq!(open.summary.unwrap().slip_ratio, None);
    // Displacements count from the contact.
    let pressed = tracker
        .update(&gel.image(41, 0.9, |_| [0.0; 2]))
        .summary
        .unwrap();
    assert!(
        pressed.contact_fraction > 0.05 && pressed.slip_ratio == Some(0.0),
        "{pressed:?}"
    );
    // The skin moves with the object within `stick`, less outside of it.
    let sheared = |stick: f32| {
        move |[x, y]: [f32; 2]| {
            let radius = (x - 160.0).hypot(y - 120.0);
            let part = (-((radius - stick).max(0.0) / 30.0).powi(2)).exp();
            [6.0 * part, -3.0 * part]
        }
    };
    let mut ratio = |seed: u64, stick: f32| {
        let frame = tracker.update(&gel.image(seed, 0.9, sheared(stick)));
        frame.summary.unwrap().slip_ratio.unwrap()
    };
    let stick = ratio(42, 200.0);
    assert!(stick < 0.1, "{stick}");
    let partial = ratio(43, 50.0);
    let more = ratio(44, 25.0);
    assert!(
        partial > stick && more > partial + 0.1,
        "{stick} {partial} {more}"
    );
}

#[test]
fn pressing_harder_is_no_slip() {
    let gel = Gel {
        pitch: 20.0,
        diameter: 8.0,
        jitter: 0.4,
        ..Gel::mini()
    };
    let mut tracker = tracker(&gel);
    tracker.update(&gel.image(40, 0.9, |_| [0.0; 2]));
    // The contact stays as large as it is and stretches evenly, by 5 px at its rim.
    let stretched = |[x, y]: [f32; 2]| [0.05 * (x - 160.0), 0.05 * (y - 120.0)];
    let frame = tracker.update(&gel.image(41, 0.9, stretched));
    let summary = frame.summary.unwrap();
    assert!(summary.divergence > 0.05, "{summary:?}");
    assert!(summary.slip_ratio.unwrap() < 0.1, "{summary:?}");
}
