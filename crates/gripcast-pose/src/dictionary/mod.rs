//! Marker dictionaries: the cell pattern of each id.

mod custom;
mod tables;

use std::path::Path;

use gripcast_base::error::{Error, Result, unknown_name};
use gripcast_base::files::{FileKind, Root};

pub use tables::DICTIONARY_NAMES;

/// Maximum number of cells along a side: a code is a `u64`.
const MAX_SIDE: usize = 8;

/// The cells of a marker within its black border; `true` is white.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MarkerCells {
    side: usize,
    code: u64,
}

impl MarkerCells {
    /// Cells along a side.
    pub fn side(&self) -> usize {
        self.side
    }

    /// Whether the cell is white; rows from the top, columns from the left, counted from 0.
    pub fn is_white(&self, row: usize, column: usize) -> bool {
        is_white(self.code, self.side, row, column)
    }
}

/// A set of markers with the same size and border, indexed by id.
///
/// ```
/// use gripcast_pose::Dictionary;
/// let dictionary = Dictionary::by_name("DICT_4X4_50")?;
/// assert_eq!(dictionary.rotation_grouped_code(0), Some(0xbe50));
/// # Ok::<(), gripcast_base::error::Error>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Dictionary {
    name: String,
    side: usize,
    border: usize,
    /// Cells row by row from the top left, the first in the highest of `side²` bits; 1 = white.
    codes: Vec<u64>,
}

impl Dictionary {
    /// Returns a built-in dictionary. Names are case-insensitive; the prefix `DICT_` is optional.
    ///
    /// `36h11` has the orientation of AprilTag's own images, `DICT_APRILTAG_36h11` that of OpenCV:
    /// the same codes rotated by 180°. `36h11_border2` has Kalibr's border of two cells. The same
    /// holds for 16h5, 25h9 and 36h10. `tag36h11` and Kalibr's `t36h11` mean `36h11`.
    /// `DICT_ARUCO_ORIGINAL` has markers that are rotations of each other ([`Self::min_distance`]
    /// is 0): use it for existing boards only.
    ///
    /// # Errors
    /// `Usage` for an unknown name; the remedy suggests the nearest one.
    pub fn by_name(name: &str) -> Result<Self> {
        let known = canonical(name).ok_or_else(|| {
            unknown_name("dictionary", name, DICTIONARY_NAMES)
                .remedy("give a custom dictionary as an OpenCV file, .yml or .yaml")
        })?;
        let (side, border, codes) = tables::codes(known)?;
        Self::from_codes(known, side, border, codes)
    }

    /// Returns a built-in dictionary, or reads an OpenCV dictionary file (`.yml`, `.yaml`) whose
    /// path is relative to `folder`.
    ///
    /// # Errors
    /// `Usage` for an unknown name, `Input` or an IO error for a file.
    pub fn open(name: &str, folder: &Path) -> Result<Self> {
        if !is_file_name(name) {
            return Self::by_name(name);
        }
        // A board stored in a dataset has no folder and may not refer to a file.
        if folder.as_os_str().is_empty() {
            let what = format!("dictionary file {name:?} of a board without a folder");
            return Err(
                Error::input(what).remedy("use a built-in dictionary, for instance DICT_4X4_50")
            );
        }
        let path = folder.join(name);
        let text = Root::new(folder)
            .resolve(name)
            .and_then(|file| file.read_to_string(FileKind::Record))
            .map_err(|e| Error::io("cannot read the dictionary", e).at(path.display()))?;
        Self::from_opencv(name, &text).map_err(|e| e.at(path.display()))
    }

    /// Parses an OpenCV dictionary: `nmarkers`, `markersize`, and `marker_N` with the cells row by
    /// row, 1 = white.
    ///
    /// # Errors
    /// `Input` naming the invalid entry.
    pub fn from_opencv(name: &str, text: &str) -> Result<Self> {
        let (side, codes) = custom::read(text)?;
        Self::from_codes(name, side, 1, codes)
    }

    /// Creates a dictionary of `side` × `side` cells with a border of `border` black cells. Codes
    /// have the cells row by row from the top left, the first in the highest of side² bits, 1 =
    /// white.
    ///
    /// # Errors
    /// `Input` for a side outside 3 to 8, no border, no codes, too long or duplicate codes.
    pub fn from_codes(name: &str, side: usize, border: usize, codes: Vec<u64>) -> Result<Self> {
        let bad = |what: String| Err(Error::input(what));
        if !(3..=MAX_SIDE).contains(&side) {
            return bad(format!(
                "a marker must have from 3 to {MAX_SIDE} cells along a side, found {side}"
            ));
        }
        if border == 0 || codes.is_empty() {
            return bad(
                "a dictionary needs at least one marker and a border of one cell".to_owned(),
            );
        }
        let too_long = |code: &u64| side < MAX_SIDE && code >> (side * side) != 0;
        if let Some(id) = codes.iter().position(too_long) {
            return bad(format!("marker {id} has more than {side} × {side} cells"));
        }
        let mut sorted: Vec<(u64, usize)> = codes.iter().copied().zip(0..).collect();
        sorted.sort_unstable();
        if let Some(pair) = sorted.windows(2).find(|pair| pair[0].0 == pair[1].0) {
            return bad(format!(
                "markers {} and {} have the same cells",
                pair[0].1, pair[1].1
            ));
        }
        Ok(Self {
            name: name.to_owned(),
            side,
            border,
            codes,
        })
    }

