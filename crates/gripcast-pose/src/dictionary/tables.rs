//! Published codes of the built-in dictionaries.
//!
//! Hexadecimal, one number per marker: cells row by row from the top left, the first in the highest
//! bit, 1 = white. Smaller dictionaries of a size are prefixes of the largest.

use gripcast_base::error::{Error, Result};

const ARUCO_4X4: &str = include_str!("codes/aruco_4x4.txt");
const ARUCO_5X5: &str = include_str!("codes/aruco_5x5.txt");
const ARUCO_6X6: &str = include_str!("codes/aruco_6x6.txt");
const APRILTAG_36H11: &str = include_str!("codes/apriltag_36h11.txt");

/// Returns cells along a side, border and codes of a built-in dictionary.
pub(super) fn codes(name: &str) -> Result<(usize, usize, Vec<u64>)> {
    let (side, border, text, count) = match name {
        "DICT_4X4_50" => (4, 1, ARUCO_4X4, 50),
        "DICT_4X4_100" => (4, 1, ARUCO_4X4, 100),
        "DICT_5X5_50" => (5, 1, ARUCO_5X5, 50),
        "DICT_5X5_100" => (5, 1, ARUCO_5X5, 100),
        "DICT_5X5_250" => (5, 1, ARUCO_5X5, 250),
        "DICT_6X6_50" => (6, 1, ARUCO_6X6, 50),
        "DICT_6X6_100" => (6, 1, ARUCO_6X6, 100),
        "DICT_6X6_250" => (6, 1, ARUCO_6X6, 250),
        "DICT_ARUCO_ORIGINAL" => return Ok((5, 1, original())),
        "36h11_border2" => (6, 2, APRILTAG_36H11, 587),
        _ => (6, 1, APRILTAG_36H11, 587),
    };
    let mut codes = parse(text, count)?;
    if name == "DICT_APRILTAG_36h11" {
        // A rotation by 180° reverses the order of the cells.
        codes.iter_mut().for_each(|c| *c = c.reverse_bits() >> 28);
    }
    Ok((side, border, codes))
}

fn parse(text: &str, count: usize) -> Result<Vec<u64>> {
    let words = text.split_whitespace().take(count);
    words
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
