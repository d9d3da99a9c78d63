//! Why a board's markers are not found in an image.

use std::fmt;

use image::GrayImage;
use image::imageops::flip_horizontal;

use super::{ApriltagDetector, ApriltagSettings};
use crate::{DICTIONARY_NAMES, Dictionary, MarkerDetector as _};
use gripcast_base::error::{Error, Result};

/// Markers of another dictionary that tell more than chance.
const MIN_MARKERS: usize = 2;

/// What is in an image in place of a board.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Diagnosis {
    /// Markers of the board are there; these ids.
    Present(Vec<u32>),
    /// Markers of the board are there in the mirrored image; these ids.
    Mirrored(Vec<u32>),
    /// Markers of the board's dictionary that the board does not have; these ids.
    OtherMarkers(Vec<u32>),
    /// Markers of other dictionaries, with how many; several if they share these markers.
    OtherDictionaries {
        /// Names of the dictionaries.
        names: Vec<String>,
        /// How many markers of them were found.
        markers: usize,
    },
    /// No marker of any known dictionary.
    Nothing,
}

/// Searches `image` for the markers of `dictionary` with ids in `board_ids`, for what else it
/// could be if there are none, and for markers of `others`. Takes as long as one detection for
/// each dictionary.
///
/// # Errors
/// `Input` for an image or ids that no detector takes.
pub fn diagnose(
    image: &GrayImage,
    dictionary: &Dictionary,
    board_ids: &[u32],
    others: &[Dictionary],
) -> Result<Diagnosis> {
    let seen = ids(image, dictionary, board_ids)?;
    if !seen.is_empty() {
        return Ok(Diagnosis::Present(seen));
    }
    let mirrored = ids(&flip_horizontal(image), dictionary, board_ids)?;
    if mirrored.len() >= MIN_MARKERS.min(board_ids.len()) {
        return Ok(Diagnosis::Mirrored(mirrored));
    }
    let everything: Vec<u32> = (0..dictionary.len() as u32).collect();
    let foreign = ids(image, dictionary, &everything)?;
    let (names, markers) = best_dictionaries(image, others)?;
    if markers > foreign.len() && !names.contains(&dictionary.name().to_owned()) {
        return Ok(Diagnosis::OtherDictionaries { names, markers });
    }
    Ok(if foreign.is_empty() {
        Diagnosis::Nothing
    } else {
        Diagnosis::OtherMarkers(foreign)
    })
}

/// All dictionaries that are known by name.
#[must_use]
pub fn known_dictionaries() -> Vec<Dictionary> {
    DICTIONARY_NAMES
        .iter()
        .filter_map(|name| Dictionary::by_name(name).ok())
        .collect()
}

impl Diagnosis {
    /// The `Input` error that explains to a person why `board` was not found.
    #[must_use]
    pub fn explain(&self, board: &str) -> Error {
        let remedy = match self {
            Self::Present(_) => "let the camera see more of it, sharply and evenly lit",
            Self::Mirrored(_) => "switch the mirroring off in the camera's driver or software",
            Self::OtherMarkers(_) => "give the description of the board that was printed",
            Self::OtherDictionaries { .. } => {
                "set the dictionary in the board's description to that of the printed board"
            }
            Self::Nothing => {
                "check that the board is in the image, sharp, evenly lit, and its markers at \
                 least 20 pixels large with white around them"
            }
        };
        Error::input(format!("{board}: {self}")).remedy(remedy)
    }
}

impl fmt::Display for Diagnosis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Present(ids) => write!(f, "its markers {} are in the image", listed(ids)),
            Self::Mirrored(ids) => write!(
                f,
                "the image is mirrored: read backwards it has its markers {}",
                listed(ids)
            ),
            Self::OtherMarkers(ids) => write!(
                f,
                "none of its markers is in the image, but {} of its dictionary",
                listed(ids)
            ),
            Self::OtherDictionaries { names, markers } => write!(
                f,
                "none of its markers is in the image, but {markers} of {}",
                names.join(" or ")
            ),
            Self::Nothing => write!(f, "no marker of any known dictionary is in the image"),
        }
    }
}

