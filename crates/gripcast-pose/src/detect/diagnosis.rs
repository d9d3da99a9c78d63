//! Diagnosis of images in which a board is not detected.

use std::fmt;

use image::GrayImage;
use image::imageops::flip_horizontal;

use super::{ApriltagDetector, ApriltagSettings, identify};
use crate::{Dictionary, MarkerDetector as _};
use gripcast_base::error::{Error, Result};

/// Minimum number of markers of another dictionary that is not chance.
const MIN_MARKERS: usize = 2;

/// What an image shows instead of the board.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Diagnosis {
    /// The board's markers with these ids are visible.
    Present(Vec<u32>),
    /// The board's markers with these ids are visible in the mirrored image.
    Mirrored(Vec<u32>),
    /// Markers of the board's dictionary with other ids.
    OtherMarkers(Vec<u32>),
    /// Markers of other dictionaries.
    OtherDictionaries {
        /// Names of the dictionaries; several if they have these markers in common.
        names: Vec<String>,
        /// Number of markers.
        markers: usize,
    },
    /// No marker of any dictionary.
    Nothing,
}

/// Searches `image` for the markers of `dictionary` with ids in `board_ids`, then for mirrored
/// markers, other ids, and other dictionaries.
///
/// # Errors
/// `Input` for an image or ids that the detector does not support.
pub fn diagnose(
    image: &GrayImage,
    dictionary: &Dictionary,
    board_ids: &[u32],
) -> Result<Diagnosis> {
    let present = ids(image, dictionary, board_ids)?;
    if !present.is_empty() {
        return Ok(Diagnosis::Present(present));
    }
    let mirrored = ids(&flip_horizontal(image), dictionary, board_ids)?;
    if mirrored.len() >= MIN_MARKERS.min(board_ids.len()) {
        return Ok(Diagnosis::Mirrored(mirrored));
    }
    let everything: Vec<u32> = (0..dictionary.len() as u32).collect();
    let foreign = ids(image, dictionary, &everything)?;
    let (names, markers) = best_dictionary(image)?;
    if markers > foreign.len() && !names.contains(&dictionary.name().to_owned()) {
        return Ok(Diagnosis::OtherDictionaries { names, markers });
    }
    Ok(if foreign.is_empty() {
        Diagnosis::Nothing
    } else {
        Diagnosis::OtherMarkers(foreign)
    })
}

impl Diagnosis {
    /// The `Input` error that explains why `board` was not detected.
    #[must_use]
    pub fn to_error(&self, board: &str) -> Error {
        let remedy = match self {
            Self::Present(_) => "show more of the board, in focus and evenly lit",
            Self::Mirrored(_) => "disable mirroring in the camera's driver or software",
            Self::OtherMarkers(_) => "give the board file of the printed board",
            Self::OtherDictionaries { .. } => {
                "set the dictionary in the board file to that of the printed board"
            }
            Self::Nothing => {
                "check that the board is in view, in focus and evenly lit, with markers of at \
                 least 20 pixels and a white margin"
            }
        };
        Error::input(format!("{board}: {self}")).remedy(remedy)
    }
}

impl fmt::Display for Diagnosis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Present(ids) => write!(f, "markers {} are visible", listed(ids)),
            Self::Mirrored(ids) => {
                write!(
                    f,
                    "the image is mirrored: flipped, it shows markers {}",
                    listed(ids)
                )
            }
            Self::OtherMarkers(ids) => write!(
                f,
                "none of its markers is visible, but markers {} of its dictionary are",
                listed(ids)
            ),
            Self::OtherDictionaries { names, markers } => write!(
                f,
                "none of its markers is visible, but {markers} of {} are",
                names.join(" or ")
            ),
            Self::Nothing => f.write_str("no marker of any known dictionary is visible"),
        }
    }
}

fn listed(ids: &[u32]) -> String {
    const MAX: usize = 12;
    let shown: Vec<String> = ids.iter().take(MAX).map(u32::to_string).collect();
    let more = if ids.len() > MAX { " …" } else { "" };
    format!("{}{more}", shown.join(", "))
}

/// Unique ids that are decoded without bit errors.
fn ids(image: &GrayImage, dictionary: &Dictionary, whitelist: &[u32]) -> Result<Vec<u32>> {
    let settings = ApriltagSettings::default();
    let found = ApriltagDetector::new(dictionary, whitelist, settings)?.detect(image)?;
    let exact = found.iter().filter(|d| d.hamming == 0);
    let mut ids: Vec<u32> = exact.map(|d| d.id).collect();
    ids.dedup();
    Ok(ids)
}

/// Names of the dictionary with most markers in the image, and their number; none below
/// [`MIN_MARKERS`].
fn best_dictionary(image: &GrayImage) -> Result<(Vec<String>, usize)> {
    let identified = identify(image, ApriltagSettings::default())?;
    let best = identified
        .into_iter()
        .max_by_key(|i| i.detections.len())
        .filter(|i| i.detections.len() >= MIN_MARKERS);
    Ok(best.map_or_else(Default::default, |best| {
        let own = best.dictionary.name().to_owned();
        let names = std::iter::once(own).chain(best.alias);
        (names.collect(), best.detections.len())
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Body;
    use crate::synthetic::{GraspScene, ImageConditions, gripper_markers, ring_board, test_camera};

    fn image(name: &str) -> GrayImage {
        let dictionary = Dictionary::by_name(name).unwrap();
        let board = ring_board(&dictionary);
        let gripper = gripper_markers(&dictionary, [Body::Gripper; 2]);
        let scene = GraspScene::random(&board, &gripper, &dictionary, 8, 0);
        let camera = test_camera(1280, 720);
        scene.render(&camera, &ImageConditions::default(), 0).image
    }

    #[test]
    fn diagnose_distinguishes_mistakes() {
        let board = Dictionary::by_name("DICT_6X6_250").unwrap();
        let matching = image("DICT_6X6_250");
        let on_board: Vec<u32> = (0..14).collect();
        let diagnose_board = |image: &GrayImage, ids: &[u32]| diagnose(image, &board, ids).unwrap();
        let Diagnosis::Present(found) = diagnose_board(&matching, &on_board) else {
            panic!("the board is there");
        };
        assert!(found.len() > 8);
        let mirrored = diagnose_board(&flip_horizontal(&matching), &on_board);
        assert!(
            matches!(&mirrored, Diagnosis::Mirrored(ids) if ids.len() > 8),
            "{mirrored}"
        );
        let foreign = diagnose_board(&matching, &[100, 101, 102]);
        assert!(
            matches!(&foreign, Diagnosis::OtherMarkers(ids) if ids.len() > 8),
            "{foreign}"
        );
        let blank = diagnose_board(&GrayImage::new(640, 480), &on_board);
        assert_eq!(blank, Diagnosis::Nothing);
        let text = blank.to_error("mug-board").to_string();
        assert!(
            text.contains("mug-board: no marker of any known dictionary"),
            "{text}"
        );
    }

    #[test]
    fn diagnose_names_matching_dictionary() {
        let board = Dictionary::by_name("DICT_6X6_250").unwrap();
        for (name, expected) in [("DICT_5X5_100", "DICT_5X5_50"), ("36h11", "36h11")] {
            let found = diagnose(&image(name), &board, &[0, 1, 2, 3]).unwrap();
            let Diagnosis::OtherDictionaries { names, markers } = &found else {
                panic!("{found}");
            };
            assert!(names.iter().any(|n| n == expected), "{names:?}");
            assert!(*markers > 8 && found.to_error("b").to_string().contains(expected));
        }
    }
}
