//! Import of boards from ROS and Kalibr.
//!
//! | program | file | frame |
//! | --- | --- | --- |
//! | ROS `aruco_opencv` | `board_descriptions.yaml`: a list of grids | x right, y up, z out of the sheet; origin at the centre or the bottom left corner |
//! | Kalibr | `target.yaml` with `target_type: aprilgrid` | the same, origin at the bottom left corner of tag 0 |
//! | Kalibr | `target.yaml` with `target_type: checkerboard` | x right, y up, z out of the sheet; origin at the centre |
//! | aruco (Muñoz-Salinas) | marker map in metres: `aruco_bc_markers` | that of the file |
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
    /// `target.yaml` of Kalibr, an aprilgrid or a checkerboard.
    Kalibr,
    /// Marker map of the aruco library.
    ArucoMap,
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
        } else if has("aruco_bc_markers") {
            Ok(Self::ArucoMap)
        } else if has("markers_x") || has("marker_size") {
            Ok(Self::Ros)
        } else if has("nmarkers") || has("markersize") {
            Ok(Self::OpencvDictionary)
        } else {
            Err(Error::input("unknown board format").remedy(
                "supported: board_descriptions.yaml of ROS aruco_opencv (markers_x …), target.yaml \
                 of Kalibr (target_type …), marker map of aruco (aruco_bc_markers …), OpenCV \
                 dictionary (nmarkers …)",
            ))
        }
    }
}

/// Boards of a file, and those that are not supported.
#[derive(Clone, Debug)]
pub struct ImportedBoards {
    /// The boards.
    pub boards: Vec<BoardFile>,
    /// Names of other entries, with the reason.
    pub unsupported: Vec<(String, String)>,
}

/// Imports all grids of a `board_descriptions.yaml`. The dictionary is a parameter of the ROS node
/// and not in the file.
///
/// # Errors
/// `Input` for a malformed file or an invalid board, which is named.
pub fn import_ros(text: &str, dictionary: &Dictionary) -> Result<ImportedBoards> {
    let entries: Vec<RosBoard> = yaml::read(text, "the list of boards")?;
    if entries.is_empty() {
        return Err(Error::input("the list of boards is empty"));
    }
    let mut names: Vec<&str> = entries.iter().map(|g| &*g.name).collect();
    names.sort_unstable();
    if let Some(pair) = names.windows(2).find(|pair| pair[0] == pair[1]) {
        let what = format!("two boards are named {:?}", pair[0]);
        return Err(Error::input(what).remedy("rename one of them"));
    }
    let mut imported = ImportedBoards {
        boards: Vec::new(),
        unsupported: Vec::new(),
    };
    for entry in &entries {
        let kind = entry.kind.as_deref().unwrap_or("grid");
        if kind == "grid" {
            let board = entry.grid().and_then(|g| g.board(&entry.name, dictionary));
            let board = board.map_err(|e| e.at(format!("board {:?}", entry.name)))?;
            imported.boards.push(board);
        } else {
            let reason = format!("type {kind:?} is not a grid");
            imported.unsupported.push((entry.name.clone(), reason));
        }
    }
    Ok(imported)
}

/// Imports a target of Kalibr. Its tags have a border of two cells and are of `tagFamily`, 36h11
/// where it is missing; `dictionary` overrides both. Ids begin with `startId` or `codeOffset`.
///
/// # Errors
/// `Input` for another target type, an unknown family or implausible sizes.
pub fn import_kalibr(text: &str, name: &str, dictionary: Option<&Dictionary>) -> Result<BoardFile> {
    let target: KalibrTarget = yaml::read(text, "the target")?;
    match &*target.target_type {
        "aprilgrid" => target.aprilgrid(name, dictionary),
        "checkerboard" => target.checkerboard(name),
        other => Err(Error::input(format!("unsupported target type {other:?}"))
            .remedy("give a target with target_type: aprilgrid or checkerboard")),
    }
}

/// Imports a marker map of the aruco library (S. Garrido-Jurado, R. Muñoz-Salinas), whose corners
/// are in metres. `dictionary` overrides that of the file.
///
/// # Errors
/// `Input` for a malformed file, corners in pixels, or a dictionary with another name here.
pub fn import_aruco_map(
    text: &str,
    name: &str,
    dictionary: Option<&Dictionary>,
) -> Result<BoardFile> {
    // OpenCV writes `id:0` in flow mappings, which YAML takes for a text.
    let spaced = ["id:", "corners:"]
        .iter()
        .fold(text.to_owned(), |text, key| {
            text.replace(key, &format!("{key} "))
        });
    let map: ArucoMap = yaml::read(&spaced, "the marker map")?;
    if let Some(count) = map.count
        && count != map.markers.len()
    {
        let found = map.markers.len();
        let what = format!("aruco_bc_nmarkers is {count}, found {found} markers");
        return Err(Error::input(what).remedy("the file is incomplete: export it again"));
    }
    if map.unit != Some(1) {
        return Err(Error::input(
            "the corners of the marker map are in pixels: aruco_bc_mInfoType is not 1",
        )
        .remedy("convert it to metres with aruco's tool for marker maps"));
    }
    let dictionary = match (dictionary, map.dictionary.as_deref()) {
        (Some(dictionary), _) => dictionary.clone(),
        (None, Some("ARUCO_MIP_36h12")) => Dictionary::by_name("DICT_ARUCO_MIP_36h12")?,
        (None, Some("ARUCO")) => Dictionary::by_name("DICT_ARUCO_ORIGINAL")?,
        (None, other) => {
            let what = format!(
                "unknown dictionary {:?} of the aruco library",
                other.unwrap_or("")
            );
            return Err(Error::input(what).remedy("give --dictionary"));
        }
    };
    let marker = |marker: &ArucoMarker| BoardMarker {
        id: marker.id,
        body: Body::Object,
        corners_m: marker.corners.map(DVec3::from_array),
    };
    let board = Board {
        name: name.to_owned(),
        dictionary: dictionary.name().to_owned(),
        markers: map.markers.iter().map(marker).collect(),
    };
    BoardFile::new(board, dictionary, None)
}

