//! ROS `camera_info` YAML as written by `camera_calibration` and `camera_info_manager`.

use serde::Deserialize;

use super::lens::{ForeignCamera, Matrix, unsupported};
use crate::yaml;
use gripcast_base::error::{Error, Result};

/// Tolerance for the rectification matrix to be the identity.
const TOLERANCE: f64 = 1e-9;

#[derive(Deserialize)]
struct Record {
    image_width: Option<u32>,
    image_height: Option<u32>,
    camera_name: Option<String>,
    camera_matrix: Option<Matrix>,
    distortion_model: Option<String>,
    distortion_coefficients: Option<Matrix>,
    rectification_matrix: Option<Matrix>,
    projection_matrix: Option<Matrix>,
}

pub(super) fn read(text: &str) -> Result<ForeignCamera> {
    let read: Record = yaml::read(text, "the camera_info")?;
    let matrix = read
        .camera_matrix
        .ok_or_else(|| Error::input("the camera_info has no camera_matrix"))?
        .shaped("camera_matrix", [3, 3])?;
    let coefficients = match &read.distortion_coefficients {
        Some(list) => list.numbers("distortion_coefficients")?,
        None => &[],
    };
    check_model(read.distortion_model.as_deref(), coefficients)?;
    if let Some(matrix) = &read.rectification_matrix {
        check_rectification(&matrix.shaped("rectification_matrix", [3, 3])?)?;
    }
    let mut notes = Vec::new();
    if let Some(projection) = &read.projection_matrix {
        notes.extend(projection_note(projection, &matrix)?);
    }
    Ok(ForeignCamera {
        width: read.image_width,
        height: read.image_height,
        matrix,
        coefficients: coefficients.to_vec(),
        camera_name: read.camera_name,
        notes,
        ..ForeignCamera::default()
    })
}

fn check_model(model: Option<&str>, coefficients: &[f64]) -> Result<()> {
    match model.unwrap_or_default() {
        // The latter two are plumb_bob if their other coefficients are zero.
        "plumb_bob" | "rational_polynomial" | "thin_prism" => Ok(()),
        "" | "none" if coefficients.iter().all(|c| *c == 0.0) => Ok(()),
        "" => Err(
            Error::input("distortion_coefficients without a distortion_model")
                .remedy("add distortion_model: plumb_bob if they are k1, k2, p1, p2, k3"),
        ),
        other => Err(unsupported(format!("distortion model {other:?}"))),
    }
}

fn check_rectification(matrix: &[f64; 9]) -> Result<()> {
    let identity = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let is_identity = matrix
        .iter()
        .zip(identity)
        .all(|(a, b)| (a - b).abs() < TOLERANCE);
    if is_identity {
        return Ok(());
    }
    Err(Error::input(
        "the rectification_matrix is not the identity: the camera is one of a stereo pair",
    )
    .remedy(
        "for raw images, replace it by the identity; for rectified images, write a file with the \
         projection_matrix as camera_matrix and no distortion",
    ))
}

/// Notes a projection matrix that differs from the camera matrix: it is for rectified images.
fn projection_note(projection: &Matrix, matrix: &[f64; 9]) -> Result<Option<String>> {
    let p: [f64; 12] = projection.shaped("projection_matrix", [3, 4])?;
    let same = (0..3).all(|row| p[4 * row..4 * row + 3] == matrix[3 * row..3 * row + 3]);
    Ok((!same).then(|| {
        "the projection matrix differs from the camera matrix: it is for rectified images; use \
         raw images (image_raw) with this file"
            .to_owned()
    }))
}
