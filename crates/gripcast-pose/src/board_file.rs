//! Board files.
//!
//! TOML. Corners are in mm, as read off a ruler, everything else is in SI units:
//!
//! ```toml
//! schema = 1
//! name = "mug"
//! dictionary = "DICT_6X6_250"
//!
//! [[marker]]
//! id = 0
//! part = "object"
//! corners_mm = [[-130.5, 90.0, -40.0], [-100.5, 90.0, -40.0], [-100.5, 60.0, -40.0], [-130.5,
//! 60.0, -40.0]]
//! ```

use std::fmt::Write as _;
use std::path::Path;

use glam::DVec3;
use serde::Deserialize;

use super::board::{Board, BoardMarker};
use super::chessboard::Chessboard;
use super::dictionary::Dictionary;
use super::print::check_ruler_lengths;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{FileKind, Root, read_text, sha256_hex};
use gripcast_geometry::Pose;

/// Version of the format.
const SCHEMA: i64 = 1;
/// Dictionary of a chessboard without markers, which has no meaning.
const UNUSED_DICTIONARY: &str = "DICT_4X4_50";
/// Hexadecimal digits of a board's hash.
const HASH_DIGITS: usize = 12;

/// The printed sheet that an object stands on.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PrintedSheet {
    /// Mesh that the sheet was drawn for: a file or `builtin:NAME`.
    pub object: String,
    /// Content hash of that mesh as drawn, in metres.
    pub object_sha256: String,
    /// Paper size.
    pub paper: String,
    /// Hash printed on the sheet: that of the board as drawn.
    pub printed_hash: String,
    /// Measured lengths of the printed 100 mm rulers along x and y, mm; the corners are corrected
    /// by them.
    pub measured_mm: [f64; 2],
    /// Pose of the object on the sheet: z up, the sheet at z = 0, x to the right of the sheet.
    pub t_world_object: Pose,
}

/// A board with its dictionary, its printed sheet and its chessboard.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardFile {
    /// The markers.
    pub board: Board,
    /// Their dictionary.
    pub dictionary: Dictionary,
    /// The sheet, for a board drawn for an object.
    pub sheet: Option<PrintedSheet>,
    /// The squares, for a chessboard with or without markers.
    pub chessboard: Option<Chessboard>,
}

impl Board {
    /// Hash of dictionary, ids, bodies and corners (to 1 nm): the first 12 hexadecimal digits of a
    /// SHA-256. Independent of the name and of the order of the markers.
    pub fn hash(&self) -> String {
        let mut markers: Vec<&BoardMarker> = self.markers.iter().collect();
        markers.sort_by_key(|m| m.id);
        let mut text = format!("{}\n", self.dictionary);
        for marker in markers {
            text += &marker_text(marker);
        }
        let mut digits = sha256_hex(text);
        digits.truncate(HASH_DIGITS);
        digits
    }
}

impl BoardFile {
    /// Validates a board against its dictionary and sheet.
    ///
    /// # Errors
    /// Those of [`Board::check`].
    pub fn new(board: Board, dictionary: Dictionary, sheet: Option<PrintedSheet>) -> Result<Self> {
        let up = sheet.as_ref().map(|sheet| {
            let t_object_world = sheet.t_world_object.inverse();
            t_object_world.transform_vector(DVec3::Z)
        });
        board.check(&dictionary, up)?;
        Ok(Self {
            board,
            dictionary,
            sheet,
            chessboard: None,
        })
    }

    /// Returns the default tags of a UMI gripper, `calib/boards/gripper-umi.toml`.
    ///
    /// # Errors
    /// None in practice: the file is built in and tested.
    pub fn gripper_umi() -> Result<Self> {
        let text = include_str!("../../../calib/boards/gripper-umi.toml");
        Self::parse(text, Path::new(""))
    }

    /// Adds the chessboard that the markers are on.
    ///
    /// # Errors
    /// `Input` if the markers are not in the white squares of the chessboard.
    pub fn with_chessboard(mut self, chessboard: Chessboard) -> Result<Self> {
        chessboard.check(&self.board)?;
        self.chessboard = Some(chessboard);
        Ok(self)
    }

