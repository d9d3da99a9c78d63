//! Validation of boards: duplicate ids, corners that do not form a square, mirrored markers, wrong
//! units.

use glam::DVec3;

use super::board::{Board, BoardMarker, Body};
use super::dictionary::Dictionary;
use gripcast_base::error::{Error, Result};

/// Range of marker sides that can be printed and detected, m.
const SIDE_RANGE_M: [f64; 2] = [0.005, 0.4];
/// Maximum distance of a corner from the frame's origin, m.
const MAX_DISTANCE_M: f64 = 5.0;
/// Maximum deviation from a square, relative to the side; anisotropic printer scale stays far
/// below.
const SQUARE_TOLERANCE: f64 = 0.03;

impl Board {
    /// Validates the board against its dictionary. `up` is the direction, in the object frame, that
    /// the markers of a flat object board face, if known.
    ///
    /// # Errors
    /// `Input`, naming the marker: duplicate or unknown id, corners that are not finite or do not
    /// form a flat square, implausible size or position, mirrored or overlapping markers.
    pub fn check(&self, dictionary: &Dictionary, up: Option<DVec3>) -> Result<()> {
        if self.markers.is_empty() {
            return Err(Error::input("the board has no markers"));
        }
        let ids = self.ids();
        if let Some(pair) = ids.windows(2).find(|pair| pair[0] == pair[1]) {
            return Err(bad(pair[0], "is listed twice").remedy("give every marker a unique id"));
        }
        for marker in &self.markers {
            check_id(marker.id, dictionary)?;
            check_size(marker)?;
            check_square(marker)?;
        }
        for body in Body::ALL {
            self.check_facing(body, up.filter(|_| body == Body::Object))?;
        }
        self.check_overlap()
    }

    /// Refuses markers of a plane that face away from `up`, or from the majority if `up` is
    /// unknown.
    fn check_facing(&self, body: Body, up: Option<DVec3>) -> Result<()> {
        let markers: Vec<&BoardMarker> = self.markers_on(body).collect();
        let Some(first) = markers.first() else {
            return Ok(());
        };
        let (origin, normal) = (first.center_m(), first.normal());
        let off = |p: DVec3| (p - origin).dot(normal).abs();
        let corners = || markers.iter().flat_map(|m| m.corners_m);
        let reach = corners().map(|c| c.distance(origin)).fold(0.0, f64::max);
        if corners().any(|c| off(c) > 0.01 * reach) {
            return Ok(());
        }
        let is_opposite = |m: &&&BoardMarker| m.normal().dot(normal) < 0.0;
        let is_minority = 2 * markers.iter().filter(is_opposite).count() > markers.len();
        let majority = if is_minority { -normal } else { normal };
        // Without a given direction the object frame has z up.
        let is_level = body == Body::Object && majority.z.abs() > 0.999;
        let up = up.or(is_level.then_some(DVec3::Z)).unwrap_or(majority);
        match markers.iter().find(|m| m.normal().dot(up) < 0.0) {
            Some(marker) => Err(mirrored(marker.id)),
            None => Ok(()),
        }
    }

    fn check_overlap(&self) -> Result<()> {
        for (k, a) in self.markers.iter().enumerate() {
            for b in &self.markers[..k] {
                let offset = a.center_m() - b.center_m();
                let side = a.side_m().min(b.side_m());
                let is_same_plane =
                    a.normal().dot(b.normal()) > 0.9 && offset.dot(a.normal()).abs() < 0.2 * side;
                if a.body == b.body && is_same_plane && offset.length() < 0.9 * side {
                    let what = format!(
                        "overlaps marker {}: centres {:.2} mm apart, side {:.2} mm",
                        b.id,
                        1e3 * offset.length(),
                        1e3 * side
                    );
                    return Err(bad(a.id, &what)
                        .remedy("check that positions and sizes are in the same unit"));
                }
            }
        }
        Ok(())
    }
}

fn bad(id: u32, what: &str) -> Error {
    Error::input(format!("marker {id} {what}"))
}

