//! Chessboards whose white squares carry markers (ChArUco boards).
//!
//! S. Garrido-Jurado et al., *Automatic generation and detection of highly reliable fiducial
//! markers under occlusion*, Pattern Recognition 47 (2014), describe the markers; the squares'
//! inner corners are saddle points of the image, which blur leaves where they are.

use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};

use super::board::{Board, BoardMarker, Part};
use super::board_check::check_side;
use super::dictionary::Dictionary;
use gripcast_base::error::{Error, Result};

/// Fewest and most squares along a side.
const SQUARES: [u32; 2] = [3, 60];
/// How far a marker may be from the middle of its square, relative to the square.
const OFF_CENTRE: f64 = 0.03;
/// Largest marker, relative to its square: detectors need white around it.
const MAX_MARKER: f64 = 0.9;

/// Black and white squares around the middle of a board's object frame: x along the rows to the
/// right, y up, z out of the sheet.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Chessboard {
    /// Columns and rows of squares.
    pub squares: [u32; 2],
    /// Width and height of a square on the paper, mm.
    pub square_mm: [f64; 2],
    /// The layout of OpenCV before 4.6 for even numbers of rows: the square at the top left is
    /// white. Without effect for odd numbers of rows.
    #[serde(default)]
    pub legacy: bool,
    /// Hash that is printed on the sheet: that of the board as it was drawn.
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

    /// Inner corners on the sheet, m, row by row from the top left one.
    pub fn corners_m(&self) -> Vec<DVec2> {
        let [columns, rows] = self.squares;
        (1..rows)
            .flat_map(|row| (1..columns).map(move |column| (column, row)))
            .map(|(column, row)| self.place_m(f64::from(column), f64::from(row)))
            .collect()
    }

    /// Place on the sheet, m, in columns from the left and rows from the top.
    pub fn place_m(&self, column: f64, row: f64) -> DVec2 {
        let [width, height] = self.square_mm;
        let [columns, rows] = self.squares.map(f64::from);
        1e-3 * DVec2::new(
            (column - 0.5 * columns) * width,
            (0.5 * rows - row) * height,
        )
    }

    /// Columns from the left and rows from the top of a place on the sheet.
    fn square_of(&self, place_m: DVec2) -> DVec2 {
        let [width, height] = self.square_mm;
        let [columns, rows] = self.squares.map(f64::from);
        DVec2::new(
            1e3 * place_m.x / width + 0.5 * columns,
            0.5 * rows - 1e3 * place_m.y / height,
        )
    }

    /// White squares row by row from the top left: the order of the markers' ids.
    pub fn white_squares(&self) -> impl Iterator<Item = [u32; 2]> {
        let [columns, rows] = self.squares;
        (0..rows)
            .flat_map(move |row| (0..columns).map(move |column| [column, row]))
            .filter(|[column, row]| !self.is_black(*column, *row))
    }

    /// The black squares: their corners on the sheet, m, clockwise from the top left one.
    pub fn black_squares_m(&self) -> Vec<[DVec2; 4]> {
        let [columns, rows] = self.squares;
        (0..rows)
            .flat_map(|row| (0..columns).map(move |column| (column, row)))
            .filter(|(column, row)| self.is_black(*column, *row))
            .map(|(column, row)| {
                let (x, y) = (f64::from(column), f64::from(row));
                [(x, y), (x + 1.0, y), (x + 1.0, y + 1.0), (x, y + 1.0)]
                    .map(|(x, y)| self.place_m(x, y))
            })
            .collect()
    }

    /// The board with a marker in the middle of every white square, ids from `first_id` on, as
    /// OpenCV numbers them.
    ///
    /// # Errors
    /// `Input` for sizes that no board has, or ids that the dictionary does not have.
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
            if *marker > MAX_MARKER * square {
                return Err(Error::input(format!(
                    "markers of {marker:.2} mm leave no white in squares of {square:.2} mm"
                ))
                .remedy(format!("make them {:.1} mm or smaller", 0.75 * square)));
            }
        }
        let count = self.white_squares().count();
        dictionary.check_ids(first_id, count).map_err(|e| {
            e.remedy("choose a smaller first id, fewer squares or a larger dictionary")
        })?;
        let half = 0.5e-3 * DVec2::from_array(marker_mm);
        let marker = |(id, [column, row]): (u32, [u32; 2])| {
            let middle = self.place_m(f64::from(column) + 0.5, f64::from(row) + 0.5);
            let corner = |x: f64, y: f64| (middle + half * DVec2::new(x, y)).extend(0.0);
            BoardMarker {
                id,
                part: Part::Object,
                corners_m: [
                    corner(-1.0, 1.0),
                    corner(1.0, 1.0),
                    corner(1.0, -1.0),
                    corner(-1.0, -1.0),
                ],
            }
        };
        Ok(Board {
            name: name.to_owned(),
            dictionary: dictionary.name().to_owned(),
            markers: (first_id..).zip(self.white_squares()).map(marker).collect(),
        })
    }

    /// Checks that the markers of a board lie upright in the middle of the white squares.
    ///
    /// # Errors
    /// `Input` with what is wrong.
    pub fn check(&self, board: &Board) -> Result<()> {
        self.check_size()?;
        for marker in &board.markers {
            self.check_marker(marker)?;
        }
        Ok(())
    }

    fn check_size(&self) -> Result<()> {
        let [least, most] = SQUARES;
        if !self.squares.iter().all(|n| (least..=most).contains(n)) {
            return Err(Error::input(format!(
                "a chessboard must have {least} to {most} squares along each side, found \
                     {}×{}",
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
        if marker.part != Part::Object || centre.z.abs() > 1e-6 {
            return Err(bad("is not in the plane z = 0 of the part \"object\""));
        }
        let at = self.square_of(centre.truncate());
        let square = at.floor();
        let [columns, rows] = self.squares.map(f64::from);
        let is_inside = square.cmpge(DVec2::ZERO).all() && square.x < columns && square.y < rows;
        if !is_inside || (at - square - 0.5).abs().max_element() > OFF_CENTRE {
            return Err(bad("is not in the middle of a square")
                .remedy("the chessboard's middle is the origin of the markers' corners"));
        }
        if self.is_black(square.x as u32, square.y as u32) {
            return Err(bad("is in a black square").remedy(
                "boards with an even number of rows made by OpenCV before 4.6 have legacy = true",
            ));
        }
        let right: DVec3 = marker.corners_m[1] - marker.corners_m[0];
        let [width, _] = self.square_mm;
        if right.length() > 1e-3 * MAX_MARKER * width {
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

    fn made(chessboard: &Chessboard) -> Board {
        let dictionary = Dictionary::by_name("DICT_6X6_250").unwrap();
        chessboard.board("c", &dictionary, 0, [20.0; 2]).unwrap()
    }

    #[test]
    fn markers_are_where_opencv_puts_them() {
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
            let board = made(&chessboard);
            let corner = board.markers[id].corners_m[0].truncate();
            let off = 1e3 * (corner - chessboard.place_m(0.0, 0.0));
            let expected = DVec2::new(expected[0], -expected[1]);
            assert!(off.distance(expected) < 1e-9, "{squares:?} {legacy} {off}");
            chessboard.check(&board).unwrap();
        }
        let board = chessboard([5, 7], false);
        assert_eq!((made(&board).markers.len(), board.corner_count()), (17, 24));
        assert_eq!(board.corners_m().len(), 24);
        assert_eq!(board.black_squares_m().len(), 18);
        let first = board.corners_m()[0];
        assert!(first.distance(DVec2::new(-0.06, 0.1)) < 1e-12);
    }

    #[test]
    fn markers_elsewhere_are_refused() {
        let modern = chessboard([4, 4], false);
        let old = made(&chessboard([4, 4], true));
        let said = modern.check(&old).unwrap_err().to_string();
        assert!(said.contains("legacy = true"), "{said}");
        let mut moved = made(&modern);
        for corner in &mut moved.markers[3].corners_m {
            corner.x += 0.004;
        }
        let said = modern.check(&moved).unwrap_err().to_string();
        assert!(said.contains("marker 3 of the chessboard is not in the middle"));
        let dictionary = Dictionary::by_name("DICT_4X4_50").unwrap();
        for (squares, marker, expected) in [
            ([2, 5], 20.0, "3 to 60 squares"),
            ([40, 40], 20.0, "ends with id 49"),
            ([4, 4], 39.0, "leave no white"),
            ([4, 4], 0.02, "marker's side"),
        ] {
            let chessboard = chessboard(squares, false);
            let made = chessboard.board("c", &dictionary, 0, [marker; 2]);
            let said = made.unwrap_err().to_string();
            assert!(said.contains(expected), "{said}");
        }
    }
}
