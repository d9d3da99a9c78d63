//! Round trips of every format, and malformed files.

use super::*;
use gripcast_base::error::ErrorKind;
use gripcast_imaging::DistortionModel;

const ROS: &str = "\
image_width: 1280
image_height: 720
camera_name: external
camera_matrix:
  rows: 3
  cols: 3
  data: [915.25, 0, 642.8, 0, 911, 357.4, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [0.12, -0.25, 0.0007, -4e-4, 0.08]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
projection_matrix:
  rows: 3
  cols: 4
  data: [915.25, 0, 642.8, 0, 0, 911, 357.4, 0, 0, 0, 1, 0]
";

const OPENCV: &str = "\
%YAML:1.0
---
calibration_time: \"Mon 03 Aug 2026\"
image_width: 1280
image_height: 720
flags: 0
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 9.1525000000000000e+02, 0., 6.4280000000000000e+02, 0.,
       9.1100000000000000e+02, 3.5740000000000000e+02, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ 1.2000000000000000e-01, -2.5000000000000000e-01,
       7.0000000000000000e-04, -4.0000000000000000e-04,
       8.0000000000000000e-02 ]
avg_reprojection_error: 1.8750000000000000e-01
";

const KALIBR: &str = "\
cam0:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [0.12, -0.25, 0.0007, -0.0004]
  distortion_model: radtan
  intrinsics: [915.25, 911, 642.8, 357.4]
  resolution: [1280, 720]
  rostopic: /cam0/image_raw
cam1:
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, -0.1]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: [0.01, 0.02, 0.0, 0.0]
  distortion_model: equidistant
  intrinsics: [900, 901, 640, 360]
  resolution: [1280, 720]
";

fn camera() -> Intrinsics {
    Intrinsics {
        width: 1280,
        height: 720,
        fx: 915.25,
        fy: 911.0,
        cx: 642.8,
        cy: 357.4,
        model: DistortionModel::BrownConrady,
        coefficients: [0.12, -0.25, 0.0007, -0.0004, 0.08],
    }
}

fn read(text: &str) -> Result<CameraFile> {
    CameraFile::parse(text, CameraReadOptions::default())
}

fn chosen(camera: &str) -> CameraReadOptions<'_> {
    CameraReadOptions {
        camera: Some(camera),
        ..CameraReadOptions::default()
    }
}

#[test]
fn all_formats_are_read() {
    let ros = read(ROS).unwrap();
    assert_eq!((ros.format, ros.intrinsics), (CameraFormat::Ros, camera()));
    assert_eq!(ros.camera_name.as_deref(), Some("external"));
    assert!(ros.notes.is_empty());
    let opencv = read(OPENCV).unwrap();
    assert_eq!(opencv.format, CameraFormat::Opencv);
    assert_eq!((opencv.intrinsics, opencv.rms_px), (camera(), Some(0.1875)));
    let kalibr = CameraFile::parse(KALIBR, chosen("cam0")).unwrap();
    assert_eq!(kalibr.format, CameraFormat::Kalibr);
    let mut four = camera();
    four.coefficients[4] = 0.0;
    assert_eq!(kalibr.intrinsics, four);
    let toml = toml::to_string(&camera()).unwrap();
    assert_eq!(read(&toml).unwrap().intrinsics, camera());
}

#[test]
fn written_files_round_trip_exactly() {
    let mut unusual = camera();
    unusual.fx = 915.123_456_789_012_3;
    unusual.coefficients = [1e-7, -1.0 / 3.0, 1.5e-17, -0.0, 2.5e-3];
    for intrinsics in [camera(), unusual] {
        let ros = read(&to_ros(&intrinsics, "left_2").unwrap()).unwrap();
        assert_eq!(ros.intrinsics, intrinsics);
        assert_eq!(ros.camera_name.as_deref(), Some("left_2"));
        assert!(ros.notes.is_empty());
        let opencv = read(&to_opencv(&intrinsics, Some(0.1)).unwrap()).unwrap();
        assert_eq!((opencv.intrinsics, opencv.rms_px), (intrinsics, Some(0.1)));
    }
    // YAML 1.1 reads 1e-7 as a string.
    assert!(to_ros(&unusual, "c").unwrap().contains("[1.0e-7, "));
    let straight = Intrinsics {
        model: DistortionModel::None,
        coefficients: [0.0; 5],
        ..camera()
    };
    let back = read(&to_opencv(&straight, None).unwrap()).unwrap();
    assert_eq!((back.intrinsics, back.rms_px), (straight, None));
}

