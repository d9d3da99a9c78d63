use glam::DVec2;
use image::GrayImage;
use image::imageops::flip_horizontal;
use rand::SeedableRng as _;
use rand_pcg::Pcg64;

use super::intrinsics_test::{poses, truth};
use super::{Collector, CollectorSettings, PointFinder, Rejection};
use crate::camera::project;
use crate::detect::{ApriltagDetector, ApriltagSettings};
use crate::synthetic::{ImageConditions, render_board, ring_board};
use crate::{BoardFile, Chessboard, Dictionary, MarkerDetector as _};
use gripcast_geometry::Pose;
use gripcast_imaging::Intrinsics;
use gripcast_testing::{Needs, skip};

fn charuco() -> BoardFile {
    let dictionary = Dictionary::by_name("DICT_6X6_250").unwrap();
    let chessboard = Chessboard {
        squares: [9, 6],
        square_mm: [26.0, 26.0],
        legacy: false,
        printed_hash: None,
    };
    let board = chessboard.board("c", &dictionary, 0, [18.0; 2]).unwrap();
    let file = BoardFile::new(board, dictionary, None).unwrap();
    file.with_chessboard(chessboard).unwrap()
}

fn small_lens() -> Intrinsics {
    let lens = truth();
    Intrinsics {
        width: 640,
        height: 480,
        fx: 0.62 * lens.fx,
        fy: 0.62 * lens.fy,
        cx: 325.0,
        cy: 236.0,
        ..lens
    }
}

fn image(lens: &Intrinsics, file: &BoardFile, pose: &Pose, seed: u64) -> GrayImage {
    let conditions = ImageConditions {
        psf_px: 0.6,
        noise: 2.0,
        ..ImageConditions::default()
    };
    render_board(lens, file, pose, &conditions, seed).image
}

#[test]
fn chessboard_corners_have_no_bias() {
    let (lens, file) = (truth(), charuco());
    let finder = PointFinder::new(&file).unwrap();
    let mut detector = ApriltagDetector::new(
        &file.dictionary,
        &file.board.ids(),
        ApriltagSettings::default(),
    )
    .unwrap();
    let mut random = Pcg64::seed_from_u64(2);
    let mut errors: Vec<DVec2> = Vec::new();
    let mut visible = 0;
    for (seed, pose) in poses(4, &mut random, 0.6).iter().enumerate() {
        let image = image(&lens, &file, pose, seed as u64);
        let detections = detector.detect(&image).unwrap();
        let found = finder.find(&image, &detections);
        let corners = file.chessboard.as_ref().unwrap().corners_m();
        for corner in &corners {
            let pixel = project(&lens, pose.transform_point(corner.extend(0.0))).unwrap();
            let inside = pixel.cmpgt(DVec2::splat(40.0)).all()
                && pixel.cmplt(DVec2::new(1240.0, 680.0)).all();
            visible += usize::from(inside);
        }
        for point in found.points {
            let corner = corners[point.index as usize];
            let pixel = project(&lens, pose.transform_point(corner.extend(0.0))).unwrap();
            errors.push(point.pixel - pixel);
        }
    }
    let mean = errors.iter().sum::<DVec2>() / errors.len() as f64;
    let mut lengths: Vec<f64> = errors.iter().map(|e| e.length()).collect();
    lengths.sort_by(f64::total_cmp);
    let (median, worst) = (lengths[lengths.len() / 2], lengths[lengths.len() - 1]);
    println!(
        "{} of {visible}: bias {mean:.4}, median {median:.4}, worst {worst:.3}",
        errors.len()
    );
    assert!(errors.len() * 10 > visible * 9);
    assert!(median < 0.04 && worst < 0.3 && mean.length() < 0.01);
}

#[test]
fn charuco_images_recover_intrinsics() {
    let (lens, file) = (small_lens(), charuco());
    let mut collector = Collector::new(&file, CollectorSettings::default()).unwrap();
    let mut random = Pcg64::seed_from_u64(3);
    for (seed, pose) in poses(28, &mut random, 0.6).iter().enumerate() {
        let add_image = collector
            .add_image(&image(&lens, &file, pose, seed as u64))
            .unwrap();
        println!("{add_image:?}");
    }
    let report = collector.finish().unwrap();
    println!("{report:#?}");
    assert!(report.rms_px < 0.1);
    let found = report.intrinsics;
    assert!((found.fx / lens.fx - 1.0).abs() < 1e-3 && (found.fy / lens.fy - 1.0).abs() < 1e-3);
    assert!((found.cx - lens.cx).abs() < 1.0 && (found.cy - lens.cy).abs() < 1.0);
}

