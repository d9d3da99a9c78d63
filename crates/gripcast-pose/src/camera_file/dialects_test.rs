//! Dialects of camera files as other programs write them.

use super::*;
use gripcast_imaging::DistortionModel;
use gripcast_testing::shared;

const K: &str = "[913.2, 0.0, 642.1, 0.0, 911.8, 357.4, 0.0, 0.0, 1.0]";

fn ros(model: &str, cols: usize, data: &str, rest: &str) -> String {
    format!(
        "image_width: 1280\nimage_height: 720\ncamera_matrix:\n  rows: 3\n  cols: 3\n  data: {K}\n\
         distortion_model: {model}\ndistortion_coefficients:\n  rows: 1\n  cols: {cols}\n  data: \
         [{data}]\n{rest}"
    )
}

fn read(text: &str) -> Result<CameraFile> {
    let options = CameraReadOptions {
        size: Some([1280, 720]),
        camera: None,
    };
    CameraFile::parse(text, options)
}

fn expect(text: &str, model: DistortionModel, coefficients: [f64; 5]) {
    let camera = match read(text) {
        Ok(file) => file.intrinsics,
        Err(error) => panic!("{error}: {text}"),
    };
    let found = [camera.fx, camera.fy, camera.cx, camera.cy];
    assert_eq!(found, [913.2, 911.8, 642.1, 357.4], "{text}");
    assert_eq!((camera.width, camera.height), (1280, 720), "{text}");
    assert_eq!(
        (camera.model, camera.coefficients),
        (model, coefficients),
        "{text}"
    );
}

const FIVE: &str = "0.05, -0.08, 0.0006, -0.0004, 0.01";
const COEFFICIENTS: [f64; 5] = [0.05, -0.08, 0.0006, -0.0004, 0.01];
const BROWN: DistortionModel = DistortionModel::BrownConrady;

#[test]
fn names_of_distortion_models_are_known() {
    for model in [
        "plumb_bob",
        "Plumb_Bob",
        "radtan",
        "brown_conrady",
        "Brown Conrady",
    ] {
        expect(&ros(model, 5, FIVE, ""), BROWN, COEFFICIENTS);
    }
    let inverse = DistortionModel::InverseBrownConrady;
    expect(
        &ros("Inverse Brown Conrady", 5, FIVE, ""),
        inverse,
        COEFFICIENTS,
    );
    for model in [
        "equidistant",
        "fisheye",
        "kannala_brandt4",
        "modified_brown_conrady",
    ] {
        let message = read(&ros(model, 5, FIVE, "")).unwrap_err().to_string();
        assert!(message.contains(model), "{message}");
    }
}

#[test]
fn coefficients_are_counted_and_split() {
    let eight = "0.05, -0.08, 0.0006, -0.0004, 0.01, 0, 0, 0";
    let zeros = ros("rational_polynomial", 5, eight, "");
    expect(&zeros, BROWN, COEFFICIENTS);
    assert!(read(&zeros).unwrap().notes[0].contains("all 8 numbers"));
    let used = eight.replace("0, 0, 0", "0.1, 0, 0");
    let message = read(&ros("rational_polynomial", 5, &used, "")).unwrap_err();
    assert!(message.to_string().contains("rational model"), "{message}");
    expect(
        &ros("plumb_bob", 5, &FIVE.replace(',', ""), ""),
        BROWN,
        COEFFICIENTS,
    );
    expect(
        &ros("plumb_bob", 5, FIVE, "").replace('\n', "\r\n"),
        BROWN,
        COEFFICIENTS,
    );
}

#[test]
fn binning_and_roi_are_applied() {
    let rest =
        "binning_x: 2\nbinning_y: 2\nroi:\n  x_offset: 0\n  y_offset: 0\n  height: 0\n  width: 0\n";
    let options = CameraReadOptions::default();
    let binned = CameraFile::parse(&ros("plumb_bob", 5, FIVE, rest), options).unwrap();
    let camera = binned.intrinsics;
    assert_eq!([camera.width, camera.height], [640, 360]);
    // Centres of binned pixels: (642.1 + 0.5) / 2 − 0.5.
    assert_eq!([camera.fx, camera.cx], [456.6, 320.8]);
    assert!(binned.notes[0].contains("640×360"), "{:?}", binned.notes);
    let rest =
        "binning_x: 0\nroi:\n  x_offset: 320\n  y_offset: 120\n  height: 480\n  width: 640\n";
    let camera = CameraFile::parse(&ros("plumb_bob", 5, FIVE, rest), options)
        .unwrap()
        .intrinsics;
    assert_eq!([camera.width, camera.height], [640, 480]);
    assert!((camera.cx - 322.1).abs() < 1e-9 && (camera.cy - 237.4).abs() < 1e-9);
    assert_eq!(camera.fx, 913.2);
}

