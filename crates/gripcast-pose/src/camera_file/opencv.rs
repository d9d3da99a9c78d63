//! OpenCV `FileStorage` YAML, with the keys of OpenCV's calibration sample and common variants.

use serde::Deserialize;

use super::lens::{ForeignCamera, Matrix, unsupported};
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
    let read: Record = yaml::read(text, "the OpenCV camera file")?;
    if read.fisheye_model.is_some_and(|flag| flag != 0) {
        return Err(unsupported("OpenCV fisheye model"));
    }
    let missing = || {
        if read.left_of_pair.is_some() {
            return Error::input("the file describes a stereo pair (M1, D1, M2, D2)").remedy(
                "write M and D of one camera as camera_matrix and distortion_coefficients",
            );
        }
        Error::input("the file has no camera_matrix")
            .remedy("OpenCV's calibration writes camera_matrix and distortion_coefficients")
    };
    let matrix = read.camera_matrix.as_ref().ok_or_else(missing)?;
    let matrix = matrix.shaped("camera_matrix", [3, 3])?;
    let coefficients = read.distortion_coefficients.as_ref().ok_or_else(|| {
        Error::input("the file has no distortion_coefficients")
            .remedy("write five zeros for a lens without distortion")
    })?;
    Ok(ForeignCamera {
        width: read.image_width,
        height: read.image_height,
        matrix,
        coefficients: coefficients.numbers("distortion_coefficients")?.to_vec(),
        camera_name: read.camera_name,
        rms_px: read.avg_reprojection_error.filter(|e| e.is_finite()),
        notes: Vec::new(),
    })
}
