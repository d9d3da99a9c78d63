//! Chessboards, without markers or as ChArUco boards with markers in the white squares.
//!
//! Markers: S. Garrido-Jurado et al., *Automatic generation and detection of highly reliable
//! fiducial markers under occlusion*, Pattern Recognition 47 (2014). Inner corners are saddle
//! points of the image, which blur does not shift.

use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};

use super::board::{Board, BoardMarker, Body};
use super::board_check::check_side;
use super::dictionary::Dictionary;
use gripcast_base::error::{Error, Result};

/// Range of the number of squares along a side.
const SQUARES_RANGE: [u32; 2] = [3, 60];
/// Maximum distance of a marker from the centre of its square, relative to the square.
const MAX_OFFSET: f64 = 0.03;
/// Maximum marker side, relative to its square: detectors need a white margin.
const MAX_MARKER_RATIO: f64 = 0.9;

/// Chessboard centred on the origin of the board's object frame: x along the rows to the right, y
/// up, z out of the sheet.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Chessboard {
    /// Columns and rows of squares.
    pub squares: [u32; 2],
    /// Width and height of a printed square, mm.
    pub square_mm: [f64; 2],
    /// Layout of OpenCV before 4.6 for even numbers of rows: the top left square is white. No
    /// effect for odd numbers of rows.
    #[serde(default)]
    pub legacy: bool,
    /// Hash printed on the sheet: that of the board as drawn.
    #[serde(default)]
    pub printed_hash: Option<String>,
}

impl Chessboard {
    /// Whether a square is black; columns from the left, rows from the top.
    pub fn is_black(&self, column: u32, row: u32) -> bool {
        let is_shifted = self.legacy && self.squares[1].is_multiple_of(2);
        (column + row + u32::from(is_shifted)).is_multiple_of(2)
    }

    /// Number of inner corners.
    pub fn corner_count(&self) -> usize {
        let [columns, rows] = self.squares;
        ((columns - 1) * (rows - 1)) as usize
    }

    /// Inner corners, m, row by row from the top left.
    pub fn corners_m(&self) -> Vec<DVec2> {
        let [columns, rows] = self.squares;
        (1..rows)
            .flat_map(|row| (1..columns).map(move |column| (column, row)))
            .map(|(column, row)| self.point_m(f64::from(column), f64::from(row)))
            .collect()
    }

    /// Converts a position in columns from the left and rows from the top to m.
    pub fn point_m(&self, column: f64, row: f64) -> DVec2 {
        let [width, height] = self.square_mm;
        let [columns, rows] = self.squares.map(f64::from);
        1e-3 * DVec2::new(
            (column - 0.5 * columns) * width,
            (0.5 * rows - row) * height,
        )
    }

    /// Inverse of [`Self::point_m`].
    fn square_of(&self, point_m: DVec2) -> DVec2 {
        let [width, height] = self.square_mm;
        let [columns, rows] = self.squares.map(f64::from);
        DVec2::new(
            1e3 * point_m.x / width + 0.5 * columns,
            0.5 * rows - 1e3 * point_m.y / height,
        )
    }

    /// Squares of a colour as [column, row], row by row from the top left.
    fn squares_of(&self, is_black: bool) -> impl Iterator<Item = [u32; 2]> {
        let [columns, rows] = self.squares;
        (0..rows)
            .flat_map(move |row| (0..columns).map(move |column| [column, row]))
            .filter(move |[column, row]| self.is_black(*column, *row) == is_black)
    }

    /// Corners of the black squares, m, clockwise from the top left.
    pub fn black_squares_m(&self) -> Vec<[DVec2; 4]> {
        let corners = |square: [u32; 2]| {
            let [x, y] = square.map(f64::from);
            [(x, y), (x + 1.0, y), (x + 1.0, y + 1.0), (x, y + 1.0)]
                .map(|(x, y)| self.point_m(x, y))
        };
        self.squares_of(true).map(corners).collect()
    }

    /// Board with a marker at the centre of every white square, ids from `first_id`, in OpenCV's
    /// order.
    ///
    /// # Errors
    /// `Input` for implausible sizes or ids that are not in the dictionary.
    pub fn board(
        &self,
        name: &str,
        dictionary: &Dictionary,
        first_id: u32,
        marker_mm: [f64; 2],
    ) -> Result<Board> {
        self.check_size()?;
        for (marker, square) in marker_mm.iter().zip(self.square_mm) {
            check_side(1e-3 * marker)?;
            if *marker > MAX_MARKER_RATIO * square {
                return Err(Error::input(format!(
                    "markers of {marker:.2} mm leave no white margin in squares of {square:.2} mm"
                ))
                .remedy(format!("make them {:.1} mm or smaller", 0.75 * square)));
            }
        }
        let count = self.squares_of(false).count();
        dictionary.check_ids(first_id, count).map_err(|e| {
            e.remedy("choose a smaller first id, fewer squares or a larger dictionary")
        })?;
        let half = 0.5e-3 * DVec2::from_array(marker_mm);
        let marker = |(id, [column, row]): (u32, [u32; 2])| {
            let center = self.point_m(f64::from(column) + 0.5, f64::from(row) + 0.5);
            let corners = [(-1.0, 1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)];
            BoardMarker {
                id,
                body: Body::Object,
                corners_m: corners.map(|(x, y)| (center + half * DVec2::new(x, y)).extend(0.0)),
            }
        };
        let markers = (first_id..).zip(self.squares_of(false)).map(marker);
        Ok(Board {
            name: name.to_owned(),
            dictionary: dictionary.name().to_owned(),
            markers: markers.collect(),
        })
    }

