//! Published codes of the built-in dictionaries.
//!
//! Hexadecimal, one number per marker: cells row by row from the top left, the first in the highest
//! bit, 1 = white. Smaller dictionaries of a size are prefixes of the largest. The AprilTag tables
//! have the orientation of AprilTag's own images; OpenCV's are rotated by 180°.

use gripcast_base::error::{Error, Result};

const ARUCO_4X4: &str = include_str!("codes/aruco_4x4.txt");
const ARUCO_5X5: &str = include_str!("codes/aruco_5x5.txt");
const ARUCO_6X6: &str = include_str!("codes/aruco_6x6.txt");
const ARUCO_7X7: &str = include_str!("codes/aruco_7x7.txt");
const ARUCO_MIP_36H12: &str = include_str!("codes/aruco_mip_36h12.txt");
const APRILTAG_16H5: &str = include_str!("codes/apriltag_16h5.txt");
const APRILTAG_25H9: &str = include_str!("codes/apriltag_25h9.txt");
const APRILTAG_36H10: &str = include_str!("codes/apriltag_36h10.txt");
const APRILTAG_36H11: &str = include_str!("codes/apriltag_36h11.txt");

/// Names of all built-in dictionaries; those with the same codes from the smallest on. The first 22
/// are OpenCV's, in the order of its numbers.
pub const DICTIONARY_NAMES: &[&str] = &[
    "DICT_4X4_50",
    "DICT_4X4_100",
    "DICT_4X4_250",
    "DICT_4X4_1000",
    "DICT_5X5_50",
    "DICT_5X5_100",
    "DICT_5X5_250",
    "DICT_5X5_1000",
    "DICT_6X6_50",
    "DICT_6X6_100",
    "DICT_6X6_250",
    "DICT_6X6_1000",
    "DICT_7X7_50",
    "DICT_7X7_100",
    "DICT_7X7_250",
    "DICT_7X7_1000",
    "DICT_ARUCO_ORIGINAL",
    "DICT_APRILTAG_16h5",
    "DICT_APRILTAG_25h9",
    "DICT_APRILTAG_36h10",
    "DICT_APRILTAG_36h11",
    "DICT_ARUCO_MIP_36h12",
    "16h5",
    "25h9",
    "36h10",
    "36h11",
    "16h5_border2",
    "25h9_border2",
    "36h10_border2",
    "36h11_border2",
];

/// Returns cells along a side, border and codes of a built-in dictionary.
pub(super) fn codes(name: &str) -> Result<(usize, usize, Vec<u64>)> {
    if name == "DICT_ARUCO_ORIGINAL" {
        return Ok((5, 1, original()));
    }
    if let Some((size, count)) = name.strip_prefix("DICT_").and_then(|n| n.split_once('_')) {
        let sizes = [
            ("4X4", 4, ARUCO_4X4),
            ("5X5", 5, ARUCO_5X5),
            ("6X6", 6, ARUCO_6X6),
            ("7X7", 7, ARUCO_7X7),
        ];
        if let Some((_, side, text)) = sizes.into_iter().find(|s| s.0 == size) {
            let count = count.parse().map_err(|_| unknown(name))?;
            return Ok((side, 1, parse(text)?.into_iter().take(count).collect()));
        }
    }
    if name == "DICT_ARUCO_MIP_36h12" {
        return Ok((6, 1, parse(ARUCO_MIP_36H12)?));
    }
    let opencv = name.strip_prefix("DICT_APRILTAG_");
    let kalibr = name.strip_suffix("_border2");
    let (side, text) = match opencv.or(kalibr).unwrap_or(name) {
        "16h5" => (4, APRILTAG_16H5),
        "25h9" => (5, APRILTAG_25H9),
        "36h10" => (6, APRILTAG_36H10),
        "36h11" => (6, APRILTAG_36H11),
        _ => return Err(unknown(name)),
    };
    let mut codes = parse(text)?;
    if opencv.is_some() {
        // A rotation by 180° reverses the order of the cells.
        let unused = 64 - side * side;
        codes
            .iter_mut()
            .for_each(|c| *c = c.reverse_bits() >> unused);
    }
    Ok((side, if kalibr.is_some() { 2 } else { 1 }, codes))
}

fn unknown(name: &str) -> Error {
    Error::internal(format!("dictionary {name} has no codes"))
}

fn parse(text: &str) -> Result<Vec<u64>> {
    text.split_whitespace()
        .map(|word| u64::from_str_radix(word, 16))
        .collect::<Result<_, _>>()
        .map_err(|e| Error::internal("damaged built-in dictionary").because(e))
}

/// Garrido-Jurado's first dictionary: five rows, each with two bits of the id in a Hamming code.
fn original() -> Vec<u64> {
    const WORDS: [u64; 4] = [0x10, 0x17, 0x09, 0x0e];
    let row = |id: usize, k: usize| WORDS[id >> (8 - 2 * k) & 3];
    (0..1024)
        .map(|id| (0..5).fold(0, |code, k| code << 5 | row(id, k)))
        .collect()
}
