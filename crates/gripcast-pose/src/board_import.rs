//! Import of boards from ROS and Kalibr.
//!
//! | program | file | frame |
//! | --- | --- | --- |
//! | ROS `aruco_opencv` | `board_descriptions.yaml`: a list of grids | x right, y up, z out of the sheet; origin at the centre or the bottom left corner |
//! | Kalibr | `target.yaml` with `target_type: aprilgrid` | the same, origin at the bottom left corner of tag 0 |
//!
//! ROS nodes built with OpenCV 4.7 or later use y down and z into the sheet; the markers are the
//! same.

use glam::{DVec2, DVec3};
use serde::Deserialize;

use super::board::{Board, BoardMarker, Body};
use super::board_check::check_side;
use super::board_file::BoardFile;
use super::dictionary::Dictionary;
use super::yaml;
use gripcast_base::error::{Error, Result};

/// Maximum number of markers of an imported board.
const MAX_MARKERS: u64 = 1024;

/// Third-party board formats.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BoardFormat {
    /// `board_descriptions.yaml` of ROS `aruco_opencv`.
    Ros,
    /// `target.yaml` of Kalibr, an aprilgrid.
    Kalibr,
    /// OpenCV dictionary; contains no board.
    OpencvDictionary,
}

impl BoardFormat {
    /// Detects the format from the keys of a text.
    ///
    /// # Errors
    /// `Input` for an unknown format.
    pub fn detect(text: &str) -> Result<Self> {
        let has = |key: &str| {
            let starts = |line: &str| {
                let line = line.trim_start_matches([' ', '-', '\t']);
                line.strip_prefix(key)
                    .is_some_and(|rest| rest.trim_start().starts_with(':'))
            };
            text.lines().any(starts)
        };
        if has("target_type") {
            Ok(Self::Kalibr)
        } else if has("markers_x") || has("marker_size") {
            Ok(Self::Ros)
        } else if has("nmarkers") || has("markersize") {
            Ok(Self::OpencvDictionary)
        } else {
            Err(Error::input("unknown board format").remedy(
                "supported: board_descriptions.yaml of ROS aruco_opencv (markers_x …), target.yaml \
                 of Kalibr (target_type: aprilgrid), OpenCV dictionary (nmarkers …)",
            ))
        }
    }
}

/// Imports all boards of a `board_descriptions.yaml`. The dictionary is a parameter of the ROS node
/// and not in the file.
///
/// # Errors
/// `Input` for a malformed file or an invalid board, which is named.
pub fn import_ros(text: &str, dictionary: &Dictionary) -> Result<Vec<BoardFile>> {
    let grids: Vec<RosGrid> = yaml::read(text, "the list of boards")?;
    if grids.is_empty() {
        return Err(Error::input("the list of boards is empty"));
    }
    let mut names: Vec<&str> = grids.iter().map(|g| &*g.name).collect();
    names.sort_unstable();
    if let Some(pair) = names.windows(2).find(|pair| pair[0] == pair[1]) {
        let what = format!("two boards are named {:?}", pair[0]);
        return Err(Error::input(what).remedy("rename one of them"));
    }
    let read = |grid: &RosGrid| {
        let board = grid.grid().board(&grid.name, dictionary);
        board.map_err(|e| e.at(format!("board {:?}", grid.name)))
    };
    grids.iter().map(read).collect()
}

/// Imports an aprilgrid. Kalibr prints tags with a border of two cells, `36h11_border2`;
/// `dictionary` overrides that.
///
/// # Errors
/// `Input` for another target type or implausible sizes.
pub fn import_kalibr(text: &str, name: &str, dictionary: Option<&Dictionary>) -> Result<BoardFile> {
    let target: KalibrTarget = yaml::read(text, "the target")?;
    if target.target_type != "aprilgrid" {
        let what = format!("target type {:?} has no marker ids", target.target_type);
        return Err(Error::input(what).remedy("give a target with target_type: aprilgrid"));
    }
    let missing = |key: &str| Error::input(format!("the target has no {key}"));
    let side = target.side.ok_or_else(|| missing("tagSize"))?;
    let spacing = target.spacing.ok_or_else(|| missing("tagSpacing"))?;
    if !(0.0..=2.0).contains(&spacing) {
        let what = format!("tagSpacing must be a fraction of tagSize, found {spacing}");
        return Err(Error::input(what).remedy("divide the gap between two tags by tagSize"));
    }
    let grid = Grid {
        columns: target.columns.ok_or_else(|| missing("tagCols"))?,
        rows: target.rows.ok_or_else(|| missing("tagRows"))?,
        side_m: side,
        gap_m: spacing * side,
        first_id: 0,
        is_bottom_up: true,
        is_origin_centered: false,
    };
    let dictionary = match dictionary {
        Some(dictionary) => dictionary.clone(),
        None => Dictionary::by_name("36h11_border2")?,
    };
    grid.board(name, &dictionary)
}