    /// Checks that the markers of a board are at the centres of the white squares.
    ///
    /// # Errors
    /// `Input` naming the marker.
    pub fn check(&self, board: &Board) -> Result<()> {
        self.check_size()?;
        let mut markers = board.markers.iter();
        markers.try_for_each(|marker| self.check_marker(marker))
    }

    /// Checks the numbers of squares and their size.
    pub(crate) fn check_size(&self) -> Result<()> {
        let [min, max] = SQUARES_RANGE;
        if !self.squares.iter().all(|n| (min..=max).contains(n)) {
            return Err(Error::input(format!(
                "a chessboard must have {min} to {max} squares along each side, found {}×{}",
                self.squares[0], self.squares[1]
            )));
        }
        let [width, height] = self.square_mm;
        check_side(1e-3 * width)?;
        check_side(1e-3 * height)?;
        if (width / height - 1.0).abs() > 0.1 {
            let what = format!("squares must be square, found {width:.2} × {height:.2} mm");
            return Err(Error::input(what));
        }
        Ok(())
    }

    fn check_marker(&self, marker: &BoardMarker) -> Result<()> {
        let bad =
            |what: &str| Error::input(format!("marker {} of the chessboard {what}", marker.id));
        let centre = marker.center_m();
        if marker.body != Body::Object || centre.z.abs() > 1e-6 {
            return Err(bad("is not in the plane z = 0 of part \"object\""));
        }
        let at = self.square_of(centre.truncate());
        let square = at.floor();
        let [columns, rows] = self.squares.map(f64::from);
        let is_inside = square.cmpge(DVec2::ZERO).all() && square.x < columns && square.y < rows;
        if !is_inside || (at - square - 0.5).abs().max_element() > MAX_OFFSET {
            return Err(bad("is not at the centre of a square")
                .remedy("marker corners are relative to the centre of the chessboard"));
        }
        if self.is_black(square.x as u32, square.y as u32) {
            return Err(bad("is in a black square").remedy(
                "set legacy = true for boards with an even number of rows board_of by OpenCV before 4.6",
            ));
        }
        let right: DVec3 = marker.corners_m[1] - marker.corners_m[0];
        let [width, _] = self.square_mm;
        if right.length() > 1e-3 * MAX_MARKER_RATIO * width {
            return Err(bad("is too large for its square"));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chessboard(squares: [u32; 2], legacy: bool) -> Chessboard {
        Chessboard {
            squares,
            square_mm: [40.0, 40.0],
            legacy,
            printed_hash: None,
        }
    }

    fn board_of(chessboard: &Chessboard) -> Board {
        let dictionary = Dictionary::by_name("DICT_6X6_250").unwrap();
        chessboard.board("c", &dictionary, 0, [20.0; 2]).unwrap()
    }

    #[test]
    fn markers_match_opencv_layouts() {
        // Upper left corners, mm from the board's upper left corner, of OpenCV 5's
        // CharucoBoard((5, 7), 40, 20) and of both layouts of (4, 4).
        for (squares, legacy, id, expected) in [
            ([5, 7], false, 0, [50.0, 10.0]),
            ([5, 7], true, 0, [50.0, 10.0]),
            ([5, 7], false, 2, [10.0, 50.0]),
            ([4, 4], false, 0, [50.0, 10.0]),
            ([4, 4], true, 0, [10.0, 10.0]),
            ([4, 4], true, 2, [50.0, 50.0]),
        ] {
            let chessboard = chessboard(squares, legacy);
            let board = board_of(&chessboard);
            let corner = board.markers[id].corners_m[0].truncate();
            let off = 1e3 * (corner - chessboard.point_m(0.0, 0.0));
            let expected = DVec2::new(expected[0], -expected[1]);
            assert!(off.distance(expected) < 1e-9, "{squares:?} {legacy} {off}");
            chessboard.check(&board).unwrap();
        }
        let board = chessboard([5, 7], false);
        assert_eq!(
            (board_of(&board).markers.len(), board.corner_count()),
            (17, 24)
        );
        assert_eq!(board.corners_m().len(), 24);
        assert_eq!(board.black_squares_m().len(), 18);
        let first = board.corners_m()[0];
        assert!(first.distance(DVec2::new(-0.06, 0.1)) < 1e-12);
    }

    #[test]
    fn check_refuses_misplaced_markers() {
        let modern = chessboard([4, 4], false);
        let old = board_of(&chessboard([4, 4], true));
        let message = modern.check(&old).unwrap_err().to_string();
        assert!(message.contains("legacy = true"), "{message}");
        let mut moved = board_of(&modern);
        for corner in &mut moved.markers[3].corners_m {
            corner.x += 0.004;
        }
        let message = modern.check(&moved).unwrap_err().to_string();
        assert!(message.contains("marker 3 of the chessboard is not at the centre"));
        let dictionary = Dictionary::by_name("DICT_4X4_50").unwrap();
        for (squares, marker, expected) in [
            ([2, 5], 20.0, "3 to 60 squares"),
            ([40, 40], 20.0, "ends with id 49"),
            ([4, 4], 39.0, "leave no white margin"),
            ([4, 4], 0.02, "marker's side"),
        ] {
            let chessboard = chessboard(squares, false);
            let board_of = chessboard.board("c", &dictionary, 0, [marker; 2]);
            let message = board_of.unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
    }
}