    /// A chessboard without markers, given its columns and rows of inner corners and the width and
    /// height of a square.
    ///
    /// # Errors
    /// `Input` for implausible sizes.
    pub fn plain_chessboard(name: &str, corners: [u32; 2], square_mm: [f64; 2]) -> Result<Self> {
        let chessboard = Chessboard {
            squares: corners.map(|n| n.saturating_add(1)),
            square_mm,
            legacy: false,
            printed_hash: None,
        };
        Self::without_markers(name.to_owned(), chessboard)
    }

    fn without_markers(name: String, chessboard: Chessboard) -> Result<Self> {
        chessboard.check_size()?;
        let dictionary = Dictionary::by_name(UNUSED_DICTIONARY)?;
        Ok(Self {
            board: Board {
                name,
                dictionary: dictionary.name().to_owned(),
                markers: Vec::new(),
            },
            dictionary,
            sheet: None,
            chessboard: Some(chessboard),
        })
    }

    /// The chessboard of a file without markers.
    #[must_use]
    pub fn plain(&self) -> Option<&Chessboard> {
        let chessboard = self.chessboard.as_ref();
        chessboard.filter(|_| self.board.markers.is_empty())
    }

    /// Reads and validates a file. A custom dictionary is looked up in the same folder.
    ///
    /// # Errors
    /// IO errors, or `Input` naming the line or the marker.
    pub fn load(path: &Path) -> Result<Self> {
        let text = read_text(path, FileKind::Record)
            .map_err(|e| Error::io("cannot read the board", e).at(path.display()))?;
        Self::parse(&text, Root::beside(path).root().path()).map_err(|e| e.at(path.display()))
    }

    /// Parses and validates the text of a file in `folder`.
    ///
    /// # Errors
    /// As [`Self::load`].
    pub fn parse(text: &str, folder: &Path) -> Result<Self> {
        let mut read: Record = toml::from_str(text).map_err(|e| malformed(text, &e))?;
        if read.schema != SCHEMA {
            let what = format!("expected board schema {SCHEMA}, found {}", read.schema);
            return Err(
                Error::input(what).remedy("read it with the release of gripcast that wrote it")
            );
        }
        let name = match (read.dictionary, read.chessboard) {
            (None, Some(chessboard)) if read.marker.is_empty() => {
                return Self::without_markers(read.name, chessboard);
            }
            (Some(name), chessboard) => {
                read.chessboard = chessboard;
                name
            }
            (None, _) => {
                return Err(Error::input("missing field `dictionary`")
                    .remedy("only a chessboard without markers needs none"));
            }
        };
        let dictionary = Dictionary::open(&name, folder)?;
        let markers: Result<Vec<BoardMarker>> = read.marker.iter().map(marker).collect();
        let board = Board {
            name: read.name,
            dictionary: dictionary.name().to_owned(),
            markers: markers?,
        };
        if let Some(sheet) = &read.sheet {
            check_ruler_lengths(sheet.measured_mm)?;
        }
        let file = Self::new(board, dictionary, read.sheet)?;
        match read.chessboard {
            Some(chessboard) => file.with_chessboard(chessboard),
            None => Ok(file),
        }
    }