fn mirrored(id: u32) -> Error {
    bad(
        id,
        "is mirrored: its corners run counter-clockwise seen from the front",
    )
    .remedy(
        "list them top left, top right, bottom right, bottom left as the marker is read upright; \
         in a frame with z out of the sheet and y up, the first corner has the larger y",
    )
}

fn check_id(id: u32, dictionary: &Dictionary) -> Result<()> {
    if (id as usize) < dictionary.len() {
        return Ok(());
    }
    let what = format!(
        "is not in dictionary {}, which has ids 0 to {}",
        dictionary.name(),
        dictionary.len() - 1
    );
    Err(bad(id, &what).remedy("check the id and the dictionary's name"))
}

/// Refuses implausible marker sides.
///
/// # Errors
/// `Input`; the remedy suggests the unit that would fit.
pub(super) fn check_side(side_m: f64) -> Result<()> {
    if (SIDE_RANGE_M[0]..=SIDE_RANGE_M[1]).contains(&side_m) {
        return Ok(());
    }
    let units = [
        (1e-3, "millimetres where metres are expected"),
        (1e-2, "centimetres where metres are expected"),
        (10.0, "centimetres where millimetres are expected"),
        (1e3, "metres where millimetres are expected"),
    ];
    let fits = |(factor, _): &&(f64, &str)| (0.01..=0.2).contains(&(side_m * factor));
    let remedy = match units.iter().find(fits) {
        Some((factor, unit)) => {
            let side_mm = 1e3 * side_m * factor;
            format!("{side_mm:.4} mm is plausible: are the numbers {unit}?")
        }
        None => "check the unit".to_owned(),
    };
    Err(Error::input(format!(
        "a marker's side must be from {} to {} mm, found {} mm",
        1e3 * SIDE_RANGE_M[0],
        1e3 * SIDE_RANGE_M[1],
        (1e6 * side_m).round() / 1e3
    ))
    .remedy(remedy))
}

fn check_size(marker: &BoardMarker) -> Result<()> {
    if !marker.corners_m.iter().all(|c| c.is_finite()) {
        return Err(bad(marker.id, "must have finite corners"));
    }
    check_side(marker.side_m()).map_err(|e| e.at(format!("marker {}", marker.id)))?;
    let reach = marker.corners_m.iter().map(|c| c.length());
    let reach = reach.fold(0.0, f64::max);
    if reach > MAX_DISTANCE_M {
        let what = format!(
            "is {reach:.2} m from the origin of its frame, the maximum is {MAX_DISTANCE_M} m"
        );
        return Err(bad(marker.id, &what).remedy("check the unit of the corners"));
    }
    Ok(())
}