#[test]
fn unsupported_models_are_not_written() {
    let inverse = Intrinsics {
        model: DistortionModel::InverseBrownConrady,
        ..camera()
    };
    let message = to_ros(&inverse, "c").unwrap_err().to_string();
    assert!(
        message.contains("inverse-brown-conrady") && message.contains("ROS"),
        "{message}"
    );
    assert!(to_opencv(&inverse, None).is_err());
    let straight = Intrinsics {
        coefficients: [0.0; 5],
        ..inverse
    };
    assert!(to_opencv(&straight, None).is_ok());
    for name in ["", "a b", "ü", "a:b"] {
        assert_eq!(
            to_ros(&camera(), name).unwrap_err().kind(),
            ErrorKind::Usage
        );
    }
}

#[test]
fn file_without_size_needs_size_option() {
    let text = OPENCV.replace("image_width: 1280\nimage_height: 720\n", "");
    let message = read(&text).unwrap_err().to_string();
    assert!(message.contains("--size 1280x720"), "{message}");
    let sized = |size| CameraReadOptions {
        size: Some(size),
        camera: None,
    };
    let file = CameraFile::parse(&text, sized([1280, 720])).unwrap();
    assert_eq!(file.intrinsics, camera());
    let message = CameraFile::parse(OPENCV, sized([640, 480])).unwrap_err();
    assert!(message.to_string().contains("1280×720"), "{message}");
    let message = CameraFile::parse(&text, sized([64, 48])).unwrap_err();
    assert!(message.to_string().contains("implausible"), "{message}");
}

#[test]
fn require_size_refuses_other_image_size() {
    assert!(require_size(&camera(), 1280, 720).is_ok());
    let error = require_size(&camera(), 1920, 1080).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Input);
    let message = error.to_string();
    assert!(
        message.contains("1280×720") && message.contains("1920×1080"),
        "{message}"
    );
    assert!(message.contains("calibrate at 1920×1080"), "{message}");
}

#[test]
fn malformed_ros_files_are_refused() {
    for (from, to, expected) in [
        ("plumb_bob", "equidistant", "\"equidistant\""),
        (
            "distortion_model: plumb_bob\n",
            "",
            "without a distortion_model",
        ),
        (
            "[915.25, 0, 642.8, 0, 911",
            "[915.25, 0.5, 642.8, 0, 911",
            "skew of 0.5",
        ),
        (
            "357.4, 0, 0, 1]\ndist",
            "357.4, 0, 0, 2]\ndist",
            "row by row",
        ),
        (
            "data: [1, 0, 0, 0, 1, 0, 0, 0, 1]",
            "data: [0.9, 0.1, 0, 0, 1, 0, 0, 0, 1]",
            "stereo",
        ),
        ("  cols: 5", "  cols: 4", "expected 1 × 4 numbers, found 5"),
        ("0.08]", ".nan]", "non-finite"),
        ("image_width: 1280", "image_width: wide", "found wide"),
        ("image_width: 1280\n", "", "image size"),
        ("[915.25", "[0.91525", "implausible"),
        (
            "cols: 5\n  data: [0.12, -0.25, 0.0007, -4e-4, 0.08]",
            "cols: 8\n  data: [0.12, -0.25, 0.0007, -4e-4, 0.08, 0, 0.3, 0]",
            "rational model",
        ),
        (
            "cols: 5\n  data: [0.12, -0.25, 0.0007, -4e-4, 0.08]",
            "cols: 12\n  data: [0, 0, 0, 0, 0, 0, 0, 0, 0, 0.1, 0, 0]",
            "thin prism model",
        ),
        (
            "cols: 5\n  data: [0.12, -0.25, 0.0007, -4e-4, 0.08]",
            "cols: 3\n  data: [0.12, -0.25, 0.0007]",
            "found 3",
        ),
        ("rows: 3\n  cols: 4", "rows: 4\n  cols: 3", "must be 3 × 4"),
        (
            "  data: [915.25, 0, 642.8, 0, 911, 357.4, 0, 0, 1]\n",
            "",
            "camera_matrix: expected numbers",
        ),
    ] {
        assert!(ROS.contains(from), "{from}");
        let message = read(&ROS.replacen(from, to, 1)).unwrap_err().to_string();
        assert!(message.contains(expected), "{from} → {to}: {message}");
    }
    let zeros = ROS.replace("plumb_bob", "rational_polynomial").replace(
        "cols: 5\n  data: [0.12, -0.25, 0.0007, -4e-4, 0.08]",
        "cols: 8\n  data: [0.12, -0.25, 0.0007, -4e-4, 0.08, 0, 0, 0]",
    );
    assert_eq!(read(&zeros).unwrap().intrinsics, camera());
    let rectified = ROS.replace(
        "data: [915.25, 0, 642.8, 0, 0,",
        "data: [900, 0, 642.8, 0, 0,",
    );
    assert!(read(&rectified).unwrap().notes[0].contains("image_raw"));
}

