use glam::{DQuat, DVec2, DVec3};
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64;

use super::board_points::BoardPoint;
use super::{CalibrationReport, calibrate_intrinsics};
use crate::camera::project;
use gripcast_geometry::Pose;
use gripcast_imaging::{DistortionModel, Intrinsics};

const SIZE: [u32; 2] = [1280, 720];

pub(super) fn truth() -> Intrinsics {
    Intrinsics {
        width: SIZE[0],
        height: SIZE[1],
        fx: 921.5,
        fy: 918.2,
        cx: 648.3,
        cy: 352.4,
        model: DistortionModel::BrownConrady,
        coefficients: [0.05, -0.08, 0.0006, -0.0004, 0.0],
    }
}

fn normal(random: &mut Pcg64) -> f64 {
    let radius = (-2.0 * (1.0 - random.random::<f64>()).ln()).sqrt();
    radius * (std::f64::consts::TAU * random.random::<f64>()).cos()
}

/// Poses of a board that faces the camera, tilted to all sides, in all regions of the image, 0.3 to
/// 0.6 m away.
pub(super) fn poses(count: usize, random: &mut Pcg64, tilt: f64) -> Vec<Pose> {
    (0..count)
        .map(|k| {
            let azimuth =
                std::f64::consts::TAU * (k as f64 * 0.382 + 0.05 * random.random::<f64>());
            let angle =
                tilt * (0.6 + 0.4 * random.random::<f64>()) * f64::from(u8::from(k % 4 != 0));
            let axis = DVec3::new(azimuth.cos(), azimuth.sin(), 0.0);
            let roll = DQuat::from_rotation_z(0.5 * (random.random::<f64>() - 0.5));
            let facing = DQuat::from_rotation_x(std::f64::consts::PI);
            let depth = 0.3 + 0.3 * random.random::<f64>();
            let cell = [k % 3, (k / 3) % 3].map(|c| c as f64 - 1.0);
            let at = DVec3::new(0.32 * cell[0], 0.17 * cell[1], 1.0) * depth;
            Pose::new(DQuat::from_axis_angle(axis, angle) * facing * roll, at)
        })
        .collect()
}

/// Visible points of a grid of 8 × 6 points, 25 mm apart.
fn view(lens: &Intrinsics, pose: &Pose, noise: f64, random: &mut Pcg64) -> Vec<BoardPoint> {
    let grid_point = |k: u32| {
        let (x, y) = (f64::from(k % 8) - 3.5, f64::from(k / 8) - 2.5);
        0.025 * DVec3::new(x, y, 0.0)
    };
    let all = (0..48).filter_map(|index| {
        let point_m = grid_point(index);
        let pixel = project(lens, pose.transform_point(point_m))?;
        let size = DVec2::new(f64::from(SIZE[0]), f64::from(SIZE[1]));
        let inside = pixel.cmpgt(DVec2::ZERO).all() && pixel.cmplt(size).all();
        inside.then(|| BoardPoint {
            index,
            point_m,
            pixel: pixel + noise * DVec2::new(normal(random), normal(random)),
        })
    });
    all.collect()
}

fn views(
    lens: &Intrinsics,
    count: usize,
    tilt: f64,
    noise: f64,
    seed: u64,
) -> Vec<Vec<BoardPoint>> {
    let mut random = Pcg64::seed_from_u64(seed);
    let poses = poses(count, &mut random, tilt);
    poses
        .iter()
        .map(|pose| view(lens, pose, noise, &mut random))
        .collect()
}

fn values(lens: &Intrinsics) -> [f64; 9] {
    let [k1, k2, p1, p2, k3] = lens.coefficients;
    [lens.fx, lens.fy, lens.cx, lens.cy, k1, k2, p1, p2, k3]
}

fn assert_near(report: &CalibrationReport, truth: &Intrinsics) {
    let found = report.intrinsics;
    for (ours, true_value) in [(found.fx, truth.fx), (found.fy, truth.fy)] {
        assert!((ours / true_value - 1.0).abs() < 1e-3, "{found:?}");
    }
    let off = DVec2::new(found.cx - truth.cx, found.cy - truth.cy);
    assert!(off.abs().max_element() < 1.0, "{found:?}");
}

#[test]
fn exact_points_recover_exact_intrinsics() {
    let truth = truth();
    let report = calibrate_intrinsics(SIZE, &views(&truth, 9, 0.6, 0.0, 1)).unwrap();
    for (ours, expected) in values(&report.intrinsics).iter().zip(values(&truth)) {
        assert!(
            (ours - expected).abs() < 1e-5 * expected.abs().max(1.0),
            "{report:?}"
        );
    }
    assert!(report.rms_px < 1e-6 && report.fitted[..8].iter().all(|f| *f));
    assert!(!report.fitted[8] && report.sigma[8] == 0.0);
}

/// The squared errors of fx, fy, cx, cy, k1, k2, p1, p2, normalised by their sigmas, average 1 if
/// the sigmas are consistent.
#[test]
fn sigmas_are_consistent_with_errors() {
    let truth = truth();
    let (mut squares, mut spread) = ([0.0; 8], 0.0);
    let seeds = 40;
    for seed in 0..seeds {
        let views = views(&truth, 14, 0.6, 0.1, 100 + seed);
        let report = calibrate_intrinsics(SIZE, &views).unwrap();
        let (ours, expected) = (values(&report.intrinsics), values(&truth));
        for (i, sum) in squares.iter_mut().enumerate() {
            *sum += ((ours[i] - expected[i]) / report.sigma[i]).powi(2) / seeds as f64;
        }
        assert!((0.08..0.12).contains(&report.point_sigma_px));
        let holdout = report.holdout.unwrap();
        assert!(holdout.rms_px < 1.2 * report.rms_px, "{holdout:?}");
        spread += holdout.spread_px[0] / report.sigma[0] / seeds as f64;
    }
    println!("normalised squares {squares:.2?}, jackknife over claimed {spread:.2}");
    for mean in squares {
        // The mean of 40 squares has a standard deviation of 0.22.
        assert!((0.5..1.7).contains(&mean), "{squares:.2?}");
    }
    assert!((0.6..1.6).contains(&spread), "{spread}");
}

