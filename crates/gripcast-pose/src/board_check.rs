//! What no board can be: a marker twice, corners that are no square, a mirrored marker, sizes in
//! the wrong unit.

use glam::DVec3;

use super::board::{Board, BoardMarker, Part};
use super::dictionary::Dictionary;
use gripcast_base::error::{Error, Result};

/// Sides of markers that can be printed and read, m.
const SIDES_M: [f64; 2] = [0.005, 0.4];
/// Farthest corner from the frame's origin, m.
const REACH_M: f64 = 5.0;
/// Deviation from a square, relative to the side. Printers that scale x and y differently stay
/// far below.
const SQUARE: f64 = 0.03;

impl Board {
    /// Checks the board against its dictionary. `up` is the direction of the part's frame in which
    /// the markers of a flat object board face; none if that is not known.
    ///
    /// # Errors
    /// `Input`, naming the marker: an id twice or not in the dictionary, corners that are not
    /// finite, no flat square, of implausible size or place, mirrored, or two markers in one place.
    pub fn check(&self, dictionary: &Dictionary, up: Option<DVec3>) -> Result<()> {
        if self.markers.is_empty() {
            return Err(Error::input("the board has no markers"));
        }
        let ids = self.ids();
        if let Some(twice) = ids.windows(2).find(|pair| pair[0] == pair[1]) {
            return Err(
                bad(twice[0], "is there twice").remedy("give every marker an id of its own")
            );
        }
        for marker in &self.markers {
            check_id(marker.id, dictionary)?;
            check_size(marker)?;
            check_square(marker)?;
        }
        for part in Part::ALL {
            self.check_facing(part, up.filter(|_| part == Part::Object))?;
        }
        self.check_overlap()
    }

    /// Markers of a plane that face the other side than most of it or than `up`.
    fn check_facing(&self, part: Part, up: Option<DVec3>) -> Result<()> {
        let markers: Vec<&BoardMarker> = self.of_part(part).collect();
        let Some(first) = markers.first() else {
            return Ok(());
        };
        let (origin, normal) = (first.center_m(), first.front());
        let off = |p: DVec3| (p - origin).dot(normal).abs();
        let corners = || markers.iter().flat_map(|m| m.corners_m);
        let reach = corners().map(|c| c.distance(origin)).fold(0.0, f64::max);
        if corners().any(|c| off(c) > 0.01 * reach) {
            return Ok(());
        }
        let behind = |m: &&&BoardMarker| m.front().dot(normal) < 0.0;
        let against = markers.iter().filter(behind).count();
        let most = if 2 * against > markers.len() {
            -normal
        } else {
            normal
        };
        // Without more knowledge the object's frame has z upwards.
        let is_level = part == Part::Object && most.z.abs() > 0.999;
        let up = up.or(is_level.then_some(DVec3::Z)).unwrap_or(most);
        match markers.iter().find(|m| m.front().dot(up) < 0.0) {
            Some(marker) => Err(mirrored(marker.id)),
            None => Ok(()),
        }
    }

