//! Export of camera files.

use super::CameraFormat;
use gripcast_base::error::{Error, Result};
use gripcast_imaging::{DistortionModel, Intrinsics};

/// Formats a ROS `camera_info` YAML for raw images (no rectification).
///
/// # Errors
/// `Input` for a distortion model that ROS does not have; `Usage` for an invalid ROS camera name.
pub fn to_ros(intrinsics: &Intrinsics, camera_name: &str) -> Result<String> {
    let is_letter = |c: char| c.is_ascii_alphanumeric() || c == '_';
    if camera_name.is_empty() || !camera_name.chars().all(is_letter) {
        let what = format!("invalid ROS camera name {camera_name:?}");
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

/// Formats an OpenCV `FileStorage` YAML with the keys of OpenCV's calibration sample.
///
/// # Errors
/// `Input` for a distortion model that OpenCV does not have.
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

/// Coefficients k1, k2, p1, p2, k3 that map ideal to distorted coordinates.
fn plumb_bob(intrinsics: &Intrinsics, format: CameraFormat) -> Result<[f64; 5]> {
    match intrinsics.model {
        DistortionModel::None => Ok([0.0; 5]),
        DistortionModel::BrownConrady => Ok(intrinsics.coefficients),
        DistortionModel::InverseBrownConrady if intrinsics.coefficients == [0.0; 5] => Ok([0.0; 5]),
        DistortionModel::InverseBrownConrady => Err(Error::input(format!(
            "{} does not support the model inverse-brown-conrady (distorted to ideal coordinates)",
            match format {
                CameraFormat::Ros => "ROS",
                _ => "OpenCV",
            }
        ))
        .remedy("calibrate the camera to get brown-conrady coefficients")),
    }
}

fn numbers(values: &[f64]) -> String {
    let texts: Vec<String> = values.iter().map(|v| number(*v)).collect();
    texts.join(", ")
}

/// Shortest decimal that round-trips. YAML 1.1 (ROS's Python) requires a point and a signed
/// exponent.
fn number(value: f64) -> String {
    let text = format!("{value:?}");
    let Some((mantissa, exponent)) = text.split_once('e') else {
        return text;
    };
    let point = if mantissa.contains('.') { "" } else { ".0" };
    let sign = if exponent.starts_with('-') { "" } else { "+" };
    format!("{mantissa}{point}e{sign}{exponent}")
}