    /// Name; for built-in dictionaries one of [`DICTIONARY_NAMES`].
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Checks that ids from `first_id` on exist for `count` markers.
    ///
    /// # Errors
    /// `Input`; the caller adds the remedy.
    pub(crate) fn check_ids(&self, first_id: u32, count: usize) -> Result<()> {
        if first_id as usize + count <= self.len() {
            return Ok(());
        }
        Err(Error::input(format!(
            "{count} markers from id {first_id} exceed {}, which ends with id {}",
            self.name,
            self.len() - 1
        )))
    }

    /// Number of markers; ids start at 0.
    pub fn len(&self) -> usize {
        self.codes.len()
    }

    /// Whether the dictionary is empty; always false.
    pub fn is_empty(&self) -> bool {
        self.codes.is_empty()
    }

    /// Cells along a side, without the border.
    pub fn bits_per_side(&self) -> usize {
        self.side
    }

    /// Width of the black border, cells.
    pub fn border_cells(&self) -> usize {
        self.border
    }

    /// Cells along a side, including the border.
    pub fn cells_per_side(&self) -> usize {
        self.side + 2 * self.border
    }

    /// Cells of a marker; none for an unknown id.
    pub fn marker(&self, id: u32) -> Option<MarkerCells> {
        let code = self.code(id)?;
        let side = self.side;
        Some(MarkerCells { side, code })
    }

    /// Cells of a marker row by row from the top left, the first in the highest of side² bits.
    pub fn code(&self, id: u32) -> Option<u64> {
        self.codes.get(id as usize).copied()
    }

    /// Cells of a marker in the order of [`Self::rotation_grouped_cells`], the first in the highest
    /// bit: AprilTag 3's layout, in which a rotation by 90° is a rotation of bits.
    pub fn rotation_grouped_code(&self, id: u32) -> Option<u64> {
        let code = self.code(id)?;
        let cells = self.rotation_grouped_cells();
        Some(cells.iter().fold(0, |grouped, [x, y]| {
            let white = is_white(code, self.side, *y as usize - 1, *x as usize - 1);
            grouped << 1 | u64::from(white)
        }))
    }

    /// Column and row of each bit of [`Self::rotation_grouped_code`], counted from 1 inside the
    /// border: a quarter of the cells, their rotations by 90°, 180° and 270°, and the centre.
    pub fn rotation_grouped_cells(&self) -> Vec<[u32; 2]> {
        let n = self.side as u32;
        let ring = |r: u32| (r..=n - r).map(move |x| [x, r]);
        let mut quarter: Vec<[u32; 2]> = (1..=n / 2).flat_map(ring).collect();
        let mut cells = quarter.clone();
        for _ in 0..3 {
            for cell in &mut quarter {
                *cell = [n + 1 - cell[1], cell[0]];
            }
            cells.extend(&quarter);
        }
        if n % 2 == 1 {
            cells.push([n.div_ceil(2); 2]);
        }
        cells
    }

    /// Minimum Hamming distance between any two markers in any rotation, or between a marker and
    /// its own rotations. Compares all pairs, which takes some milliseconds.
    pub fn min_distance(&self) -> u32 {
        let all: Vec<[u64; 4]> = self.codes.iter().map(|&c| self.rotations(c)).collect();
        let mut min = (self.side * self.side) as u32;
        for (id, rotations) in all.iter().enumerate() {
            let others = rotations[1..].iter().chain(all[..id].iter().flatten());
            let distances = others.map(|code| (rotations[0] ^ code).count_ones());
            min = distances.fold(min, u32::min);
        }
        min
    }

    /// A code rotated clockwise by 0°, 90°, 180° and 270°.
    fn rotations(&self, code: u64) -> [u64; 4] {
        let mut rotations = [code; 4];
        for i in 1..4 {
            rotations[i] = rotated(rotations[i - 1], self.side);
        }
        rotations
    }
}

/// Whether a dictionary name refers to a file.
fn is_file_name(name: &str) -> bool {
    let suffix = Path::new(name).extension().unwrap_or_default();
    suffix.eq_ignore_ascii_case("yml") || suffix.eq_ignore_ascii_case("yaml")
}

/// Built-in name that matches `name`.
fn canonical(name: &str) -> Option<&'static str> {
    let plain = |text: &str| {
        let text = text.trim().to_ascii_lowercase();
        let text = text.strip_prefix("dict_").unwrap_or(&text);
        let family = text.strip_prefix("tag").or_else(|| text.strip_prefix('t'));
        let is_family = |f: &&str| f.starts_with(|c: char| c.is_ascii_digit());
        family.filter(is_family).unwrap_or(text).to_owned()
    };
    let wanted = plain(name);
    DICTIONARY_NAMES
        .iter()
        .copied()
        .find(|n| plain(n) == wanted)
}

fn is_white(code: u64, side: usize, row: usize, column: usize) -> bool {
    code >> (side * side - 1 - (row * side + column)) & 1 == 1
}

/// A code rotated clockwise by 90°.
fn rotated(code: u64, side: usize) -> u64 {
    let cells = (0..side).flat_map(|row| (0..side).map(move |column| (row, column)));
    cells.fold(0, |rotated, (row, column)| {
        // The first column, read upwards, becomes the first row.
        let white = is_white(code, side, side - 1 - column, row);
        rotated << 1 | u64::from(white)
    })
}

#[cfg(test)]
#[path = "dictionary_test.rs"]
mod tests;
