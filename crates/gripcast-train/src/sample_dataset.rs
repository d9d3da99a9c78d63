//! A small dataset for tests: grasps with clear contact of both gels are stable.

use std::path::Path;

use glam::{DQuat, DVec3};
use image::{Luma, Rgb, RgbImage};

use gripcast_base::files::Root;
use gripcast_dataset::shard::{
    ShardEngine, ShardFacts, ShardImages, ShardOutcome, ShardRow, ShardWriter, shard_path,
};
use gripcast_geometry::{GraspGeometry, Pose, WristCamera};
use gripcast_imaging::{DepthImage, encode_jpeg, encode_png_grey16, synthetic_gel};

/// Returns row `number` of a split; each split has its own objects.
pub(super) fn row(split: &str, number: u64) -> ShardRow {
    let is_stable = number % 2 == 1;
    graded_row(split, number, is_stable, if is_stable { 0.9 } else { 0.05 })
}

/// Returns a row with a label and a contact from 0 (none) to 1 (full).
pub(super) fn graded_row(split: &str, number: u64, is_stable: bool, contact: f32) -> ShardRow {
    let half_m = 0.01 + 0.005 * (number % 5) as f64;
    let facts = ShardFacts {
        id: format!("{split}-{number:04}"),
        simulation: format!("{split}-{number:04}"),
        object: format!("{split}-object-{}", number % 4),
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
        geometry: Some(GraspGeometry {
            x_m: [-half_m, half_m],
            y_m: [-0.02, 0.02],
            z_m: [-0.01, 0.05],
            y_at_gels_m: [-0.02, 0.02],
            centre_m: [0.0, 0.02],
        }),
        lift: None,
        contact: None,
    };
    let salt = split.bytes().map(u64::from).sum::<u64>();
    let gel = |side: u64, contact: f32| {
        encode_jpeg(
            &synthetic_gel(320, 240, 1000 * salt + 2 * number + side, contact),
            85,
        )
        .unwrap()
    };
    // Splits share no image; the figures of the shipped model are those of `test`.
    let blue = match split {
        "test" => 90,
        _ => 100 + (salt % 100) as u8,
    };
    let rgb = RgbImage::from_fn(320, 240, |x, y| {
        Rgb([(x / 2) as u8, (y + number as u32 % 16) as u8, blue])
    });
    let images = ShardImages {
        initial_left: gel(0, 0.0),
        initial_right: gel(1, 0.0),
        grasp_left: gel(0, contact),
        grasp_right: gel(1, contact),
        grasp_rgb: encode_jpeg(&rgb, 85).unwrap(),
        initial_rgb: None,
        grasp_depth: Some(depth(half_m, number)),
    };
    ShardRow { facts, images }
}

/// Depth image of a plate of this half width, mm.
fn depth(half_m: f64, number: u64) -> Vec<u8> {
    let depth_m = 0.18;
    let half_px = half_m / depth_m * WristCamera::focal_px(320, 240);
    let image = DepthImage::from_fn(320, 240, |x, y| {
        let is_plate = (f64::from(x) - 159.5).abs() < half_px && (60..180).contains(&y);
        // Rows differ between samples, as images in two splits would be duplicates.
        let noise = (u64::from(y) + number) % 3;
        Luma([if is_plate { 180 } else { 400 + noise as u16 }])
    });
    encode_png_grey16(&image).unwrap()
}

/// Writes a split as one shard.
pub(super) fn write_split(root: &Path, split: &str, rows: impl IntoIterator<Item = ShardRow>) {
    write_split_with_info(root, split, "{}", rows);
}

/// Writes a split as one shard with this description.
pub(super) fn write_split_with_info(
    root: &Path,
    split: &str,
    info: &str,
    rows: impl IntoIterator<Item = ShardRow>,
) {
    std::fs::create_dir_all(root).unwrap();
    let place = shard_path(&Root::new(root), split, 0, 1).unwrap();
    place.parent().create_dir_all().unwrap();
    let mut writer = ShardWriter::create(&place, info).unwrap();
    for row in rows {
        writer.push(row).unwrap();
    }
    writer.finish().unwrap();
}

/// Writes a dataset with this many training rows and a third of them for validation.
pub(super) fn write_dataset(root: &Path, rows: u64) {
    write_split(root, "train", (0..rows).map(|number| row("train", number)));
    let few = (rows / 3).max(4);
    write_split(
        root,
        "validation",
        (0..few).map(|number| row("validation", number)),
    );
}
