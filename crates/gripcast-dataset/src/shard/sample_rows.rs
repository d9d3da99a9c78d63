//! Sample rows for tests.

use glam::{DQuat, DVec3};

use super::row::{ShardEngine, ShardFacts, ShardImages, ShardOutcome, ShardRow};
use gripcast_geometry::{GraspGeometry, Pose};
use gripcast_imaging::ObjectMotion;
use gripcast_shear::{ContactMaps, GelMotion, LiftImage, LiftMotion};

/// Bytes with the signature of an image; not decodable.
pub(super) fn image(png: bool, seed: u64, length: usize) -> Vec<u8> {
    let begin: &[u8] = if png {
        b"\x89PNG\r\n\x1a\n"
    } else {
        b"\xff\xd8\xff\xe0"
    };
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let noise = std::iter::repeat_with(|| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state as u8
    });
    begin
        .iter()
        .copied()
        .chain(noise)
        .take(begin.len() + length)
        .collect()
}

/// A row whose fields all depend on `number`; every nullable column is null in some row.
pub(super) fn sample_row(number: u64) -> ShardRow {
    let x = number as f64;
    let every = |n: u64| number.is_multiple_of(n);
    let outcome = ShardOutcome::ALL[(number % 2) as usize];
    // Without trigonometric functions, which differ between machines.
    let rotation = DQuat::from_xyzw(0.3 * x, -0.2, 0.1, 1.0 + x);
    let facts = ShardFacts {
        id: format!("{number:06}-r0"),
        simulation: format!("{number:06}"),
        object: format!("tasse-größe-{}-杯", number % 3),
        category: if every(5) {
            String::new()
        } else {
            "mug".to_owned()
        },
        engine: ShardEngine::ALL[usize::from(every(3))],
        outcome,
        outcome_detail: ["eject", "success"][outcome.label() as usize].to_owned(),
        stop_force_n: Some([10.0, 40.0][(number % 2) as usize]),
        friction: Some(0.1 + 1e-3 * x),
        mass_kg: Some(0.01 + 0.1 / (1.0 + x)),
        lifted_m: Some(-1e-6 * x),
        force_left_n: (!every(4)).then_some(x / 3.0),
        force_right_n: (!every(3)).then_some(x / 7.0),
        opening_m: Some(0.01 * x / 3.0),
        t_object_gripper: Some(Pose::new(rotation, DVec3::new(0.1 / (x + 3.0), -0.0, x))),
        fault: every(2).then(|| if every(4) { "" } else { "gel torn" }.to_owned()),
        appearance: "wood \u{1f332}".to_owned(),
        rendering: (number % 3) as u32,
        seed: i64::MAX as u64 - number,
        crop_profile: "paper".to_owned(),
        lift: every(2).then(|| LiftMotion {
            images: [None, Some(0.25 * x)]
                .map(|drop_mm: Option<f64>| LiftImage {
                    gels: [GelMotion {
                        level: 4.0 + x,
                        ..GelMotion::default()
                    }; 2],
                    object: drop_mm.filter(|_| every(4)).map(|drop_mm| ObjectMotion {
                        between_mm: Some(drop_mm),
                        ..ObjectMotion::default()
                    }),
                })
                .to_vec(),
        }),
        geometry: every(3).then(|| {
            GraspGeometry::from_array(std::array::from_fn(|i| 0.01 * i as f64 - 0.02 * x))
        }),
        contact: every(4)
            .then(|| (0..ContactMaps::LEN).map(|i| 1e-7 * (i as f64 - x)))
            .and_then(|values| ContactMaps::new(values.collect())),
    };
    let images = ShardImages {
        initial_left: image(false, number, 40),
        initial_right: image(false, number + 1, 41),
        grasp_left: image(true, number + 2, 300),
        grasp_right: image(false, number + 3, 0),
        grasp_rgb: image(true, number + 4, 170),
        initial_rgb: every(2).then(|| image(false, number + 5, 50)),
        grasp_depth: every(3).then(|| image(true, number + 6, 60)),
    };
    ShardRow { facts, images }
}

/// Rows `first`, `first` + 1, ….
pub(super) fn sample_rows(first: u64, count: usize) -> Vec<ShardRow> {
    (first..).take(count).map(sample_row).collect()
}
