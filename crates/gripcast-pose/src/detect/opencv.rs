//! Marker detection with the system's OpenCV, as a baseline: contrib module `aruco` up to 4.6,
//! `objdetect` from 4.7.
//!
//! S. Garrido-Jurado et al., *Automatic generation and detection of highly reliable fiducial
//! markers under occlusion*, Pattern Recognition 47 (2014). OpenCV's biased corner refinement is
//! replaced by [`refine_all`].

use glam::DVec2;
use image::GrayImage;
use opencv::core::{CV_8UC1, Mat, Point2f, Vector};
use opencv::prelude::*;

use super::check_size;
use crate::refine::refine_all;
use crate::{DICTIONARY_NAMES, Detection, Dictionary, MarkerDetector};
use gripcast_base::error::{Error, Result};

/// Detects the markers of one of OpenCV's predefined dictionaries.
pub struct OpencvDetector {
    dictionary: Predefined,
    /// Ascending.
    whitelist: Vec<u32>,
}

/// A dictionary of OpenCV.
#[derive(Clone, Copy)]
struct Predefined {
    number: i32,
    /// Whether OpenCV's marker is rotated by 180° relative to ours.
    is_rotated: bool,
}

/// OpenCV's number of a dictionary.
fn predefined(name: &str) -> Option<Predefined> {
    let is_rotated = ["16h5", "25h9", "36h10", "36h11"].contains(&name);
    let rotated = format!("DICT_APRILTAG_{name}");
    let wanted = if is_rotated { &*rotated } else { name };
    let number = DICTIONARY_NAMES.iter().position(|n| *n == wanted)?;
    // The names behind OpenCV's are of tags with other borders.
    let number = Some(number).filter(|_| wanted.starts_with("DICT_"))?;
    Some(Predefined {
        number: i32::try_from(number).ok()?,
        is_rotated,
    })
}

impl OpencvDetector {
    /// Creates a detector for the markers of `dictionary` with ids in `whitelist`.
    ///
    /// # Errors
    /// `Input` for a dictionary that OpenCV does not have, or an empty whitelist.
    pub fn new(dictionary: &Dictionary, whitelist: &[u32]) -> Result<Self> {
        let Some(predefined) = predefined(dictionary.name()) else {
            return Err(
                Error::input(format!("OpenCV has no dictionary {}", dictionary.name()))
                    .remedy("use the detector apriltag, which supports any dictionary"),
            );
        };
        let mut whitelist = whitelist.to_vec();
        whitelist.sort_unstable();
        if whitelist.is_empty() {
            return Err(Error::input(format!(
                "no marker ids of {} given",
                dictionary.name()
            )));
        }
        Ok(Self {
            dictionary: predefined,
            whitelist,
        })
    }
}

impl MarkerDetector for OpencvDetector {
    fn name(&self) -> &'static str {
        "opencv"
    }

    fn detect(&mut self, image: &GrayImage) -> Result<Vec<Detection>> {
        check_size(image)?;
        let (corners, ids) = search(image, self.dictionary.number)
            .map_err(|e| Error::internal("OpenCV's marker detection failed").because(e))?;
        let mut found = Vec::new();
        for (id, corners) in ids.iter().zip(corners.iter()) {
            let Ok([a, b, c, d]) = corners.data_typed::<Point2f>() else {
                continue;
            };
            let Ok(id) = u32::try_from(id) else { continue };
            if self.whitelist.binary_search(&id).is_err() {
                continue;
            }
            let mut corners_px = [a, b, c, d].map(|p| DVec2::new(f64::from(p.x), f64::from(p.y)));
            if self.dictionary.is_rotated {
                corners_px.rotate_left(2);
            }
            found.push(Detection {
                id,
                corners_px,
                // OpenCV reports neither.
                hamming: 0,
                margin: 0.0,
            });
        }
        found.sort_by_key(|d| d.id);
        Ok(refine_all(image, &found))
    }
}

/// Four points per marker, and ids.
type Found = (Vector<Mat>, Vector<i32>);

#[cfg(aruco_contrib)]
fn search(image: &GrayImage, dictionary: i32) -> opencv::Result<Found> {
    use opencv::aruco;
    let mut parameters = aruco::DetectorParameters::create()?;
    parameters.set_corner_refinement_method(aruco::CornerRefineMethod::CORNER_REFINE_NONE as i32);
    let dictionary = aruco::get_predefined_dictionary_i32(dictionary)?;
    let (mut corners, mut ids) = (Vector::new(), Vector::new());
    let mut rejected = Vector::<Mat>::new();
    aruco::detect_markers(
        &mat(image)?,
        &dictionary,
        &mut corners,
        &mut ids,
        &parameters,
        &mut rejected,
    )?;
    Ok((corners, ids))
}

#[cfg(not(aruco_contrib))]
fn search(image: &GrayImage, dictionary: i32) -> opencv::Result<Found> {
    use opencv::objdetect;
    let mut parameters = objdetect::DetectorParameters::default()?;
    parameters
        .set_corner_refinement_method(objdetect::CornerRefineMethod::CORNER_REFINE_NONE as i32);
    let dictionary = objdetect::get_predefined_dictionary_i32(dictionary)?;
    let refine = objdetect::RefineParameters::new_def()?;
    let detector = objdetect::ArucoDetector::new(&dictionary, &parameters, refine)?;
    let (mut corners, mut ids) = (Vector::new(), Vector::new());
    let mut rejected = Vector::<Mat>::new();
    detector.detect_markers(&mat(image)?, &mut corners, &mut ids, &mut rejected)?;
    Ok((corners, ids))
}

/// Copies the pixels of an image.
fn mat(image: &GrayImage) -> opencv::Result<Mat> {
    let (width, height) = (image.width() as i32, image.height() as i32);
    let mut mat = Mat::new_rows_cols_with_default(height, width, CV_8UC1, 0.into())?;
    mat.data_bytes_mut()?.copy_from_slice(image.as_raw());
    Ok(mat)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Body;
    use crate::synthetic::{GraspScene, ImageConditions, gripper_markers, ring_board, test_camera};

    #[test]
    fn opencv_corners_match_truth_in_our_convention() {
        for name in ["DICT_6X6_250", "DICT_APRILTAG_36h11", "36h11"] {
            let dictionary = Dictionary::by_name(name).unwrap();
            let board = ring_board(&dictionary);
            let gripper = gripper_markers(&dictionary, [Body::Gripper; 2]);
            let scene = GraspScene::random(&board, &gripper, &dictionary, 3, 1);
            let camera = test_camera(1280, 720);
            let rendered = scene.render(&camera, &ImageConditions::default(), 1);
            let ids: Vec<u32> = (0..50).collect();
            let found = OpencvDetector::new(&dictionary, &ids)
                .unwrap()
                .detect(&rendered.image)
                .unwrap();
            assert!(found.len() >= 12, "{name}: {}", found.len());
            for detection in &found {
                let Some(truth) = rendered.truth.iter().find(|t| t.id == detection.id) else {
                    continue;
                };
                for (a, b) in detection.corners_px.iter().zip(&truth.corners_px) {
                    assert!(a.distance(*b) < 0.4, "{name} {}: {a} {b}", detection.id);
                }
            }
        }
    }
}
