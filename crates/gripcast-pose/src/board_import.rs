//! Boards as other programs describe them.
//!
//! | program | file | frame |
//! | --- | --- | --- |
//! | ROS `aruco_opencv` | `board_descriptions.yaml`: a list of grids | x right, y up, z out of the sheet; origin in the middle or at the bottom left corner |
//! | Kalibr | `target.yaml` with `target_type: aprilgrid` | the same, origin at the bottom left corner of tag 0 |
//!
//! ROS nodes built with OpenCV 4.7 or later count y downwards and z into the sheet; the markers
//! are the same.

use glam::{DVec2, DVec3};
use serde::Deserialize;

use super::board::{Board, BoardMarker, Part};
use super::board_check::check_side;
use super::board_file::BoardFile;
use super::dictionary::Dictionary;
use super::yaml;
use gripcast_base::error::{Error, Result};

/// Most markers of an imported board.
const MAX_MARKERS: u64 = 1024;

/// Program whose file is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ForeignBoard {
    /// `board_descriptions.yaml` of ROS `aruco_opencv`.
    Ros,
    /// `target.yaml` of Kalibr, an aprilgrid.
    Kalibr,
    /// A dictionary of OpenCV, which is no board.
    OpencvDictionary,
}

impl ForeignBoard {
    /// What a text is, by the keys in it.
    ///
    /// # Errors
    /// `Input` if it is none of them.
    pub fn recognise(text: &str) -> Result<Self> {
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
            Err(Error::input("the file is no board description that is known")
            .remedy(
                "known are: board_descriptions.yaml of ROS aruco_opencv (markers_x …), target.yaml \
                 of Kalibr (target_type: aprilgrid), a dictionary of OpenCV (nmarkers …)",
            ))
        }
    }
}

/// All boards of a `board_descriptions.yaml`. The dictionary is a parameter of the ROS node, not
/// part of the file.
///
/// # Errors
/// `Input` for what is no such file, or a board that cannot be; it is named.
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
        let at = format!("board {:?}", grid.name);
        grid.board(dictionary).map_err(|e| e.at(at))
    };
    grids.iter().map(read).collect()
}