#[derive(Deserialize)]
struct RosBoard {
    name: String,
    #[serde(rename = "type")]
    kind: Option<String>,
    frame_at_center: Option<bool>,
    #[serde(default)]
    first_id: u32,
    markers_x: Option<u32>,
    markers_y: Option<u32>,
    marker_size: Option<f64>,
    separation: Option<f64>,
}

impl RosBoard {
    fn grid(&self) -> Result<Grid> {
        Ok(Grid {
            columns: required(self.markers_x, "the board", "markers_x")?,
            rows: required(self.markers_y, "the board", "markers_y")?,
            side_m: required(self.marker_size, "the board", "marker_size")?,
            gap_m: required(self.separation, "the board", "separation")?,
            first_id: self.first_id,
            is_bottom_up: false,
            is_origin_centered: required(self.frame_at_center, "the board", "frame_at_center")?,
        })
    }
}

#[derive(Deserialize)]
struct ArucoMap {
    #[serde(rename = "aruco_bc_dict")]
    dictionary: Option<String>,
    #[serde(rename = "aruco_bc_nmarkers")]
    count: Option<usize>,
    #[serde(rename = "aruco_bc_mInfoType")]
    unit: Option<i64>,
    #[serde(rename = "aruco_bc_markers")]
    markers: Vec<ArucoMarker>,
}

#[derive(Deserialize)]
struct ArucoMarker {
    id: u32,
    corners: [[f64; 3]; 4],
}

#[derive(Deserialize)]
struct KalibrTarget {
    target_type: String,
    #[serde(rename = "tagCols")]
    tag_columns: Option<u32>,
    #[serde(rename = "tagRows")]
    tag_rows: Option<u32>,
    #[serde(rename = "tagSize")]
    side: Option<f64>,
    #[serde(rename = "tagSpacing")]
    spacing: Option<f64>,
    #[serde(rename = "tagFamily")]
    family: Option<String>,
    #[serde(rename = "startId", alias = "codeOffset")]
    first_id: Option<u32>,
    #[serde(rename = "targetCols")]
    corner_columns: Option<u32>,
    #[serde(rename = "targetRows")]
    corner_rows: Option<u32>,
    #[serde(rename = "colSpacingMeters")]
    column_spacing_m: Option<f64>,
    #[serde(rename = "rowSpacingMeters")]
    row_spacing_m: Option<f64>,
}

impl KalibrTarget {
    fn aprilgrid(&self, name: &str, dictionary: Option<&Dictionary>) -> Result<BoardFile> {
        let side = required(self.side, "the target", "tagSize")?;
        let spacing = required(self.spacing, "the target", "tagSpacing")?;
        if !(0.0..=2.0).contains(&spacing) {
            let what = format!("tagSpacing must be a fraction of tagSize, found {spacing}");
            return Err(Error::input(what).remedy("divide the gap between two tags by tagSize"));
        }
        // Tags have cells of a tenth of their side; a smaller gap leaves no white between them.
        if spacing < 0.1 {
            let (gap_mm, ratio) = (1e3 * spacing * side, spacing / side);
            return Err(Error::input(format!(
                "tagSpacing {spacing} is a gap of {gap_mm:.2} mm between tags of {:.1} mm: too small",
                1e3 * side
            ))
            .remedy(format!(
                "tagSpacing is the gap divided by tagSize; if {spacing} is metres, write {ratio:.4}"
            )));
        }
        let grid = Grid {
            columns: required(self.tag_columns, "the target", "tagCols")?,
            rows: required(self.tag_rows, "the target", "tagRows")?,
            side_m: side,
            gap_m: spacing * side,
            first_id: self.first_id.unwrap_or(0),
            is_bottom_up: true,
            is_origin_centered: false,
        };
        let dictionary = match dictionary {
            Some(dictionary) => dictionary.clone(),
            None => self.own_dictionary()?,
        };
        grid.board(name, &dictionary)
    }

    /// The dictionary of `tagFamily`, with Kalibr's border.
    fn own_dictionary(&self) -> Result<Dictionary> {
        let family = self.family.as_deref().unwrap_or("t36h11");
        let plain = family.to_ascii_lowercase();
        let plain = plain.trim_start_matches("tag").trim_start_matches('t');
        Dictionary::by_name(&format!("{plain}_border2")).map_err(|_| {
            Error::input(format!("unknown tagFamily {family:?}"))
                .remedy("supported: t16h5, t25h9, t36h10, t36h11; name another with --dictionary")
        })
    }

    /// A chessboard without markers; rows and columns are those of its inner corners.
    fn checkerboard(&self, name: &str) -> Result<BoardFile> {
        let columns = required(self.corner_columns, "the target", "targetCols")?;
        let rows = required(self.corner_rows, "the target", "targetRows")?;
        let width_m = required(self.column_spacing_m, "the target", "colSpacingMeters")?;
        let height_m = required(self.row_spacing_m, "the target", "rowSpacingMeters")?;
        BoardFile::plain_chessboard(name, [columns, rows], [1e3 * width_m, 1e3 * height_m])
    }
}

/// The entry of a file, or the error that names it.
fn required<T>(entry: Option<T>, what: &str, key: &str) -> Result<T> {
    entry.ok_or_else(|| Error::input(format!("{what} has no {key}")))
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
#[path = "board_import_test.rs"]
mod tests;
