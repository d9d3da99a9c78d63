//! OpenCV's `FileStorage`, YAML, with the keys of its calibration sample and their usual variants.

use serde::Deserialize;

use super::lens::{ForeignCamera, Matrix, unknown_lens};
use crate::yaml;
use gripcast_base::error::{Error, Result};

#[derive(Deserialize)]
struct Record {
    #[serde(alias = "image_Width", alias = "imageWidth", alias = "width")]
    image_width: Option<u32>,
    #[serde(alias = "image_Height", alias = "imageHeight", alias = "height")]
    image_height: Option<u32>,
    camera_name: Option<String>,
    #[serde(
        alias = "Camera_Matrix",
        alias = "cameraMatrix",
        alias = "CameraMatrix",
        alias = "K"
    )]
    camera_matrix: Option<Matrix>,
    #[serde(
        alias = "Distortion_Coefficients",
        alias = "distortionCoefficients",
        alias = "distCoeffs",
        alias = "dist_coeffs",
        alias = "dist_coeff",
        alias = "D"
    )]
    distortion_coefficients: Option<Matrix>,
    #[serde(alias = "Avg_Reprojection_Error")]
    avg_reprojection_error: Option<f64>,
    #[serde(alias = "fisheye")]
    fisheye_model: Option<i64>,
    #[serde(rename = "M1")]
    left_of_pair: Option<Matrix>,
}

pub(super) fn read(text: &str) -> Result<ForeignCamera> {
    let read: Record = yaml::read(text, "the camera file of OpenCV")?;
    if read.fisheye_model.is_some_and(|flag| flag != 0) {
        return Err(unknown_lens("OpenCV's fisheye model"));
    }
    let missing = || {
        if read.left_of_pair.is_some() {
            return Error::input("this is the file of a stereo pair (M1, D1, M2, D2)")
                .remedy("write one camera's M and D as camera_matrix and distortion_coefficients");
        }
        Error::input("the file has no camera_matrix")
            .remedy("OpenCV's calibration writes camera_matrix and distortion_coefficients")
    };
    let matrix = read.camera_matrix.as_ref().ok_or_else(missing)?;
    let matrix = matrix.square("camera_matrix")?;
    let coefficients = match &read.distortion_coefficients {
        Some(list) => list.numbers("distortion_coefficients")?,
        None => {
            return Err(Error::input("the file has no distortion_coefficients")
                .remedy("a lens without distortion has five zeros"));
        }
    };
    Ok(ForeignCamera {
        width: read.image_width,
        height: read.image_height,
        matrix,
        coefficients: coefficients.to_vec(),
        camera_name: read.camera_name,
        rms_px: read.avg_reprojection_error.filter(|e| e.is_finite()),
        notes: Vec::new(),
    })
}