#[test]
fn echoed_camera_info_is_read() {
    let listed = |text: &str| text.trim_matches(['[', ']']).replace(", ", "\n- ");
    let (k, d) = (listed(K), listed(FIVE));
    let two = format!(
        "header:\n  stamp:\n    sec: 1\n  frame_id: cam\nheight: 720\nwidth: 1280\ndistortion_model: \
         plumb_bob\nd:\n- {d}\nk:\n- {k}\nr:\n- 1.0\n- 0.0\n- 0.0\n- 0.0\n- 1.0\n- 0.0\n- 0.0\n- \
         0.0\n- 1.0\nbinning_x: 0\n---\nheader:\n"
    );
    expect(&two, BROWN, COEFFICIENTS);
    let one = format!(
        "header: \n  seq: 3\nheight: 720\nwidth: 1280\ndistortion_model: \"plumb_bob\"\nD: [{FIVE}]\n\
         K: {K}\n"
    );
    expect(&one, BROWN, COEFFICIENTS);
}

#[test]
fn opencv_storage_and_scripts_are_read() {
    let matrices = format!(
        "camera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: {K}\n\
         distortion_coefficients: !!opencv-matrix\n   rows: 1\n   cols: 5\n   dt: d\n   data: [{FIVE}]\n"
    );
    let nested = "[[913.2, 0, 642.1], [0, 911.8, 357.4], [0, 0, 1]]";
    let spaced = FIVE.replace(',', "");
    for text in [
        format!("%YAML:1.0\n{matrices}"),
        format!("%YAML:1.0\n---\nimage_size: [ 1280, 720 ]\n{matrices}"),
        format!("%YAML:1.0\n---\n{}", matrices.replace("   ", "\t")),
        format!(
            "%YAML:1.0\n---\n{}",
            matrices
                .replace("camera_matrix", "mtx")
                .replace("distortion_coefficients", "dist")
        ),
        format!(
            "%YAML:1.0\n---\n{}",
            matrices
                .replace("camera_matrix", "K")
                .replace("distortion_coefficients", "D")
        ),
        format!("{{\"camera_matrix\": {nested}, \"dist_coeff\": [[{FIVE}]]}}"),
        format!("camera_matrix: {nested}\ndist_coeff: [[{FIVE}]]\n"),
        format!(
            "<?xml version=\"1.0\"?>\n<opencv_storage>\n<image_Width>1280</image_Width>\n\
             <image_Height>720</image_Height>\n<Camera_Matrix type_id=\"opencv-matrix\"><rows>3</rows>\
             <cols>3</cols><dt>d</dt><data>\n  913.2 0. 642.1 0. 911.8\n 357.4 0. 0. 1.</data>\
             </Camera_Matrix>\n<Distortion_Coefficients type_id=\"opencv-matrix\"><rows>5</rows>\
             <cols>1</cols><dt>d</dt><data>{spaced}</data></Distortion_Coefficients></opencv_storage>"
        ),
    ] {
        expect(&text, BROWN, COEFFICIENTS);
    }
    for (text, expected) in [
        (
            format!("%YAML:1.0\n# flags: +fisheye::fix_skew\n{matrices}"),
            "fisheye",
        ),
        (format!("%YAML:1.0\nK: [1, 2]\n{matrices}"), "differ"),
        (
            format!("camera_matrix: {}\ndist: [0]\n", "[[1, 2], [3, 4]]"),
            "3 × 3",
        ),
        (format!("image_size: [1280]\n{matrices}"), "[width, height]"),
    ] {
        let message = read(&text).unwrap_err().to_string();
        assert!(message.contains(expected), "{expected}: {message}");
    }
}

/// Files of the field: read with the intrinsics that all of them have, or refused with a cause.
#[test]
fn field_files_are_read_or_refused_with_the_cause() {
    const REFUSED: &[(&str, &str)] = &[
        ("cam-ros/cols5_data8.yaml", "rational model"),
        ("cam-ros/rational8.yaml", "rational model"),
        ("cam-ros/equidistant.yaml", "\"equidistant\""),
        ("cam-ros/fisheye_ros.yaml", "\"fisheye\""),
        ("cam-kalibr/equi.yaml", "\"equi\""),
        ("cam-kalibr/omni.yaml", "\"omni\""),
        ("cam-cv/cam.xml", "no camera_matrix"),
        ("cam-cv/fisheye4.yml", "fisheye"),
        ("cam-cv/fisheye_flagless.yml", "fisheye"),
        ("cam-cv/nan.yml", "NaN"),
    ];
    for folder in ["cam-ros", "cam-kalibr", "cam-cv"] {
        let Some(path) = shared(&format!("field/mesh-sim-pose/{folder}")) else {
            return;
        };
        for entry in std::fs::read_dir(path).unwrap() {
            let path = entry.unwrap().path();
            let file = path.file_name().unwrap().to_str().unwrap();
            if file == "README" {
                continue;
            }
            let name = format!("{folder}/{file}");
            let text = std::fs::read_to_string(&path).unwrap();
            let is_reduced = name.contains("roi_");
            let found = match is_reduced {
                true => CameraFile::parse(&text, CameraReadOptions::default()),
                false => read(&text),
            };
            let refused = REFUSED.iter().find(|(refused, _)| *refused == name);
            match (found, refused) {
                (Ok(found), None) => {
                    let fx = found.intrinsics.fx;
                    let expected = if name.contains("binning") {
                        456.6
                    } else {
                        913.2
                    };
                    assert!((fx - expected).abs() < 0.5, "{name}: {fx}");
                }
                (Err(error), Some((_, cause))) => {
                    assert!(error.to_string().contains(cause), "{name}: {error}");
                }
                (found, _) => panic!("{name}: {found:?}"),
            }
        }
    }
}