    fn check_overlap(&self) -> Result<()> {
        for (k, a) in self.markers.iter().enumerate() {
            for b in &self.markers[..k] {
                let apart = a.center_m() - b.center_m();
                let side = a.side_m().min(b.side_m());
                let is_same_plane =
                    a.front().dot(b.front()) > 0.9 && apart.dot(a.front()).abs() < 0.2 * side;
                if a.part == b.part && is_same_plane && apart.length() < 0.9 * side {
                    return Err(bad(
                        a.id,
                        &format!(
                            "lies on marker {}: their middles are {:.2} mm apart, their sides are \
                             {:.2} mm",
                            b.id,
                            1e3 * apart.length(),
                            1e3 * side
                        ),
                    )
                    .remedy("check that places and sizes are in the same unit"));
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
        "is mirrored: its corners run counter-clockwise for whoever looks at its front",
    )
    .remedy(
        "list them top left, top right, bottom right, bottom left as the marker is read upright; \
         in a frame with z out of the sheet and y up, the first has the larger y",
    )
}

fn check_id(id: u32, dictionary: &Dictionary) -> Result<()> {
    if (id as usize) < dictionary.len() {
        return Ok(());
    }
    let what = format!(
        "is not in the dictionary {}, which has ids 0 to {}",
        dictionary.name(),
        dictionary.len() - 1
    );
    Err(bad(id, &what).remedy("check the id and the dictionary's name"))
}

/// Refuses sides that no marker has.
///
/// # Errors
/// `Input`; the remedy names the unit that would fit.
pub(super) fn check_side(side_m: f64) -> Result<()> {
    if (SIDES_M[0]..=SIDES_M[1]).contains(&side_m) {
        return Ok(());
    }
    let units = [
        (1e-3, "millimetres where metres are expected"),
        (1e-2, "centimetres where metres are expected"),
        (10.0, "centimetres where millimetres are expected"),
        (1e3, "metres where millimetres are expected"),
    ];
    let fits = |(factor, _): &&(f64, &str)| (0.01..=0.2).contains(&(side_m * factor));
    let remedy = units.iter().find(fits).map_or_else(
        || "check the unit".to_owned(),
        |(factor, unit)| {
            format!(
                "{:.4} mm would fit: are the numbers {unit}?",
                1e3 * side_m * factor
            )
        },
    );
    Err(Error::input(format!(
        "a marker's side must be from {} to {} mm, found {} mm",
        1e3 * SIDES_M[0],
        1e3 * SIDES_M[1],
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
    if reach > REACH_M {
        return Err(bad(
            marker.id,
            &format!("is {reach:.2} m from the origin of its frame, more than {REACH_M} m"),
        )
        .remedy("check the unit of the corners"));
    }
    Ok(())
}

/// Sides and diagonals that are equal, and corners in one plane.
fn check_square(marker: &BoardMarker) -> Result<()> {
    let side = marker.side_m();
    let [a, b, c, d] = marker.corners_m;
    let longest = [a.distance(b), b.distance(c), c.distance(d), d.distance(a)]
        .map(|s| (s / side - 1.0).abs())
        .into_iter()
        .fold(0.0, f64::max);
    let skew = (a.distance(c) - b.distance(d)).abs() / side;
    if longest > SQUARE || skew > SQUARE {
        let mm = |p: DVec3, q: DVec3| 1e3 * p.distance(q);
        let what = format!(
            "is not a square: sides of {:.3}, {:.3}, {:.3}, {:.3} mm, diagonals of {:.3} and {:.3} \
             mm",
            mm(a, b),
            mm(b, c),
            mm(c, d),
            mm(d, a),
            mm(a, c),
            mm(b, d)
        );
        return Err(bad(marker.id, &what)
            .remedy("list its corners around: top left, top right, bottom right, bottom left"));
    }
    let bend = (a + c - b - d).length() / side;
    if bend > SQUARE {
        return Err(bad(
            marker.id,
            &format!(
                "is not flat: a corner is {:.3} mm off the plane of the others",
                1e3 * bend * side
            ),
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn board() -> Board {
        let marker = |id: u32| BoardMarker {
            id,
            part: Part::Object,
            corners_m: BoardMarker::square(
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

    fn said(spoil: impl FnOnce(&mut Board)) -> String {
        let mut board = board();
        spoil(&mut board);
        let dictionary = Dictionary::by_name("DICT_4X4_50").unwrap();
        board.check(&dictionary, None).unwrap_err().to_string()
    }

    fn scale(board: &mut Board, factor: f64) {
        for corner in board.markers.iter_mut().flat_map(|m| &mut m.corners_m) {
            *corner *= factor;
        }
    }

    #[test]
    fn a_good_board_passes_and_so_does_one_of_an_uneven_printer() {
        let dictionary = Dictionary::by_name("DICT_4X4_50").unwrap();
        board().check(&dictionary, None).unwrap();
        let mut stretched = board();
        for corner in stretched.markers.iter_mut().flat_map(|m| &mut m.corners_m) {
            corner.x *= 1.01;
        }
        stretched.check(&dictionary, None).unwrap();
    }

    #[test]
    fn every_mistake_is_named() {
        let expect = |said: String, words: &[&str]| {
            for word in words {
                assert!(said.contains(word), "{said}");
            }
        };
        expect(said(|b| b.markers.clear()), &["no markers"]);
        expect(said(|b| b.markers[2].id = 1), &["marker 1 is there twice"]);
        expect(
            said(|b| b.markers[2].id = 50),
            &["marker 50", "ids 0 to 49"],
        );
        expect(
            said(|b| b.markers[2].corners_m[1].z = f64::NAN),
            &["marker 2", "finite"],
        );
        expect(
            said(|b| b.markers[1].corners_m.swap(1, 2)),
            &["marker 1 is not a square", "diagonals"],
        );
        expect(
            said(|b| b.markers[1].corners_m[2].z += 0.005),
            &["marker 1 is not"],
        );
        // Metres read as millimetres, centimetres as metres.
        expect(
            said(|b| scale(b, 1e-3)),
            &["0.03 mm", "metres where millimetres"],
        );
        expect(
            said(|b| scale(b, 0.1)),
            &["3 mm", "centimetres where millimetres"],
        );
        expect(said(|b| scale(b, 100.0)), &["centimetres where metres"]);
        expect(
            said(|b| b.markers[3].corners_m = b.markers[3].corners_m.map(|c| c + DVec3::X * 7.0)),
            &["marker 3", "unit"],
        );
        expect(
            said(|b| b.markers[1].corners_m = b.markers[0].corners_m.map(|c| c + DVec3::X * 5e-3)),
            &["lies on marker 0"],
        );
    }

    #[test]
    fn mirrored_markers_are_explained() {
        let mirror = |m: &mut BoardMarker| m.corners_m.swap(0, 1);
        let both = |m: &mut BoardMarker| {
            mirror(m);
            m.corners_m.swap(2, 3);
        };
        let one = said(|b| both(&mut b.markers[2]));
        assert!(one.contains("marker 2 is mirrored"), "{one}");
        let all = said(|b| b.markers.iter_mut().for_each(both));
        assert!(
            all.contains("mirrored") && all.contains("top left"),
            "{all}"
        );
        // An object that lies on its side has the sheet's normal along another axis.
        let dictionary = Dictionary::by_name("DICT_4X4_50").unwrap();
        let mut turned = board();
        for corner in turned.markers.iter_mut().flat_map(|m| &mut m.corners_m) {
            *corner = DVec3::new(corner.x, 0.0, corner.y);
        }
        turned.check(&dictionary, Some(DVec3::NEG_Y)).unwrap();
        let error = turned.check(&dictionary, Some(DVec3::Y)).unwrap_err();
        assert!(error.to_string().contains("mirrored"), "{error}");
    }
}