/// Requires equal sides and diagonals, and coplanar corners.
fn check_square(marker: &BoardMarker) -> Result<()> {
    let side = marker.side_m();
    let [a, b, c, d] = marker.corners_m;
    let sides = [a.distance(b), b.distance(c), c.distance(d), d.distance(a)];
    let diagonals = [a.distance(c), b.distance(d)];
    let is_uneven = |s: &f64| (s / side - 1.0).abs() > SQUARE_TOLERANCE;
    let skew = (diagonals[0] - diagonals[1]).abs() / side;
    if sides.iter().any(is_uneven) || skew > SQUARE_TOLERANCE {
        let what = format!(
            "is not a square: sides {:.3?} mm, diagonals {:.3?} mm",
            sides.map(|s| 1e3 * s),
            diagonals.map(|d| 1e3 * d)
        );
        return Err(bad(marker.id, &what)
            .remedy("list its corners in order: top left, top right, bottom right, bottom left"));
    }
    let bend = (a + c - b - d).length() / side;
    if bend > SQUARE_TOLERANCE {
        let off_mm = 1e3 * bend * side;
        let what = format!("is not flat: a corner is {off_mm:.3} mm off the plane of the others");
        return Err(bad(marker.id, &what));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn board() -> Board {
        let marker = |id: u32| BoardMarker {
            id,
            body: Body::Object,
            corners_m: BoardMarker::square_corners(
                DVec3::new(0.05 * f64::from(id), 0.0, 0.0),
                DVec3::X,
                DVec3::Y,
                0.03,
            ),
        };
        Board {
            name: "b".into(),
            dictionary: "DICT_4X4_50".into(),
            markers: (0..4).map(marker).collect(),
        }
    }

    fn rejection(change: impl FnOnce(&mut Board)) -> String {
        let mut board = board();
        change(&mut board);
        let dictionary = Dictionary::by_name("DICT_4X4_50").unwrap();
        board.check(&dictionary, None).unwrap_err().to_string()
    }

    fn scale(board: &mut Board, factor: f64) {
        for corner in board.markers.iter_mut().flat_map(|m| &mut m.corners_m) {
            *corner *= factor;
        }
    }

    #[test]
    fn check_accepts_board_of_anisotropic_printer() {
        let dictionary = Dictionary::by_name("DICT_4X4_50").unwrap();
        board().check(&dictionary, None).unwrap();
        let mut stretched = board();
        for corner in stretched.markers.iter_mut().flat_map(|m| &mut m.corners_m) {
            corner.x *= 1.01;
        }
        stretched.check(&dictionary, None).unwrap();
    }

    #[test]
    fn check_names_marker_and_mistake() {
        let expect = |rejection: String, words: &[&str]| {
            for word in words {
                assert!(rejection.contains(word), "{rejection}");
            }
        };
        expect(rejection(|b| b.markers.clear()), &["no markers"]);
        expect(
            rejection(|b| b.markers[2].id = 1),
            &["marker 1 is listed twice"],
        );
        expect(
            rejection(|b| b.markers[2].id = 50),
            &["marker 50", "ids 0 to 49"],
        );
        expect(
            rejection(|b| b.markers[2].corners_m[1].z = f64::NAN),
            &["marker 2", "finite"],
        );
        expect(
            rejection(|b| b.markers[1].corners_m.swap(1, 2)),
            &["marker 1 is not a square", "diagonals"],
        );
        expect(
            rejection(|b| b.markers[1].corners_m[2].z += 0.005),
            &["marker 1 is not"],
        );
        // Metres read as millimetres, centimetres as metres.
        expect(
            rejection(|b| scale(b, 1e-3)),
            &["0.03 mm", "metres where millimetres"],
        );
        expect(
            rejection(|b| scale(b, 0.1)),
            &["3 mm", "centimetres where millimetres"],
        );
        expect(
            rejection(|b| scale(b, 100.0)),
            &["centimetres where metres"],
        );
        expect(
            rejection(|b| {
                b.markers[3].corners_m = b.markers[3].corners_m.map(|c| c + DVec3::X * 7.0)
            }),
            &["marker 3", "unit"],
        );
        expect(
            rejection(|b| {
                b.markers[1].corners_m = b.markers[0].corners_m.map(|c| c + DVec3::X * 5e-3)
            }),
            &["overlaps marker 0"],
        );
    }

    #[test]
    fn check_refuses_mirrored_markers() {
        let mirror = |m: &mut BoardMarker| m.corners_m.swap(0, 1);
        let both = |m: &mut BoardMarker| {
            mirror(m);
            m.corners_m.swap(2, 3);
        };
        let one = rejection(|b| both(&mut b.markers[2]));
        assert!(one.contains("marker 2 is mirrored"), "{one}");
        let all = rejection(|b| b.markers.iter_mut().for_each(both));
        assert!(
            all.contains("mirrored") && all.contains("top left"),
            "{all}"
        );
        // The sheet's normal of an object on its side is along another axis of the object frame.
        let dictionary = Dictionary::by_name("DICT_4X4_50").unwrap();
        let mut rotated = board();
        for corner in rotated.markers.iter_mut().flat_map(|m| &mut m.corners_m) {
            *corner = DVec3::new(corner.x, 0.0, corner.y);
        }
        rotated.check(&dictionary, Some(DVec3::NEG_Y)).unwrap();
        let error = rotated.check(&dictionary, Some(DVec3::Y)).unwrap_err();
        assert!(error.to_string().contains("mirrored"), "{error}");
    }
}
