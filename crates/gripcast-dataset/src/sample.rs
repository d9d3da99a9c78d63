//! Small sample captures for tests.

#![allow(clippy::unwrap_used)]

use std::collections::BTreeMap;

use jiff::{SignedDuration, Timestamp};

use super::capture::{CapturedCamera, GraspMeta, StageCapture};
use super::descriptor::NewDataset;
use super::field::FieldArray;
use super::prediction::PredictionRecord;
use gripcast_imaging::{Frame, PixelFormat, Role};
use gripcast_shear::{FingerForce, ShearSource, ShearSummary};

/// Description of a new dataset.
pub fn new_dataset() -> NewDataset {
    NewDataset {
        name: "sample".into(),
        rig: "bench".into(),
        licence: "CC-BY-4.0".into(),
        label_definition: "stable = still in the gripper 3 s after the lift".into(),
    }
}

/// A grey JPEG whose brightness depends on `shade`.
pub fn jpeg(width: usize, height: usize, shade: u8) -> Vec<u8> {
    let pixels: Vec<u8> = (0..width * height)
        .map(|i| (i as u8).wrapping_mul(shade | 1).wrapping_add(shade))
        .collect();
    let image = turbojpeg::Image {
        pixels: pixels.as_slice(),
        width,
        pitch: width,
        height,
        format: turbojpeg::PixelFormat::GRAY,
    };
    turbojpeg::compress(image, 90, turbojpeg::Subsamp::Gray)
        .unwrap()
        .to_vec()
}

fn camera(role: Role, format: PixelFormat, data: Vec<u8>, number: u32) -> CapturedCamera {
    CapturedCamera {
        frame: Frame {
            format,
            width: 16,
            height: 8,
            data: data.into(),
            sequence: number,
            driver_time_ns: 1_000_000_000
                + u64::from(number) * 40_000_000
                + role as u64 * 1_000_000,
            received_ns: 0,
        },
        product: "Sample".into(),
        serial: format!("S-{role}"),
        interface: 0,
        port: "1-1".into(),
        controls: BTreeMap::from([("exposure_time_absolute".into(), 100)]),
        age_ms: 5.5,
        crop_profile: role.is_tactile().then(|| "gsmini-seventh-v1".into()),
        depth_unit_m: (role == Role::Depth).then_some(0.001),
    }
}

/// Frames of both gels (MJPG), colour (YUYV) and depth (Z16); they differ with `number`.
pub fn capture(number: u32) -> StageCapture {
    let shade = number as u8;
    let begin: Timestamp = "2026-11-20T10:15:00Z".parse().unwrap();
    let raw = |salt: u8| (0..=255_u8).map(|i| i.wrapping_mul(salt) ^ shade).collect();
    StageCapture {
        captured_at: begin + SignedDuration::from_secs(i64::from(number)),
        trigger_time_ns: 1_010_000_000 + u64::from(number) * 40_000_000,
        trigger: "script".into(),
        truth: None,
        fields: Vec::new(),
        shear: BTreeMap::new(),
        force: BTreeMap::new(),
        pre_grasp_frames: Vec::new(),
        pose: None,
        cameras: BTreeMap::from([
            (
                Role::Left,
                camera(
                    Role::Left,
                    PixelFormat::Mjpg,
                    jpeg(16, 8, shade.wrapping_mul(2)),
                    number,
                ),
            ),
            (
                Role::Right,
                camera(
                    Role::Right,
                    PixelFormat::Mjpg,
                    jpeg(16, 8, shade.wrapping_mul(2) + 1),
                    number,
                ),
            ),
            (
                Role::Rgb,
                camera(Role::Rgb, PixelFormat::Yuyv, raw(3), number),
            ),
            (
                Role::Depth,
                camera(Role::Depth, PixelFormat::Z16, raw(5), number),
            ),
        ]),
    }
}

/// As [`capture`], with the markers, the shear and the force of the left gel.
pub fn capture_with_fields(number: u32) -> StageCapture {
    let values = (0..2 * 3 * 5).map(|i| i as f32 + number as f32 / 8.0);
    let field = FieldArray::markers(Role::Left, values.collect(), [2, 3, 5], 2.9e-5).unwrap();
    let shear = ShearSummary {
        source: ShearSource::Markers,
        confidence: 0.9,
        tracked_fraction: 1.0,
        mean_displacement_mm: [0.125, -0.25],
        max_displacement_mm: 0.5,
        divergence: 0.01,
        curl: 0.0,
        contact_fraction: 0.25,
        slip_ratio: None,
    };
    let force = FingerForce {
        normal_n: 12.5,
        normal_std_n: 1.25,
        shear_n: Some([0.5, -0.75]),
        shear_std_n: Some(0.25),
        is_calibrated: true,
    };
    StageCapture {
        fields: vec![field],
        shear: BTreeMap::from([(Role::Left, shear)]),
        force: BTreeMap::from([(Role::Left, force)]),
        ..capture(number)
    }
}

/// Three lift frames of each gel, as `DatasetWriter::append_lift` takes them.
pub fn lift(number: u32) -> BTreeMap<Role, Vec<Frame>> {
    let frames = |role: Role| {
        let frame = |at: u32| {
            let shade = (number * 16 + at * 2) as u8 + 128 + role as u8;
            camera(role, PixelFormat::Mjpg, jpeg(16, 8, shade), number + at).frame
        };
        (role, (0..3).map(frame).collect())
    };
    BTreeMap::from([Role::Left, Role::Right].map(frames))
}

/// Metadata of a grasp of an object.
pub fn meta(object: &str) -> GraspMeta {
    GraspMeta {
        object: object.parse().unwrap(),
        scene: "table".parse().unwrap(),
        operator: "Ada".parse().unwrap(),
        rig: "bench".into(),
        prediction: Some(PredictionRecord {
            p_stable: 0.75,
            ood_score: None,
            unsure_reason: None,
            adapted: None,
            set: None,
            threshold: 0.5,
            inputs: None,
            geometry: None,
            model_sha256: "0".repeat(64),
            model: "baseline".into(),
            latency_ms: 20.5,
            engine_ms: 3.25,
        }),
        ..GraspMeta::default()
    }
}
