//! Dictionaries: which pattern of black and white cells stands for which number.

mod custom;
mod tables;

use std::path::Path;

use gripcast_base::error::{Error, Result, unknown_name};
use gripcast_base::files::{FileKind, Root};

/// Most cells along a side: a code is a `u64`.
const MAX_SIDE: usize = 8;

/// Names that [`Dictionary::by_name`] knows.
pub const DICTIONARY_NAMES: &[&str] = &[
    "DICT_4X4_50",
    "DICT_4X4_100",
    "DICT_5X5_50",
    "DICT_5X5_100",
    "DICT_5X5_250",
    "DICT_6X6_50",
    "DICT_6X6_100",
    "DICT_6X6_250",
    "DICT_ARUCO_ORIGINAL",
    "DICT_APRILTAG_36h11",
    "36h11",
    "36h11_border2",
];

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

/// Markers of one size and border, each with its number.
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
    /// Cells row by row from the top left, the first in the highest of `side²` bits; 1 is white.
    codes: Vec<u64>,
}

impl Dictionary {
    /// A dictionary by its name, in upper or lower case, with or without the prefix `DICT_`.
    ///
    /// `36h11` stands upright as AprilTag's own images do, `DICT_APRILTAG_36h11` as OpenCV draws
    /// it: the same codes turned by half a turn. `36h11_border2` has the border of two cells that
    /// Kalibr prints. `DICT_ARUCO_ORIGINAL` has markers that look alike when turned
    /// ([`Self::min_distance`] is 0): take it for boards that exist, not for new ones.
    ///
    /// # Errors
    /// `Usage` for another name; the remedy has the nearest one.
    pub fn by_name(name: &str) -> Result<Self> {
        let known = canonical(name).ok_or_else(|| {
            unknown_name("dictionary", name, DICTIONARY_NAMES)
                .remedy("a dictionary of your own is given by its OpenCV file, .yml or .yaml")
        })?;
        let (side, border, codes) = tables::codes(known)?;
        Self::from_codes(known, side, border, codes)
    }

    /// A dictionary by its name, or read from the file that the name is: an OpenCV dictionary
    /// (`.yml`, `.yaml`), its path relative to `folder`.
    ///
    /// # Errors
    /// `Usage` for an unknown name, `Input` or that of the operating system for a file.
    pub fn open(name: &str, folder: &Path) -> Result<Self> {
        if !is_file_name(name) {
            return Self::by_name(name);
        }
        // A board that is stored in a dataset has no folder, and names no file.
        if folder.as_os_str().is_empty() {
            let what =
                format!("the board names a dictionary file, {name:?}, and lies in no folder");
            return Err(
                Error::input(what).remedy("use a dictionary by its name, for instance DICT_4X4_50")
            );
        }
        let path = folder.join(name);
        let text = Root::new(folder)
            .resolve(name)
            .and_then(|place| place.read_to_string(FileKind::Record))
            .map_err(|e| Error::io("cannot read the dictionary", e).at(path.display()))?;
        Self::from_opencv(name, &text).map_err(|e| e.at(path.display()))
    }

    /// A dictionary of OpenCV's format: `nmarkers`, `markersize`, and `marker_N` with the cells row
    /// by row, `1` being white.
    ///
    /// # Errors
    /// `Input`, with the entry that is wrong.
    pub fn from_opencv(name: &str, text: &str) -> Result<Self> {
        let (side, codes) = custom::read(text)?;
        Self::from_codes(name, side, 1, codes)
    }

