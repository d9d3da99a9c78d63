//! Camera files for other programs.

use super::CameraFormat;
use gripcast_base::error::{Error, Result};
use gripcast_imaging::{DistortionModel, Intrinsics};

/// The text of a `camera_info` YAML of ROS for raw images: no rectification.
///
/// # Errors
/// `Input` for a lens that ROS has no name for; `Usage` for a camera name that ROS does not take.
pub fn to_ros(intrinsics: &Intrinsics, camera_name: &str) -> Result<String> {
    let is_letter = |c: char| c.is_ascii_alphanumeric() || c == '_';
    if camera_name.is_empty() || !camera_name.chars().all(is_letter) {
        let what = format!("ROS takes no camera named {camera_name:?}");
        return Err(Error::usage(what)
            .remedy("use letters, digits and underscores: --camera-name external"));
    }
    let coefficients = plumb_bob(intrinsics, CameraFormat::Ros)?;
    let k = matrix(intrinsics);
    let [fx, _, cx, _, fy, cy, ..] = k;
    let projection = [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0];
    let identity = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let block = |name: &str, rows: usize, data: &[f64]| {
        let columns = data.len() / rows;
        let data = numbers(data);
        format!("{name}:\n  rows: {rows}\n  cols: {columns}\n  data: [{data}]\n")
    };
    Ok(format!(
        "image_width: {}\nimage_height: {}\ncamera_name: \"{camera_name}\"\n{}\
         distortion_model: plumb_bob\n{}{}{}",
        intrinsics.width,
        intrinsics.height,
        block("camera_matrix", 3, &k),
        block("distortion_coefficients", 1, &coefficients),
        block("rectification_matrix", 3, &identity),
        block("projection_matrix", 3, &projection),
    ))
}

/// The text of a YAML of OpenCV's `FileStorage`, with the keys of its calibration sample.
///
/// # Errors
/// `Input` for a lens that OpenCV has no coefficients for.
pub fn to_opencv(intrinsics: &Intrinsics, rms_px: Option<f64>) -> Result<String> {
    let coefficients = plumb_bob(intrinsics, CameraFormat::Opencv)?;
    let block = |name: &str, rows: usize, data: &[f64]| {
        let columns = data.len() / rows;
        let data = numbers(data);
        format!(
            "{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   \
             data: [ {data} ]\n"
        )
    };
    let error = rms_px.filter(|e| e.is_finite());
    let error = error.map_or(String::new(), |e| {
        format!("avg_reprojection_error: {}\n", number(e))
    });
    Ok(format!(
        "%YAML:1.0\n---\nimage_width: {}\nimage_height: {}\n{}{}{error}",
        intrinsics.width,
        intrinsics.height,
        block("camera_matrix", 3, &matrix(intrinsics)),
        block("distortion_coefficients", 5, &coefficients),
    ))
}

fn matrix(i: &Intrinsics) -> [f64; 9] {
    [i.fx, 0.0, i.cx, 0.0, i.fy, i.cy, 0.0, 0.0, 1.0]
}

/// The coefficients for programs that bend ideal coordinates into distorted ones.
fn plumb_bob(intrinsics: &Intrinsics, format: CameraFormat) -> Result<[f64; 5]> {
    match intrinsics.model {
        DistortionModel::None => Ok([0.0; 5]),
        DistortionModel::BrownConrady => Ok(intrinsics.coefficients),
        DistortionModel::InverseBrownConrady if intrinsics.coefficients == [0.0; 5] => Ok([0.0; 5]),
        DistortionModel::InverseBrownConrady => Err(Error::input(format!(
            "the lens has the model inverse-brown-conrady (distorted coordinates to ideal \
                 ones), which {} has not: its coefficients run the other way",
            match format {
                CameraFormat::Ros => "ROS",
                _ => "OpenCV",
            }
        ))
        .remedy("calibrate the camera: that gives brown-conrady coefficients")),
    }
}

fn numbers(values: &[f64]) -> String {
    let texts: Vec<String> = values.iter().map(|v| number(*v)).collect();
    texts.join(", ")
}

/// The shortest decimal that reads back as the same number. YAML 1.1 (ROS's Python) takes an
/// exponent for a number only after a point and with a sign.
fn number(value: f64) -> String {
    let text = format!("{value:?}");
    let Some((mantissa, exponent)) = text.split_once('e') else {
        return text;
    };
    let point = if mantissa.contains('.') { "" } else { ".0" };
    let sign = if exponent.starts_with('-') { "" } else { "+" };
    format!("{mantissa}{point}e{sign}{exponent}")
}