#[test]
fn marker_images_recover_intrinsics() {
    let lens = small_lens();
    let dictionary = Dictionary::by_name("DICT_6X6_250").unwrap();
    let file = BoardFile::new(ring_board(&dictionary), dictionary, None).unwrap();
    let mut collector = Collector::new(&file, CollectorSettings::default()).unwrap();
    let mut random = Pcg64::seed_from_u64(4);
    for (seed, pose) in poses(12, &mut random, 0.6).iter().enumerate() {
        let image = image(&lens, &file, pose, seed as u64);
        collector.add_image(&image).unwrap();
    }
    let report = collector.finish().unwrap();
    println!("{report:#?}");
    let found = report.intrinsics;
    assert!(report.rms_px < 0.15);
    assert!((found.fx / lens.fx - 1.0).abs() < 2e-3 && (found.fy / lens.fy - 1.0).abs() < 2e-3);
    assert!((found.cx - lens.cx).abs() < 1.0 && (found.cy - lens.cy).abs() < 1.0);
}

#[test]
fn plain_chessboards_recover_intrinsics() {
    let lens = small_lens();
    // Alike upside down, of another colour upside down, and as many columns as rows.
    for corners in [[9, 6], [8, 6], [6, 6]] {
        let file = BoardFile::plain_chessboard("plain", corners, [26.0; 2]).unwrap();
        let mut collector = Collector::new(&file, CollectorSettings::default()).unwrap();
        let mut random = Pcg64::seed_from_u64(3);
        let (mut used, mut missed) = (0, 0);
        for (seed, pose) in poses(14, &mut random, 0.6).iter().enumerate() {
            let image = image(&lens, &file, pose, seed as u64);
            let added = collector.add_image(&image).unwrap();
            let is_visible = file
                .chessboard
                .as_ref()
                .unwrap()
                .corners_m()
                .iter()
                .all(|c| {
                    let pixel = project(&lens, pose.transform_point(c.extend(0.0))).unwrap();
                    pixel.cmpgt(DVec2::splat(14.0)).all()
                        && pixel.cmplt(DVec2::new(625.0, 465.0)).all()
                });
            used += usize::from(added.rejection.is_none());
            missed += usize::from(is_visible && added.points == 0);
        }
        assert!(used >= 5 && missed <= 1, "{used} used, {missed} missed");
        let report = collector.finish().unwrap();
        let found = report.intrinsics;
        assert!(report.rms_px < 0.1, "{corners:?} {}", report.rms_px);
        assert!(
            (found.fx / lens.fx - 1.0).abs() < 5e-3,
            "{corners:?} {}",
            found.fx
        );
        assert!((found.cx - lens.cx).abs() < 3.0 && (found.cy - lens.cy).abs() < 3.0);
    }
}

#[test]
fn chessboard_that_is_not_whole_is_rejected() {
    let (lens, file) = (small_lens(), charuco());
    let larger = BoardFile::plain_chessboard("larger", [9, 6], [18.0; 2]).unwrap();
    let plain = BoardFile::plain_chessboard("plain", [7, 5], [26.0; 2]).unwrap();
    let mut collector = Collector::new(&plain, CollectorSettings::default()).unwrap();
    let mut random = Pcg64::seed_from_u64(3);
    for pose in poses(3, &mut random, 0.6) {
        // Other boards, and nothing.
        let others = [
            image(&lens, &file, &pose, 0),
            image(&lens, &larger, &pose, 0),
        ];
        for image in others.into_iter().chain([GrayImage::new(640, 480)]) {
            let added = collector.add_image(&image).unwrap();
            assert_eq!(added.rejection, Some(Rejection::NoChessboard([7, 5])));
        }
    }
    assert!(collector.add_image(&GrayImage::new(4, 4)).is_err());
}