    /// A dictionary of `side` × `side` cells in a border of `border` black cells. Codes have the
    /// cells row by row from the top left, the first in the highest of the side² bits, 1 is white.
    ///
    /// # Errors
    /// `Input` for a side that is not from 3 to 8, no border, no codes, too long codes, or one
    /// that appears twice.
    pub fn from_codes(name: &str, side: usize, border: usize, codes: Vec<u64>) -> Result<Self> {
        let bad = |what: String| Err(Error::input(what));
        if !(3..=MAX_SIDE).contains(&side) {
            return bad(format!(
                "a marker must have from 3 to {MAX_SIDE} cells along a side, found {side}"
            ));
        }
        if border == 0 || codes.is_empty() {
            return bad("a dictionary needs a border of at least one cell and a marker".to_owned());
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

    /// Its name; that of a known dictionary in its usual form.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Checks that `count` markers from `first_id` on exist.
    ///
    /// # Errors
    /// `Input`; the caller adds what helps.
    pub(crate) fn check_ids(&self, first_id: u32, count: usize) -> Result<()> {
        if first_id as usize + count <= self.len() {
            return Ok(());
        }
        Err(Error::input(format!(
            "{count} markers from id {first_id} are needed, but {} ends with id {}",
            self.name,
            self.len() - 1
        )))
    }

    /// Number of markers; ids run from 0.
    pub fn len(&self) -> usize {
        self.codes.len()
    }

    /// Whether there is no marker; never so.
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

    /// Cells along a side, border and all.
    pub fn cells_per_side(&self) -> usize {
        self.side + 2 * self.border
    }

    /// Cells of a marker; none if the id is not in the dictionary.
    pub fn marker(&self, id: u32) -> Option<MarkerCells> {
        let code = self.code(id)?;
        let side = self.side;
        Some(MarkerCells { side, code })
    }

    /// Cells of a marker row by row from the top left, the first in the highest of side² bits.
    pub fn code(&self, id: u32) -> Option<u64> {
        self.codes.get(id as usize).copied()
    }

    /// Cells of a marker in the order of [`Self::rotation_grouped_places`], the first in the
    /// highest bit: the form of AprilTag 3, in which a quarter turn is a rotation of bits.
    pub fn rotation_grouped_code(&self, id: u32) -> Option<u64> {
        let code = self.code(id)?;
        let places = self.rotation_grouped_places();
        Some(places.iter().fold(0, |grouped, [x, y]| {
            let white = is_white(code, self.side, *y as usize - 1, *x as usize - 1);
            grouped << 1 | u64::from(white)
        }))
    }

    /// Column and row of each bit of [`Self::rotation_grouped_code`], counted from 1 within the
    /// border: a quarter of the cells, the same turned by 90°, 180° and 270°, and the middle.
    pub fn rotation_grouped_places(&self) -> Vec<[u32; 2]> {
        let n = self.side as u32;
        let ring = |r: u32| (r..=n - r).map(move |x| [x, r]);
        let mut quarter: Vec<[u32; 2]> = (1..=n / 2).flat_map(ring).collect();
        let mut places = quarter.clone();
        for _ in 0..3 {
            for place in &mut quarter {
                *place = [n + 1 - place[1], place[0]];
            }
            places.extend(&quarter);
        }
        if n % 2 == 1 {
            places.push([n.div_ceil(2); 2]);
        }
        places
    }

    /// Fewest cells in which two markers differ, each turned in all ways, or a marker differs from
    /// itself turned. Compares all pairs: some milliseconds.
    pub fn min_distance(&self) -> u32 {
        let turned: Vec<[u64; 4]> = self.codes.iter().map(|&c| self.turns(c)).collect();
        let mut least = (self.side * self.side) as u32;
        for (id, turns) in turned.iter().enumerate() {
            let itself = turns[1..].iter().map(|t| (turns[0] ^ t).count_ones());
            let others = turned[..id].iter().flatten();
            let others = others.map(|t| (turns[0] ^ t).count_ones());
            least = itself.chain(others).fold(least, u32::min);
        }
        least
    }

    /// A code turned by 0, 1, 2 and 3 quarters clockwise.
    fn turns(&self, code: u64) -> [u64; 4] {
        let mut turns = [code; 4];
        for quarter in 1..4 {
            turns[quarter] = turned(turns[quarter - 1], self.side);
        }
        turns
    }
}

/// Whether a name in place of a dictionary means a file.
fn is_file_name(name: &str) -> bool {
    let suffix = Path::new(name).extension().unwrap_or_default();
    suffix.eq_ignore_ascii_case("yml") || suffix.eq_ignore_ascii_case("yaml")
}

/// The known name that is meant.
fn canonical(name: &str) -> Option<&'static str> {
    let plain = |text: &str| {
        let text = text.trim().to_ascii_lowercase();
        let text = text.strip_prefix("dict_").unwrap_or(&text);
        match text {
            "tag36h11" | "t36h11" => "36h11".to_owned(),
            other => other.to_owned(),
        }
    };
    let wanted = plain(name);
    let is_meant = |known: &&&str| plain(known) == wanted;
    DICTIONARY_NAMES.iter().find(is_meant).copied()
}

fn is_white(code: u64, side: usize, row: usize, column: usize) -> bool {
    code >> (side * side - 1 - (row * side + column)) & 1 == 1
}

/// Cells of a marker that is turned clockwise by a quarter.
fn turned(code: u64, side: usize) -> u64 {
    let mut turned = 0;
    for row in 0..side {
        for column in 0..side {
            // What stood in the first column, read upwards, becomes the first row.
            let white = is_white(code, side, side - 1 - column, row);
            turned = turned << 1 | u64::from(white);
        }
    }
    turned
}

#[cfg(test)]
#[path = "dictionary_test.rs"]
mod tests;