#[derive(Deserialize)]
struct RosGrid {
    name: String,
    frame_at_center: bool,
    first_id: u32,
    markers_x: u32,
    markers_y: u32,
    marker_size: f64,
    separation: f64,
}

impl RosGrid {
    fn grid(&self) -> Grid {
        Grid {
            columns: self.markers_x,
            rows: self.markers_y,
            side_m: self.marker_size,
            gap_m: self.separation,
            first_id: self.first_id,
            is_bottom_up: false,
            is_origin_centered: self.frame_at_center,
        }
    }
}

#[derive(Deserialize)]
struct KalibrTarget {
    target_type: String,
    #[serde(rename = "tagCols")]
    columns: Option<u32>,
    #[serde(rename = "tagRows")]
    rows: Option<u32>,
    #[serde(rename = "tagSize")]
    side: Option<f64>,
    #[serde(rename = "tagSpacing")]
    spacing: Option<f64>,
}

/// Markers in rows and columns, numbered row by row from the left.
struct Grid {
    columns: u32,
    rows: u32,
    side_m: f64,
    gap_m: f64,
    first_id: u32,
    /// The first row is the lowest.
    is_bottom_up: bool,
    is_origin_centered: bool,
}

impl Grid {
    fn board(&self, name: &str, dictionary: &Dictionary) -> Result<BoardFile> {
        let count = u64::from(self.columns) * u64::from(self.rows);
        if count == 0 || count > MAX_MARKERS {
            let what = format!(
                "a grid must have from 1 to {MAX_MARKERS} markers, found {} × {}",
                self.columns, self.rows
            );
            return Err(Error::input(what));
        }
        check_side(self.side_m)?;
        if !(self.gap_m >= 0.0 && self.gap_m <= 4.0 * self.side_m) {
            let what = format!(
                "implausible gap of {} m between markers of {} m",
                self.gap_m, self.side_m
            );
            return Err(
                Error::input(what).remedy("give marker size and gap between markers in metres")
            );
        }
        if u64::from(self.first_id) + count > dictionary.len() as u64 {
            let what = format!(
                "a grid of {count} markers from id {} exceeds {}, which has {} markers",
                self.first_id,
                dictionary.name(),
                dictionary.len()
            );
            return Err(
                Error::input(what).remedy("name the dictionary that the board was printed with")
            );
        }
        let board = Board {
            name: name.to_owned(),
            dictionary: dictionary.name().to_owned(),
            markers: (0..count as u32).map(|k| self.marker(k)).collect(),
        };
        BoardFile::new(board, dictionary.clone(), None)
    }