#[test]
fn given_views_are_the_same_if_their_poses_are() {
    let (lens, file) = (small_lens(), charuco());
    let mut random = Pcg64::seed_from_u64(5);
    let pose = poses(2, &mut random, 0.6)[1];
    // Live images are plenty: there, views must differ by 8°.
    for (still, views) in [(false, 2), (true, 1)] {
        let settings = CollectorSettings {
            still,
            ..CollectorSettings::default()
        };
        let mut collector = Collector::new(&file, settings).unwrap();
        for degrees in [0.0f64, 4.0, 5.0] {
            let turn = glam::DQuat::from_rotation_z(degrees.to_radians());
            let turned = Pose::new(pose.rotation * turn, pose.translation_m);
            let image = image(&lens, &file, &turned, 1);
            // The second image of a static board is used.
            collector.add_image(&image).unwrap();
            collector.add_image(&image).unwrap();
        }
        assert_eq!(collector.views().len(), views);
    }
}

#[test]
fn unusable_images_are_rejected() {
    let (lens, file) = (small_lens(), charuco());
    let settings = CollectorSettings::default();
    let mut collector = Collector::new(&file, settings).unwrap();
    let mut random = Pcg64::seed_from_u64(5);
    let poses = poses(4, &mut random, 0.6);
    let first = image(&lens, &file, &poses[1], 0);
    let rejection = |collector: &mut Collector, image: &GrayImage| {
        collector.add_image(image).unwrap().rejection
    };
    assert_eq!(rejection(&mut collector, &first), None);
    let again = image(&lens, &file, &poses[1], 1);
    assert_eq!(
        rejection(&mut collector, &again),
        Some(Rejection::Duplicate(0))
    );
    assert_eq!(
        rejection(&mut collector, &flip_horizontal(&first)),
        Some(Rejection::NoBoard)
    );
    let other = GrayImage::new(320, 240);
    assert_eq!(
        rejection(&mut collector, &other),
        Some(Rejection::Size([320, 240], [640, 480]))
    );
    let blurred = ImageConditions {
        psf_px: 2.6,
        ..ImageConditions::default()
    };
    let blurred = render_board(&lens, &file, &poses[2], &blurred, 2).image;
    let rejected = rejection(&mut collector, &blurred);
    assert!(
        matches!(rejected, Some(Rejection::Blurred(_) | Rejection::NoBoard)),
        "{rejected:?}"
    );
    assert_eq!(collector.views().len(), 1);
    assert!(collector.add_image(&GrayImage::new(4, 4)).is_err());
    // A live camera needs a static board.
    let still = CollectorSettings {
        still: true,
        ..settings
    };
    let mut live = Collector::new(&file, still).unwrap();
    assert!(matches!(
        rejection(&mut live, &first),
        Some(Rejection::Moving(_))
    ));
    assert_eq!(rejection(&mut live, &again), None);
    let message = live.finish().unwrap_err().to_string();
    assert!(message.contains("at least 3 usable views"), "{message}");
}

/// OpenCV's tutorial images of a board of 5 × 7 squares of 40 mm with markers of 20 mm, in a
/// folder that `GRIPCAST_CHARUCO` names.
#[test]
fn real_charuco_images_are_calibrated() {
    let Some(folder) = std::env::var_os("GRIPCAST_CHARUCO") else {
        return skip(
            Needs::Charuco,
            "set GRIPCAST_CHARUCO to a folder with img_00.jpg to img_03.jpg of OpenCV's ChArUco \
             tutorial",
        );
    };
    let dictionary = Dictionary::by_name("DICT_6X6_250").unwrap();
    let chessboard = Chessboard {
        squares: [5, 7],
        square_mm: [40.0, 40.0],
        legacy: true,
        printed_hash: None,
    };
    let board = chessboard
        .board("tutorial", &dictionary, 0, [20.0; 2])
        .unwrap();
    let file = BoardFile::new(board, dictionary, None).unwrap();
    let file = file.with_chessboard(chessboard).unwrap();
    let mut collector = Collector::new(&file, CollectorSettings::default()).unwrap();
    let mut decoder = gripcast_imaging::Decoder::new().unwrap();
    for k in 0..4 {
        let path = std::path::Path::new(&folder).join(format!("img_0{k}.jpg"));
        let bytes = std::fs::read(&path).unwrap();
        let image = decoder.decode_file(&bytes, None, 640, 480).unwrap();
        let add_image = collector
            .add_image(&image::imageops::grayscale(&image))
            .unwrap();
        println!("{}: {add_image:?}", path.display());
    }
    let report = collector.finish().unwrap();
    println!("{report:#?}");
    assert!(report.rms_px <= 0.20, "{}", report.rms_px);
    assert!((440.0..475.0).contains(&report.intrinsics.fx));
}
