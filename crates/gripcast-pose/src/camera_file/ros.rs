//! `camera_info` of ROS, as `camera_calibration` and `camera_info_manager` write it.

use serde::Deserialize;

use super::lens::{ForeignCamera, Matrix, unknown_lens};
use crate::yaml;
use gripcast_base::error::{Error, Result};

/// Entries this near to those of the identity are rounding.
const ROUNDING: f64 = 1e-9;

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
        .square("camera_matrix")?;
    let coefficients = match &read.distortion_coefficients {
        Some(list) => list.numbers("distortion_coefficients")?,
        None => &[],
    };
    check_model(read.distortion_model.as_deref(), coefficients)?;
    if let Some(matrix) = &read.rectification_matrix {
        check_rectification(&matrix.square("rectification_matrix")?)?;
    }
    let mut notes = Vec::new();
    if let Some(projection) = &read.projection_matrix {
        notes.extend(note_of_projection(projection, &matrix)?);
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
        // The last two are plumb bob where their further coefficients are zero.
        "plumb_bob" | "rational_polynomial" | "thin_prism" => Ok(()),
        "" | "none" if coefficients.iter().all(|c| *c == 0.0) => Ok(()),
        "" => Err(
            Error::input("distortion_coefficients without a distortion_model")
                .remedy("add distortion_model: plumb_bob if they are k1, k2, p1, p2, k3"),
        ),
        other => Err(unknown_lens(&format!("the model {other:?}"))),
    }
}

fn check_rectification(matrix: &[f64; 9]) -> Result<()> {
    let identity = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let is_identity = matrix
        .iter()
        .zip(identity)
        .all(|(a, b)| (a - b).abs() < ROUNDING);
    if is_identity {
        return Ok(());
    }
    Err(Error::input(
        "the rectification_matrix turns the image: the file is for one camera of a stereo pair",
    )
    .remedy(
        "for raw images, put the identity there (camera_matrix and distortion_coefficients \
         describe those); for rectified ones, write a file with the projection_matrix as \
         camera_matrix and no distortion",
    ))
}

/// The projection matrix is that of rectified images, which are another camera's.
fn note_of_projection(projection: &Matrix, matrix: &[f64; 9]) -> Result<Option<String>> {
    let p = projection.numbers("projection_matrix")?;
    if (projection.rows, projection.cols) != (3, 4) {
        return Err(Error::input(format!(
            "projection_matrix must be 3 × 4, found {} × {}",
            projection.rows, projection.cols
        )));
    }
    let same = [0, 1, 2]
        .iter()
        .all(|row| p[4 * row..4 * row + 3] == matrix[3 * row..3 * row + 3]);
    Ok((!same).then(|| {
        "the projection matrix differs from the camera matrix: it is for rectified images; \
         camera matrix and distortion are for raw ones (image_raw), and only those may be used"
            .to_owned()
    }))
}