    fn marker(&self, number: u32) -> BoardMarker {
        let pitch = self.side_m + self.gap_m;
        let size = DVec2::new(f64::from(self.columns), f64::from(self.rows)) * pitch - self.gap_m;
        let (column, mut row) = (number % self.columns, number / self.columns);
        if !self.is_bottom_up {
            row = self.rows - 1 - row;
        }
        let corner = DVec2::new(f64::from(column), f64::from(row)) * pitch;
        let origin = if self.is_origin_centered {
            0.5 * size
        } else {
            DVec2::ZERO
        };
        let center = (corner + 0.5 * self.side_m - origin).extend(0.0);
        BoardMarker {
            id: self.first_id + number,
            body: Body::Object,
            corners_m: BoardMarker::square_corners(center, DVec3::X, DVec3::Y, self.side_m),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_base::error::ErrorKind;

    const ROS: &str = "\
- name: \"GridBoard_1\"
  frame_at_center: true
  first_id: 10
  markers_x: 3
  markers_y: 4
  marker_size: 0.03
  separation: 0.005
- name: corner
  frame_at_center: false
  first_id: 0
  markers_x: 1
  markers_y: 2
  marker_size: 0.04
  separation: 0.01
";
    const KALIBR: &str = "\
target_type: 'aprilgrid' #gridtype
tagCols: 6               #number of apriltags
tagRows: 5
tagSize: 0.088           #size of apriltag, edge to edge [m]
tagSpacing: 0.3          #ratio of space between tags to tagSize
";

    fn dictionary() -> Dictionary {
        Dictionary::by_name("4X4_50").unwrap()
    }

    #[test]
    fn ros_grid_ids_start_at_top_left() {
        let boards = import_ros(ROS, &dictionary()).unwrap();
        assert_eq!(boards.len(), 2);
        let grid = &boards[0].board;
        assert_eq!(grid.ids(), (10..22).collect::<Vec<u32>>());
        let corner = |id: u32, k: usize| {
            let marker = grid.markers.iter().find(|m| m.id == id).unwrap();
            1e3 * marker.corners_m[k]
        };
        // 100 × 135 mm, the origin at the centre.
        assert!(corner(10, 0).distance(DVec3::new(-50.0, 67.5, 0.0)) < 1e-9);
        assert!(corner(12, 1).distance(DVec3::new(50.0, 67.5, 0.0)) < 1e-9);
        assert!(corner(21, 2).distance(DVec3::new(50.0, -67.5, 0.0)) < 1e-9);
        let below = &boards[1].board.markers[1];
        assert!((1e3 * below.corners_m[3]).distance(DVec3::ZERO) < 1e-9);
        assert!(grid.is_planar(Body::Object));
    }

    #[test]
    fn kalibr_grid_ids_start_at_bottom_left() {
        let file = import_kalibr(KALIBR, "grid", None).unwrap();
        assert_eq!(file.board.dictionary, "36h11_border2");
        assert_eq!(file.board.markers.len(), 30);
        let corner = |id: usize, k: usize| 1e3 * file.board.markers[id].corners_m[k];
        assert!(corner(0, 3).distance(DVec3::ZERO) < 1e-9);
        assert!(corner(1, 3).distance(DVec3::new(114.4, 0.0, 0.0)) < 1e-9);
        assert!(corner(6, 3).distance(DVec3::new(0.0, 114.4, 0.0)) < 1e-9);
        let one = Dictionary::by_name("36h11").unwrap();
        let other = import_kalibr(KALIBR, "grid", Some(&one)).unwrap();
        assert_eq!(other.board.dictionary, "36h11");
    }

    #[test]
    fn invalid_ros_boards_are_refused() {
        for (from, to, expected) in [
            (
                "marker_size: 0.03",
                "marker_size: 30",
                "millimetres where metres",
            ),
            (
                "marker_size: 0.03",
                "marker_size: 3",
                "centimetres where metres",
            ),
            ("separation: 0.005", "separation: 5", "gap of 5"),
            ("separation: 0.005", "separation: -0.005", "gap of -0.005"),
            ("first_id: 10", "first_id: 45", "exceeds DICT_4X4_50"),
            ("markers_x: 3", "markers_x: 0", "from 1 to 1024"),
            ("markers_x: 3", "markers_x: 4000000000", "from 1 to 1024"),
            ("  markers_y: 4\n", "", "markers_y"),
            ("name: corner", "name: GridBoard_1", "two boards are named"),
            ("frame_at_center: true", "frame_at_center: [", "cannot read"),
        ] {
            assert!(ROS.contains(from));
            let text = ROS.replacen(from, to, 1);
            let message = import_ros(&text, &dictionary()).unwrap_err().to_string();
            assert!(message.contains(expected), "{from} → {to}: {message}");
        }
        let message = import_ros("[]", &dictionary()).unwrap_err().to_string();
        assert!(message.contains("empty"), "{message}");
        assert!(import_ros("name: x", &dictionary()).is_err());
    }

    #[test]
    fn invalid_kalibr_targets_are_refused() {
        for (from, to, expected) in [
            ("'aprilgrid'", "'checkerboard'", "no marker ids"),
            (
                "tagSize: 0.088 ",
                "tagSize: 88 ",
                "millimetres where metres",
            ),
            ("tagSpacing: 0.3", "tagSpacing: 26.4", "fraction of tagSize"),
            ("tagRows: 5\n", "", "no tagRows"),
            ("tagCols: 6", "tagCols: 200", "exceeds 36h11"),
        ] {
            let text = KALIBR.replacen(from, to, 1);
            let message = import_kalibr(&text, "g", None).unwrap_err().to_string();
            assert!(message.contains(expected), "{from} → {to}: {message}");
        }
    }

    #[test]
    fn truncated_or_damaged_files_give_board_or_input_error() {
        let rejected = |error: Error| {
            assert_eq!(error.kind(), ErrorKind::Input, "{error}");
            0
        };
        // Number of boards read; each was validated against its dictionary.
        let read = |text: &str| {
            let ros = import_ros(text, &dictionary()).map_or_else(rejected, |all| all.len());
            let kalibr = import_kalibr(text, "g", None).map_or_else(rejected, |_| 1);
            ros + kalibr
        };
        for (text, count) in [(ROS, 2), (KALIBR, 1)] {
            assert_eq!(read(text), count);
            for at in 0..text.len() {
                let cut = &text[..at];
                assert!(read(cut) <= count, "{cut}");
                for byte in ["[", ":", "-", "9", "&a", "*a", "\0"] {
                    let damaged = format!("{}{byte}{}", cut, &text[at + 1..]);
                    assert!(read(&damaged) <= count, "{damaged}");
                }
            }
            // Without its first key the file is invalid.
            let (_, rest) = text.split_once(':').unwrap();
            assert_eq!(read(rest), 0);
        }
    }

    #[test]
    fn format_is_detected_from_keys() {
        let kind = |text: &str| BoardFormat::detect(text).unwrap();
        assert_eq!(kind(ROS), BoardFormat::Ros);
        assert_eq!(kind(KALIBR), BoardFormat::Kalibr);
        let dictionary = "%YAML:1.0\nnmarkers: 3\nmarkersize: 4\n";
        assert_eq!(kind(dictionary), BoardFormat::OpencvDictionary);
        let message = BoardFormat::detect("camera: 3").unwrap_err().to_string();
        assert!(message.contains("target_type"), "{message}");
    }
}