    /// Serialises the board as TOML.
    pub fn to_toml(&self) -> String {
        let board = &self.board;
        let quoted = |text: &str| toml::Value::from(text).to_string();
        let mut text = format!("schema = {SCHEMA}\nname = {}\n", quoted(&board.name));
        if self.plain().is_none() {
            let _ = writeln!(text, "dictionary = {}", quoted(&board.dictionary));
        }
        if let Some(sheet) = &self.sheet {
            let t = sheet.t_world_object;
            let q = t.rotation;
            let _ = write!(
                text,
                "\n[sheet]\nobject = {}\nobject_sha256 = {}\npaper = {}\nprinted_hash = {}\n\
                 measured_mm = {:?}\n\
                 t_world_object = {{ t_m = {:?}, q_wxyz = {:?} }}\n",
                quoted(&sheet.object),
                quoted(&sheet.object_sha256),
                quoted(&sheet.paper),
                quoted(&sheet.printed_hash),
                sheet.measured_mm,
                t.translation_m.to_array(),
                [q.w, q.x, q.y, q.z],
            );
        }
        if let Some(chessboard) = &self.chessboard {
            text += &chessboard_text(chessboard);
        }
        for marker in &board.markers {
            text += &marker_text(marker);
        }
        text
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Record {
    schema: i64,
    name: String,
    dictionary: Option<String>,
    sheet: Option<PrintedSheet>,
    chessboard: Option<Chessboard>,
    #[serde(default)]
    marker: Vec<MarkerRecord>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct MarkerRecord {
    id: u32,
    part: String,
    corners_mm: [[f64; 3]; 4],
}

fn marker(record: &MarkerRecord) -> Result<BoardMarker> {
    let body = record.part.parse().map_err(|e: Error| {
        Error::input(e.what().to_owned())
            .remedy(e.remedy_text().unwrap_or_default())
            .at(format!("marker {}", record.id))
    })?;
    Ok(BoardMarker {
        id: record.id,
        body,
        corners_m: record.corners_mm.map(|c| 1e-3 * DVec3::from_array(c)),
    })
}

/// TOML of a marker; also what is hashed.
fn marker_text(marker: &BoardMarker) -> String {
    let corners = marker.corners_m.map(|corner| {
        let [x, y, z] = corner.to_array().map(millimetres);
        format!("[{x}, {y}, {z}]")
    });
    format!(
        "\n[[marker]]\nid = {}\npart = \"{}\"\ncorners_mm = [{}]\n",
        marker.id,
        marker.body,
        corners.join(", ")
    )
}

fn chessboard_text(chessboard: &Chessboard) -> String {
    let [width, height] = chessboard.square_mm.map(|mm| millimetres(1e-3 * mm));
    let printed = chessboard.printed_hash.as_ref().map_or(String::new(), |h| {
        format!("printed_hash = {}\n", toml::Value::from(&**h))
    });
    format!(
        "\n[chessboard]\nsquares = {:?}\nsquare_mm = [{width}, {height}]\nlegacy = {}\n{printed}",
        chessboard.squares, chessboard.legacy
    )
}

/// Formats a length in mm, rounded to 1 nm.
fn millimetres(length_m: f64) -> String {
    let rounded = (1e9 * length_m).round() / 1e6;
    // Adding zero maps −0 to 0.
    format!("{:?}", rounded + 0.0)
}

fn malformed(text: &str, error: &toml::de::Error) -> Error {
    let input = Error::input(error.message().trim());
    let Some(span) = error.span() else {
        return input;
    };
    let before = text.get(..span.start).unwrap_or_default();
    input.at(format!("line {}", before.matches('\n').count() + 1))
}

#[cfg(test)]
mod tests {
    use super::super::board::Body;
    use std::fs;

    use super::*;
    use gripcast_base::error::ErrorKind;

    fn file() -> BoardFile {
        let marker = |id: u32, body: Body| BoardMarker {
            id,
            body,
            corners_m: BoardMarker::square_corners(
                DVec3::new(0.07 * f64::from(id), 1.0 / 3.0, -0.0123456789),
                DVec3::X,
                DVec3::Y,
                0.03,
            ),
        };
        let board = Board {
            name: "two \"parts\" ü".into(),
            dictionary: "DICT_6X6_250".into(),
            markers: vec![marker(7, Body::Object), marker(3, Body::FingerLeft)],
        };
        let sheet = PrintedSheet {
            object: "builtin:mug".into(),
            object_sha256: "00ff".into(),
            paper: "A4".into(),
            printed_hash: "0123456789ab".into(),
            measured_mm: [100.0, 99.75],
            t_world_object: Pose::from_translation(DVec3::new(0.1, 0.2, 0.3)),
        };
        let dictionary = Dictionary::by_name("DICT_6X6_250").unwrap();
        BoardFile::new(board, dictionary, Some(sheet)).unwrap()
    }

    fn parse(text: &str) -> Result<BoardFile> {
        BoardFile::parse(text, Path::new(""))
    }

    #[test]
    fn board_round_trips_through_toml() {
        let first = file();
        let text = first.to_toml();
        let read = parse(&text).unwrap();
        assert_eq!(read.to_toml(), text);
        assert_eq!(read.sheet, first.sheet);
        assert_eq!(read.board.hash(), first.board.hash());
        for (a, b) in read.board.markers.iter().zip(&first.board.markers) {
            assert_eq!((a.id, a.body), (b.id, b.body));
            for (p, q) in a.corners_m.iter().zip(&b.corners_m) {
                assert!(p.distance(*q) < 1e-9);
            }
        }
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("board.toml");
        fs::write(&path, &text).unwrap();
        assert_eq!(BoardFile::load(&path).unwrap(), read);
    }

    #[test]
    fn chessboard_without_markers_needs_no_dictionary() {
        let file = BoardFile::plain_chessboard("plain", [9, 6], [25.0, 24.9]).unwrap();
        let text = file.to_toml();
        assert!(!text.contains("dictionary"), "{text}");
        assert_eq!(parse(&text).unwrap(), file);
        assert_eq!(file.plain().unwrap().squares, [10, 7]);
        let chessboard = text.find("\n[chessboard]").unwrap();
        assert!(parse(&text[..chessboard]).is_err());
        assert!(BoardFile::plain_chessboard("p", [1, 6], [25.0; 2]).is_err());
    }

    #[test]
    fn chessboard_round_trips_through_toml() {
        let chessboard = Chessboard {
            squares: [8, 6],
            square_mm: [30.1, 29.9],
            legacy: true,
            printed_hash: Some("0123".into()),
        };
        let dictionary = Dictionary::by_name("DICT_6X6_250").unwrap();
        let board = chessboard.board("c", &dictionary, 0, [21.07, 20.93]);
        let file = BoardFile::new(board.unwrap(), dictionary, None).unwrap();
        let text = file.with_chessboard(chessboard.clone()).unwrap().to_toml();
        assert_eq!(parse(&text).unwrap().chessboard, Some(chessboard));
        assert_eq!(parse(&text).unwrap().to_toml(), text);
        let swapped = text.replace("legacy = true", "legacy = false");
        let message = parse(&swapped).unwrap_err().to_string();
        assert!(message.contains("black square"), "{message}");
    }

    #[test]
    fn hash_ignores_name_and_marker_order() {
        let board = file().board;
        let mut other = board.clone();
        other.name = "else".into();
        other.markers.reverse();
        assert_eq!(other.hash(), board.hash());
        assert_eq!(board.hash().len(), 12);
        let mut moved = board.clone();
        moved.markers[0].corners_m[0].x += 1e-6;
        assert_ne!(moved.hash(), board.hash());
        let mut renamed = board.clone();
        renamed.dictionary = "DICT_6X6_100".into();
        assert_ne!(renamed.hash(), board.hash());
    }

    #[test]
    fn malformed_files_name_line_or_marker() {
        let text = file().to_toml();
        for (from, to, expected) in [
            ("schema = 1", "schema = 2", "schema 1, found 2"),
            (
                "part = \"object\"",
                "part = \"hand\"",
                "marker 7: unknown part \"hand\"",
            ),
            (
                "DICT_6X6_250",
                "DICT_6X6_2500",
                "did you mean DICT_6X6_250?",
            ),
            ("id = 3", "id = -3", "line 19"),
            ("id = 3", "number = 3", "unknown field `number`"),
            ("id = 3", "id = 7", "marker 7 is listed twice"),
            ("measured_mm = [100.0", "measured_mm = [10.0", "100 mm"),
            ("corners_mm = [[", "corners_mm = [[[", "line "),
            ("q_wxyz = [1.0", "q_wxyz = [2.0", "unit quaternion"),
        ] {
            assert!(text.contains(from), "{from}\n{text}");
            let message = parse(&text.replacen(from, to, 1)).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
        let message = parse("").unwrap_err().to_string();
        assert!(message.contains("schema"), "{message}");
        let missing = BoardFile::load(Path::new("/proc/nonexistent/b.toml")).unwrap_err();
        assert_eq!(missing.kind(), ErrorKind::NotFound);
    }
}