/// An aprilgrid. Kalibr prints its tags with a border of two cells, `36h11_border2`; `dictionary`
/// replaces that, for grids printed otherwise.
///
/// # Errors
/// `Input` for another target, or sizes that cannot be.
pub fn import_kalibr(text: &str, name: &str, dictionary: Option<&Dictionary>) -> Result<BoardFile> {
    let target: KalibrTarget = yaml::read(text, "the target")?;
    if target.target_type != "aprilgrid" {
        let what = format!(
            "the target is a {:?}, which has no numbered markers",
            target.target_type
        );
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
        rows_run_up: true,
        origin_in_middle: false,
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
    fn board(&self, dictionary: &Dictionary) -> Result<BoardFile> {
        let grid = Grid {
            columns: self.markers_x,
            rows: self.markers_y,
            side_m: self.marker_size,
            gap_m: self.separation,
            first_id: self.first_id,
            rows_run_up: false,
            origin_in_middle: self.frame_at_center,
        };
        grid.board(&self.name, dictionary)
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

/// Markers in rows and columns, numbered along rows from the left.
struct Grid {
    columns: u32,
    rows: u32,
    side_m: f64,
    gap_m: f64,
    first_id: u32,
    /// The first row is the lowest.
    rows_run_up: bool,
    origin_in_middle: bool,
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
                "markers of {} m cannot be {} m apart",
                self.side_m, self.gap_m
            );
            return Err(Error::input(what)
                .remedy("give the size of a marker and the gap between two, both in metres"));
        }
        if u64::from(self.first_id) + count > dictionary.len() as u64 {
            let what = format!(
                "a grid of {count} markers from id {} does not fit into {}, which has {}",
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
        let row = number / self.columns;
        let from_below = if self.rows_run_up {
            row
        } else {
            self.rows - 1 - row
        };
        let place = DVec2::new(f64::from(number % self.columns), f64::from(from_below)) * pitch;
        let origin = if self.origin_in_middle {
            0.5 * size
        } else {
            DVec2::ZERO
        };
        let center = place + 0.5 * self.side_m - origin;
        BoardMarker {
            id: self.first_id + number,
            part: Part::Object,
            corners_m: BoardMarker::square(center.extend(0.0), DVec3::X, DVec3::Y, self.side_m),
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
    fn ros_grids_are_numbered_from_the_top_left() {
        let boards = import_ros(ROS, &dictionary()).unwrap();
        assert_eq!(boards.len(), 2);
        let grid = &boards[0].board;
        assert_eq!(grid.ids(), (10..22).collect::<Vec<u32>>());
        let corner = |id: u32, k: usize| {
            let marker = grid.markers.iter().find(|m| m.id == id).unwrap();
            1e3 * marker.corners_m[k]
        };
        // 100 × 135 mm, the origin in the middle.
        assert!(corner(10, 0).distance(DVec3::new(-50.0, 67.5, 0.0)) < 1e-9);
        assert!(corner(12, 1).distance(DVec3::new(50.0, 67.5, 0.0)) < 1e-9);
        assert!(corner(21, 2).distance(DVec3::new(50.0, -67.5, 0.0)) < 1e-9);
        let below = &boards[1].board.markers[1];
        assert!((1e3 * below.corners_m[3]).distance(DVec3::ZERO) < 1e-9);
        assert!(grid.is_planar(Part::Object));
    }

    #[test]
    fn kalibr_grids_are_numbered_from_the_bottom_left() {
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
    fn wrong_ros_files_are_explained() {
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
            ("separation: 0.005", "separation: 5", "apart"),
            ("separation: 0.005", "separation: -0.005", "apart"),
            (
                "first_id: 10",
                "first_id: 45",
                "does not fit into DICT_4X4_50",
            ),
            ("markers_x: 3", "markers_x: 0", "from 1 to 1024"),
            ("markers_x: 3", "markers_x: 4000000000", "from 1 to 1024"),
            ("  markers_y: 4\n", "", "markers_y"),
            ("name: corner", "name: GridBoard_1", "two boards are named"),
            (
                "frame_at_center: true",
                "frame_at_center: [",
                "cannot be read",
            ),
        ] {
            assert!(ROS.contains(from));
            let text = ROS.replacen(from, to, 1);
            let said = import_ros(&text, &dictionary()).unwrap_err().to_string();
            assert!(said.contains(expected), "{from} → {to}: {said}");
        }
        let said = import_ros("[]", &dictionary()).unwrap_err().to_string();
        assert!(said.contains("empty"), "{said}");
        assert!(import_ros("name: x", &dictionary()).is_err());
    }

    #[test]
    fn wrong_kalibr_files_are_explained() {
        for (from, to, expected) in [
            ("'aprilgrid'", "'checkerboard'", "no numbered markers"),
            (
                "tagSize: 0.088 ",
                "tagSize: 88 ",
                "millimetres where metres",
            ),
            ("tagSpacing: 0.3", "tagSpacing: 26.4", "fraction of tagSize"),
            ("tagRows: 5\n", "", "no tagRows"),
            ("tagCols: 6", "tagCols: 200", "does not fit"),
        ] {
            let text = KALIBR.replacen(from, to, 1);
            let said = import_kalibr(&text, "g", None).unwrap_err().to_string();
            assert!(said.contains(expected), "{from} → {to}: {said}");
        }
    }

    #[test]
    fn files_that_are_cut_off_or_damaged_give_a_whole_board_or_an_explanation() {
        let explained = |error: Error| {
            assert_eq!(error.kind(), ErrorKind::Input, "{error}");
            0
        };
        // Boards that were read; each has been checked against its dictionary.
        let read = |text: &str| {
            let ros = import_ros(text, &dictionary()).map_or_else(explained, |all| all.len());
            let kalibr = import_kalibr(text, "g", None).map_or_else(explained, |_| 1);
            ros + kalibr
        };
        for (text, whole) in [(ROS, 2), (KALIBR, 1)] {
            assert_eq!(read(text), whole);
            for at in 0..text.len() {
                let cut = &text[..at];
                assert!(read(cut) <= whole, "{cut}");
                for put in ["[", ":", "-", "9", "&a", "*a", "\0"] {
                    let damaged = format!("{}{put}{}", cut, &text[at + 1..]);
                    assert!(read(&damaged) <= whole, "{damaged}");
                }
            }
            // Without its first key it is no such file.
            let (_, rest) = text.split_once(':').unwrap();
            assert_eq!(read(rest), 0);
        }
    }

    #[test]
    fn files_are_recognised_by_their_keys() {
        let kind = |text: &str| ForeignBoard::recognise(text).unwrap();
        assert_eq!(kind(ROS), ForeignBoard::Ros);
        assert_eq!(kind(KALIBR), ForeignBoard::Kalibr);
        let dictionary = "%YAML:1.0\nnmarkers: 3\nmarkersize: 4\n";
        assert_eq!(kind(dictionary), ForeignBoard::OpencvDictionary);
        let said = ForeignBoard::recognise("camera: 3")
            .unwrap_err()
            .to_string();
        assert!(said.contains("target_type"), "{said}");
    }
}