#[test]
fn malformed_opencv_and_kalibr_files_are_refused() {
    for (from, to, expected) in [
        ("flags: 0", "fisheye_model: 1", "fisheye"),
        ("camera_matrix:", "M1:", "stereo pair"),
        ("camera_matrix:", "matrix:", "no camera_matrix"),
        ("distortion_coefficients:", "coefficients:", "five zeros"),
        ("rows: 5", "rows: 6", "expected 6 × 1 numbers, found 5"),
    ] {
        assert!(OPENCV.contains(from), "{from}");
        let message = read(&OPENCV.replacen(from, to, 1)).unwrap_err().to_string();
        assert!(message.contains(expected), "{from} → {to}: {message}");
    }
    let message = read(KALIBR).unwrap_err().to_string();
    assert!(
        message.contains("2 cameras") && message.contains("cam0, cam1"),
        "{message}"
    );
    let message = CameraFile::parse(KALIBR, chosen("cam1"))
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("cam1: ") && message.contains("equidistant"),
        "{message}"
    );
    assert!(CameraFile::parse(KALIBR, chosen("cam7")).is_err());
    for (from, to, expected) in [
        ("pinhole", "omni", "\"omni\""),
        ("[915.25, 911, 642.8, 357.4]", "[915.25, 911]", "4 numbers"),
        ("  resolution: [1280, 720]\n", "", "image size"),
    ] {
        let text = KALIBR.replacen(from, to, 1);
        let message = CameraFile::parse(&text, chosen("cam0"))
            .unwrap_err()
            .to_string();
        assert!(message.contains(expected), "{from} → {to}: {message}");
    }
}

#[test]
fn unknown_formats_are_refused() {
    for (text, expected) in [
        (
            "<?xml version=\"1.0\"?><opencv_storage/>",
            "no camera_matrix",
        ),
        ("{\"camera_matrix\": 1}", "no distortion_coefficients"),
        ("", "unknown camera file format"),
        ("hello\n", "unknown camera file format"),
        ("width = 3\n", "missing field"),
        ("camera_matrix: 3\n", "no distortion_coefficients"),
    ] {
        let message = read(text).unwrap_err().to_string();
        assert!(message.contains(expected), "{text}: {message}");
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("c.yaml");
    std::fs::write(&path, [0xff, 0xfe, 0x00]).unwrap();
    let message = load_intrinsics(&path).unwrap_err().to_string();
    assert!(
        message.contains("c.yaml") && message.contains("not UTF-8"),
        "{message}"
    );
    let missing = load_intrinsics(Path::new("/proc/nonexistent/c.yaml")).unwrap_err();
    assert_eq!(missing.kind(), ErrorKind::NotFound);
}

#[test]
fn damaged_files_give_valid_camera_or_error() {
    let check = |text: &str| match CameraFile::parse(text, chosen("cam0")) {
        Ok(file) => {
            assert!(file.intrinsics.validate().is_ok(), "{text}");
            true
        }
        Err(error) => {
            let expected = [ErrorKind::Input, ErrorKind::Config, ErrorKind::Usage];
            assert!(expected.contains(&error.kind()), "{error}: {text}");
            false
        }
    };
    for text in [ROS, OPENCV, KALIBR] {
        let mut rejected = 0;
        for at in (0..text.len()).step_by(7) {
            rejected += usize::from(!check(&text[..at]));
            for byte in ["[", ":", "-", "9", "&a", "*a", "\0"] {
                check(&format!("{}{byte}{}", &text[..at], &text[at + 1..]));
            }
        }
        // Most cuts remove something that is needed.
        assert!(
            rejected > text.len() / 7 / 4,
            "{rejected} of {}",
            text.len() / 7
        );
    }
}
