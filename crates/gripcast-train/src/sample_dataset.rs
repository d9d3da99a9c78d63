//! A small dataset for tests: grasps hold where both gels are in clear contact.

use std::path::Path;

use glam::{DQuat, DVec3};
use image::{Rgb, RgbImage};

use gripcast_base::files::Root;
use gripcast_dataset::shard::{
    ShardEngine, ShardFacts, ShardImages, ShardOutcome, ShardRow, ShardWriter, shard_path,
};
use gripcast_geometry::Pose;
use gripcast_imaging::{encode_jpeg, synthetic_gel};

/// Rows of two objects; `part` keeps those of one part of a dataset apart from the others'.
pub(super) fn row(part: &str, number: u64) -> ShardRow {
    let is_stable = number % 2 == 1;
    graded_row(part, number, is_stable, if is_stable { 0.9 } else { 0.05 })
}

/// A row of another label and contact, 0 for none and 1 for a full one.
pub(super) fn graded_row(part: &str, number: u64, is_stable: bool, contact: f32) -> ShardRow {
    let facts = ShardFacts {
        id: format!("{part}-{number:04}"),
        simulation: format!("{part}-{number:04}"),
        object: format!("{part}-object-{}", number % 4),
        category: "mug".to_owned(),
        engine: ShardEngine::Fem,
        outcome: if is_stable {
            ShardOutcome::Stable
        } else {
            ShardOutcome::Slip
        },
        outcome_detail: if is_stable { "success" } else { "slip" }.to_owned(),
        stop_force_n: Some(10.0),
        friction: Some(0.5),
        mass_kg: Some(0.1),
        lifted_m: Some(0.05),
        force_left_n: Some(5.0),
        force_right_n: Some(5.0),
        opening_m: Some(0.02),
        t_object_gripper: Some(Pose::new(DQuat::IDENTITY, DVec3::ZERO)),
        fault: None,
        appearance: "plain".to_owned(),
        rendering: 0,
        seed: number,
        crop_profile: "full-v1".to_owned(),
    };
    let gel = |side: u64, contact: f32| {
        let salt = part.bytes().map(u64::from).sum::<u64>();
        encode_jpeg(
            &synthetic_gel(320, 240, 1000 * salt + 2 * number + side, contact),
            85,
        )
        .unwrap()
    };
    let rgb = RgbImage::from_fn(320, 240, |x, y| {
        Rgb([(x / 2) as u8, (y + number as u32 % 16) as u8, 90])
    });
    let images = ShardImages {
        initial_left: gel(0, 0.0),
        initial_right: gel(1, 0.0),
        grasp_left: gel(0, contact),
        grasp_right: gel(1, contact),
        grasp_rgb: encode_jpeg(&rgb, 85).unwrap(),
        initial_rgb: None,
        grasp_depth: None,
    };
    ShardRow { facts, images }
}

/// Writes one part in one shard.
pub(super) fn write_part(root: &Path, part: &str, rows: impl IntoIterator<Item = ShardRow>) {
    std::fs::create_dir_all(root).unwrap();
    let place = shard_path(&Root::new(root), part, 0, 1).unwrap();
    place.parent().create_dir_all().unwrap();
    let mut writer = ShardWriter::create(&place, "{}").unwrap();
    for row in rows {
        writer.push(row).unwrap();
    }
    writer.finish().unwrap();
}

/// A dataset of so many training rows and a third of them for validation.
pub(super) fn write_dataset(root: &Path, rows: u64) {
    write_part(root, "train", (0..rows).map(|number| row("train", number)));
    let few = (rows / 3).max(4);
    write_part(
        root,
        "validation",
        (0..few).map(|number| row("validation", number)),
    );
}
