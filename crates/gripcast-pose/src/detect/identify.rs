//! The dictionaries of the markers in an image of unknown content.

use image::GrayImage;

use super::{ApriltagDetector, ApriltagSettings};
use crate::{DICTIONARY_NAMES, Detection, Dictionary};
use gripcast_base::error::Result;

/// Smaller dictionaries with the same codes.
const PREFIXES: [&str; 4] = ["50", "100", "250", "1000"];
/// Evidence for a dictionary, decimal digits of improbability by chance: one marker of 36 cells in an
/// image without other squares has eight, one of DICT_4X4_50 two and a half.
const MIN_EVIDENCE: f64 = 3.5;

/// Whether a dictionary is not contained in another: the largest of each size, and AprilTag's names
/// of its tags rather than OpenCV's.
fn is_searched(name: &str) -> bool {
    let is_smaller = PREFIXES[..3]
        .iter()
        .any(|count| name.ends_with(&format!("_{count}")));
    !is_smaller && !name.starts_with("DICT_APRILTAG_")
}

/// A dictionary with markers in an image.
#[derive(Clone, Debug, PartialEq)]
pub struct Identified {
    /// The smallest dictionary with these markers.
    pub dictionary: Dictionary,
    /// Other names of dictionaries with the same ids in another orientation.
    pub alias: Option<String>,
    /// Its markers without bit errors.
    pub detections: Vec<Detection>,
}

/// Finds the dictionaries whose markers are in an image, the best supported first. Every square of
/// an image has codes in small dictionaries by chance: a dictionary needs evidence beyond that, and
/// each square counts for one dictionary.
///
/// # Errors
/// `Input` for an image that the detector does not support.
pub fn identify(image: &GrayImage, settings: ApriltagSettings) -> Result<Vec<Identified>> {
    let names = DICTIONARY_NAMES.iter().filter(|name| is_searched(name));
    let searched: Vec<Dictionary> = names
        .map(|name| Dictionary::by_name(name))
        .collect::<Result<_>>()?;
    let mut detector = ApriltagDetector::of_several(&searched, settings)?;
    let mut left = detector.detect_all(image)?;
    let squares = f64::from(detector.squares());
    left.retain(|(_, d)| d.hamming == 0);
    let mut identified = Vec::new();
    loop {
        let mut best: Option<(f64, Identified)> = None;
        for (index, dictionary) in searched.iter().enumerate() {
            let own = left.iter().filter(|(i, _)| *i == index);
            let own: Vec<Detection> = own.map(|(_, d)| d.clone()).collect();
            for (evidence, candidate) in candidates(dictionary, &own, squares)? {
                if evidence >= MIN_EVIDENCE && best.as_ref().is_none_or(|(e, _)| evidence > *e) {
                    best = Some((evidence, candidate));
                }
            }
        }
        let Some((_, best)) = best else {
            return Ok(identified);
        };
        left.retain(|(_, d)| !best.detections.iter().any(|known| overlap(known, d)));
        identified.push(best);
    }
}

/// The dictionary and its prefixes with their evidence: by chance, a square has a code of n markers
/// of k cells with p = 4 n / 2ᵏ, and m of N squares with at most (N over m) pᵐ.
fn candidates(
    dictionary: &Dictionary,
    found: &[Detection],
    squares: f64,
) -> Result<Vec<(f64, Identified)>> {
    if found.is_empty() {
        return Ok(Vec::new());
    }
    let name = dictionary.name();
    let names: Vec<String> = match name.strip_suffix("_1000") {
        Some(stem) => PREFIXES.iter().map(|n| format!("{stem}_{n}")).collect(),
        None => vec![name.to_owned()],
    };
    let alias = ["16h5", "25h9", "36h10", "36h11"]
        .contains(&name)
        .then(|| format!("DICT_APRILTAG_{name}"));
    let candidate = |name: &String| {
        let dictionary = Dictionary::by_name(name)?;
        let mut detections = found.to_vec();
        detections.retain(|d| (d.id as usize) < dictionary.len());
        let cells = (dictionary.bits_per_side() * dictionary.bits_per_side()) as i32;
        let chance = 4.0 * dictionary.len() as f64 / 2f64.powi(cells);
        let choices = |k: usize| ((squares - k as f64).max(1.0) / (k + 1) as f64).log10();
        let choices: f64 = (0..detections.len()).map(choices).sum();
        let evidence = -chance.log10() * detections.len() as f64 - choices.max(0.0);
        let identified = Identified {
            dictionary,
            alias: alias.clone(),
            detections,
        };
        Ok((evidence, identified))
    };
    names.iter().map(candidate).collect()
}

