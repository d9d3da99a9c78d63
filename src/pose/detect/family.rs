//! Codes of a dictionary in the bit order of the AprilTag library.

use crate::error::{Error, ErrorKind, Result};

/// Largest number of data cells along a side whose codes fit into 63 bits.
const LARGEST_SIDE: u32 = 7;
/// Most markers: the library numbers them with 16 bits.
const MOST_CODES: usize = 65_535;
/// Most bits that are corrected; the table of codes grows with this power.
const MOST_CORRECTED: u32 = 2;

/// A dictionary of square markers with a black border one cell wide.
///
/// A code's bits go along [`Self::cells`], the first in the highest bit, 1 for white: rows of one
/// quarter of the marker, then the same rotated by 90°, 180°, 270°, then the middle of an odd
/// marker. So a quarter turn of the marker is a rotation of its bits.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MarkerFamily {
    /// Name, such as `DICT_6X6_250`.
    pub name: String,
    /// Data cells along a side, without the border.
    pub bits_per_side: u32,
    /// Code of each marker, by id.
    pub codes: Vec<u64>,
    /// Least number of bits that two markers differ in, in any orientation.
    pub min_distance: u32,
    /// Bits that a detector corrects.
    pub corrected_bits: u32,
}

impl MarkerFamily {
    /// Refuses what the library cannot hold.
    ///
    /// # Errors
    /// `Input` with what is wrong.
    pub(super) fn validate(&self) -> Result<()> {
        let wrong = if !(3..=LARGEST_SIDE).contains(&self.bits_per_side) {
            format!(
                "{} data cells along a side; possible are 3 to {LARGEST_SIDE}",
                self.bits_per_side
            )
        } else if self.codes.is_empty() || self.codes.len() > MOST_CODES {
            format!("{} markers; possible are 1 to {MOST_CODES}", self.codes.len())
        } else if self.codes.iter().any(|c| c >> self.bits() != 0) {
            format!("a code of more than {} bits", self.bits())
        } else if self.corrected_bits > MOST_CORRECTED {
            format!(
                "{} corrected bits; possible are 0 to {MOST_CORRECTED}",
                self.corrected_bits
            )
        } else {
            return Ok(());
        };
        Err(Error::new(
            ErrorKind::Input,
            format!("the marker dictionary {} has {wrong}", self.name),
        ))
    }

    fn bits(&self) -> u32 {
        self.bits_per_side * self.bits_per_side
    }

    /// Cells (column, row) in the order of a code's bits; (0, 0) is the top-left data cell.
    #[must_use]
    pub fn cells(&self) -> Vec<(u32, u32)> {
        let n = self.bits_per_side;
        let mut quarter: Vec<(u32, u32)> = Vec::new();
        for row in 0..n / 2 {
            quarter.extend((row..n - 1 - row).map(|column| (column, row)));
        }
        let mut cells = Vec::with_capacity(self.bits() as usize);
        for _ in 0..4 {
            cells.extend_from_slice(&quarter);
            for cell in &mut quarter {
                *cell = (n - 1 - cell.1, cell.0);
            }
        }
        if n % 2 == 1 {
            cells.push((n / 2, n / 2));
        }
        cells
    }

    /// Data cells of marker `id`, row by row, true for white; none if there is no such marker.
    #[must_use]
    pub fn pattern(&self, id: u32) -> Option<Vec<bool>> {
        let code = *self.codes.get(id as usize)?;
        let mut pattern = vec![false; self.bits() as usize];
        for (bit, (column, row)) in self.cells().into_iter().rev().enumerate() {
            pattern[(row * self.bits_per_side + column) as usize] = (code >> bit) & 1 == 1;
        }
        Some(pattern)
    }

    /// The code of data cells given row by row, true for white.
    #[must_use]
    pub fn code_of(&self, pattern: &[bool]) -> u64 {
        let at = |(column, row): (u32, u32)| (row * self.bits_per_side + column) as usize;
        self.cells().into_iter().fold(0, |code, cell| {
            (code << 1) | u64::from(pattern.get(at(cell)).copied().unwrap_or(false))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn family(bits_per_side: u32, codes: Vec<u64>) -> MarkerFamily {
        MarkerFamily {
            name: "test".into(),
            bits_per_side,
            codes,
            min_distance: 4,
            corrected_bits: 0,
        }
    }

    #[test]
    fn opencv_s_first_marker_has_its_code() {
        // DICT_4X4_50, id 0, as OpenCV prints it.
        let rows = ["1011", "0101", "0011", "0010"];
        let pattern: Vec<bool> = rows.concat().chars().map(|c| c == '1').collect();
        let family = family(4, vec![0xbe50]);
        assert_eq!(family.code_of(&pattern), 0xbe50);
        assert_eq!(family.pattern(0).unwrap(), pattern);
        assert_eq!(family.pattern(1), None);
    }

    #[test]
    fn a_quarter_turn_rotates_the_bits() {
        for n in 3..=7 {
            let family = family(n, vec![1]);
            let cells = family.cells();
            let mut sorted = cells.clone();
            sorted.sort_unstable();
            sorted.dedup();
            assert_eq!(sorted.len(), (n * n) as usize, "every cell once");
            let quarter = (n * n / 4) as usize;
            for (i, cell) in cells.iter().enumerate().take(3 * quarter) {
                assert_eq!(cells[i + quarter], (n - 1 - cell.1, cell.0));
            }
        }
    }

    #[test]
    fn what_the_library_cannot_hold_is_refused() {
        assert!(family(6, vec![5, 9]).validate().is_ok());
        for (bad, expected) in [
            (family(8, vec![1]), "8 data cells"),
            (family(4, vec![]), "0 markers"),
            (family(4, vec![1 << 16]), "more than 16 bits"),
            (
                MarkerFamily {
                    corrected_bits: 3,
                    ..family(4, vec![1])
                },
                "3 corrected bits",
            ),
        ] {
            let error = bad.validate().unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }
}