fn listed(ids: &[u32]) -> String {
    const MAX: usize = 12;
    let shown: Vec<String> = ids.iter().take(MAX).map(u32::to_string).collect();
    let more = if ids.len() > MAX { " …" } else { "" };
    format!("{}{more}", shown.join(", "))
}

/// Ids that are read without a wrong bit, each once.
fn ids(image: &GrayImage, dictionary: &Dictionary, whitelist: &[u32]) -> Result<Vec<u32>> {
    let settings = ApriltagSettings::default();
    let found = ApriltagDetector::new(dictionary, whitelist, settings)?.detect(image)?;
    let exact = found.iter().filter(|d| d.hamming == 0);
    let mut ids: Vec<u32> = exact.map(|d| d.id).collect();
    ids.dedup();
    Ok(ids)
}

/// The smallest dictionaries with most markers in the image; none with fewer than two markers.
fn best_dictionaries(image: &GrayImage, others: &[Dictionary]) -> Result<(Vec<String>, usize)> {
    let mut scores: Vec<(usize, &Dictionary)> = Vec::new();
    for other in others {
        let everything: Vec<u32> = (0..other.len() as u32).collect();
        scores.push((ids(image, other, &everything)?.len(), other));
    }
    let most = scores.iter().map(|(count, _)| *count).max().unwrap_or(0);
    if most < MIN_MARKERS {
        return Ok((Vec::new(), 0));
    }
    let best = || scores.iter().filter(|(count, _)| *count == most);
    let smallest = best().map(|(_, d)| d.len()).min().unwrap_or(0);
    let names = best()
        .filter(|(_, d)| d.len() == smallest)
        .map(|(_, d)| d.name().to_owned());
    Ok((names.collect(), most))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Part;
    use crate::synthetic::{GraspScene, ImageConditions, gripper_markers, ring_board, test_camera};

    fn image(name: &str) -> GrayImage {
        let dictionary = Dictionary::by_name(name).unwrap();
        let board = ring_board(&dictionary);
        let gripper = gripper_markers(&dictionary, [Part::Body; 2]);
        let scene = GraspScene::random(&board, &gripper, &dictionary, 8, 0);
        let camera = test_camera(1280, 720);
        scene.render(&camera, &ImageConditions::default(), 0).image
    }

    #[test]
    fn each_mistake_is_told_from_the_others() {
        let others = known_dictionaries();
        let board = Dictionary::by_name("DICT_6X6_250").unwrap();
        let right = image("DICT_6X6_250");
        let on_board: Vec<u32> = (0..14).collect();
        let diagnosed =
            |image: &GrayImage, ids: &[u32]| diagnose(image, &board, ids, &others).unwrap();
        let Diagnosis::Present(found) = diagnosed(&right, &on_board) else {
            panic!("the board is there");
        };
        assert!(found.len() > 8);
        let mirrored = diagnosed(&flip_horizontal(&right), &on_board);
        assert!(
            matches!(&mirrored, Diagnosis::Mirrored(ids) if ids.len() > 8),
            "{mirrored}"
        );
        let foreign = diagnosed(&right, &[100, 101, 102]);
        assert!(
            matches!(&foreign, Diagnosis::OtherMarkers(ids) if ids.len() > 8),
            "{foreign}"
        );
        let blank = diagnosed(&GrayImage::new(640, 480), &on_board);
        assert_eq!(blank, Diagnosis::Nothing);
        let text = blank.explain("mug-board").to_string();
        assert!(
            text.contains("mug-board: no marker of any known dictionary"),
            "{text}"
        );
    }

    #[test]
    fn the_dictionary_that_fits_is_named() {
        let others = known_dictionaries();
        let board = Dictionary::by_name("DICT_6X6_250").unwrap();
        for (name, expected) in [("DICT_5X5_100", "DICT_5X5_50"), ("36h11", "36h11")] {
            let found = diagnose(&image(name), &board, &[0, 1, 2, 3], &others).unwrap();
            let Diagnosis::OtherDictionaries { names, markers } = &found else {
                panic!("{found}");
            };
            assert!(names.iter().any(|n| n == expected), "{names:?}");
            assert!(*markers > 8 && found.explain("b").to_string().contains(expected));
        }
    }
}