/// Whether two detections are of one square.
fn overlap(a: &Detection, b: &Detection) -> bool {
    let reach = 0.5 * a.min_side_px().max(b.min_side_px());
    a.center_px().distance(b.center_px()) < reach
}

#[cfg(test)]
mod tests {
    use image::Luma;

    use super::*;
    use crate::MarkerDetector as _;
    use crate::detect::FullSearch;

    /// Eight markers of a dictionary on white, 5 px a cell.
    fn sheet(dictionary: &Dictionary) -> GrayImage {
        let mut image = GrayImage::from_pixel(640, 320, Luma([220]));
        let (cell, side) = (5, dictionary.cells_per_side());
        for k in 0..8u32 {
            let (left, top) = (30 + 150 * (k % 4), 30 + 150 * (k / 4));
            let marker = dictionary.marker(3 * k).unwrap();
            let border = dictionary.border_cells();
            for y in 0..side * cell {
                for x in 0..side * cell {
                    let at = |v: usize| (v / cell).checked_sub(border);
                    let white = match (at(y), at(x)) {
                        (Some(row), Some(column)) => {
                            let inside = dictionary.bits_per_side();
                            row < inside && column < inside && marker.is_white(row, column)
                        }
                        _ => false,
                    };
                    let level = if white { 220 } else { 25 };
                    image.put_pixel(left + x as u32, top + y as u32, Luma([level]));
                }
            }
        }
        image
    }

    #[test]
    fn every_dictionary_is_detected_and_identified() {
        for name in DICTIONARY_NAMES {
            let dictionary = Dictionary::by_name(name).unwrap();
            let image = sheet(&dictionary);
            let ids: Vec<u32> = (0..dictionary.len() as u32).collect();
            let mut detector =
                ApriltagDetector::new(&dictionary, &ids, ApriltagSettings::default()).unwrap();
            let found: Vec<u32> = detector
                .detect(&image)
                .unwrap()
                .iter()
                .map(|d| d.id)
                .collect();
            if *name != "DICT_ARUCO_ORIGINAL" {
                assert_eq!(found, [0, 3, 6, 9, 12, 15, 18, 21], "{name}");
            }
            let identified = identify(&image, ApriltagSettings::default()).unwrap();
            let [only] = &identified[..] else {
                panic!("{name}: {identified:?}");
            };
            let expected = match name.rsplit_once('_') {
                Some((stem, "100" | "250" | "1000")) => format!("{stem}_50"),
                _ => name.trim_start_matches("DICT_APRILTAG_").to_owned(),
            };
            let is_named = only.dictionary.name() == expected;
            assert!(is_named, "{name}: {}", only.dictionary.name());
        }
    }

    #[test]
    fn chance_is_no_dictionary() {
        // Squares with random cells: 6 % of them are in DICT_4X4_1000.
        let settings = ApriltagSettings {
            full: FullSearch::Always,
            ..ApriltagSettings::default()
        };
        let mut image = GrayImage::from_pixel(1280, 720, Luma([210]));
        let mut state = 1u64;
        for k in 0..84u32 {
            let (left, top) = (20 + 90 * (k % 14), 20 + 110 * (k / 14));
            for cell in 0..36u32 {
                let (x, y) = (cell % 6, cell / 6);
                state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1);
                let inside = (1..5).contains(&x) && (1..5).contains(&y);
                let level = if inside && state >> 63 == 1 { 210 } else { 20 };
                for p in 0..64 {
                    let at = (left + 8 * x + p % 8, top + 8 * y + p / 8);
                    image.put_pixel(at.0, at.1, Luma([level]));
                }
            }
        }
        let names: Vec<String> = identify(&image, settings)
            .unwrap()
            .iter()
            .map(|i| i.dictionary.name().to_owned())
            .collect();
        assert!(names.is_empty(), "{names:?}");
    }
}