#[test]
fn strong_and_weak_distortion_is_recovered() {
    let plain = |fx: f64, coefficients| Intrinsics {
        fx,
        fy: 1.002 * fx,
        coefficients,
        ..truth()
    };
    for (k, lens) in [
        plain(600.0, [-0.28, 0.09, 0.0002, 0.0001, 0.0]),
        plain(1800.0, [-0.1, 0.0, 0.0, 0.0, 0.0]),
        plain(560.0, [-0.32, 0.14, 0.0, 0.0, -0.03]),
        plain(915.0, [0.0; 5]),
    ]
    .iter()
    .enumerate()
    {
        let near = lens.fx / 915.0;
        let mut random = Pcg64::seed_from_u64(7);
        let views: Vec<_> = poses(15, &mut random, 0.6)
            .iter()
            .map(|pose| {
                let t = pose.translation_m * DVec3::new(1.0, 1.0, near);
                view(lens, &Pose::new(pose.rotation, t), 0.05, &mut random)
            })
            .collect();
        let report = calibrate_intrinsics(SIZE, &views).unwrap();
        let (ours, expected) = (values(&report.intrinsics), values(lens));
        for i in 0..4 {
            let off = (ours[i] - expected[i]).abs();
            assert!(
                off < 4.5 * report.sigma[i] && off < 3.0,
                "{k} {i}: {report:#?}"
            );
        }
        assert!(report.rms_px < 0.08, "{k} {report:?}");
        assert_eq!(report.fitted[8], k == 2, "{k} {report:?}");
    }
}

#[test]
fn views_from_one_direction_are_refused() {
    let truth = truth();
    for (tilt, noise) in [(0.0, 0.0), (0.0, 0.1), (0.03, 0.1)] {
        let error = calibrate_intrinsics(SIZE, &views(&truth, 12, tilt, noise, 3)).unwrap_err();
        let message = error.to_string();
        assert!(
            message.contains("direction") && message.contains("tilted"),
            "{message}"
        );
    }
    // All with the same tilt, only rolled and moved.
    let mut random = Pcg64::seed_from_u64(4);
    let same_tilt: Vec<_> = poses(12, &mut random, 0.0)
        .iter()
        .map(|p| Pose::new(DQuat::from_rotation_x(0.5) * p.rotation, p.translation_m))
        .map(|p| view(&truth, &p, 0.1, &mut random))
        .collect();
    let message = calibrate_intrinsics(SIZE, &same_tilt)
        .unwrap_err()
        .to_string();
    assert!(message.contains("direction"), "{message}");
    let few = views(&truth, 2, 0.6, 0.0, 3);
    let message = calibrate_intrinsics(SIZE, &few).unwrap_err().to_string();
    assert!(message.contains("at least 3 usable views"), "{message}");
    assert!(calibrate_intrinsics(SIZE, &[]).is_err());
}

#[test]
fn outlier_view_and_points_are_excluded() {
    let truth = truth();
    let mut views = views(&truth, 14, 0.6, 0.05, 5);
    // A view of a bent board, and single wrong corners.
    for point in &mut views[4] {
        let at = point.point_m / 0.1;
        point.pixel += 6.0 * DVec2::new(at.x * at.y, at.x * at.x);
    }
    views[2][5].pixel.x += 7.0;
    views[9][11].pixel.y -= 1.5;
    let report = calibrate_intrinsics(SIZE, &views).unwrap();
    assert_near(&report, &truth);
    assert!(report.rms_px < 0.08, "{report:?}");
    assert_eq!(report.views[4].points, 0);
    assert!(report.views[4].rms_px > 1.0);
    assert_eq!((report.views[2].outliers, report.views[9].outliers), (1, 1));
}

#[test]
fn undetermined_coefficients_are_not_fitted() {
    // Small boards at the image centre do not constrain the image corners.
    let lens = Intrinsics {
        coefficients: [0.0; 5],
        ..truth()
    };
    let mut random = Pcg64::seed_from_u64(6);
    let central: Vec<_> = poses(12, &mut random, 0.6)
        .iter()
        .map(|p| {
            let t = p.translation_m * DVec3::new(0.05, 0.05, 1.0) + DVec3::Z * 0.6;
            view(&lens, &Pose::new(p.rotation, t), 0.05, &mut random)
        })
        .collect();
    let report = calibrate_intrinsics(SIZE, &central).unwrap();
    assert!(!report.fitted[8] && !report.fitted[5], "{report:#?}");
    assert!(report.corner_sigma_px < 4.0, "{report:#?}");
    for i in 0..4 {
        let off = (values(&report.intrinsics)[i] - values(&lens)[i]).abs();
        assert!(off < 4.0 * report.sigma[i], "{i} {report:#?}");
    }
}

#[test]
fn wrong_board_file_is_refused() {
    let mut views = views(&truth(), 9, 0.6, 0.05, 8);
    for points in &mut views {
        for point in points.iter_mut() {
            // Row spacing increases upwards.
            point.point_m.y += 4.0 * point.point_m.y * point.point_m.y;
            point.point_m.x += 3.0 * point.point_m.x * point.point_m.y;
        }
    }
    let message = calibrate_intrinsics(SIZE, &views).unwrap_err().to_string();
    assert!(message.contains("do not match the board file"), "{message}");
}
