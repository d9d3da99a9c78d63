//! Markers of the gripper: where they are fixed.
//!
//! Three carriers, made for a camera in front of the gripper (its −y side) and above, with the
//! gripper pointing down. Gripper frame, mm; the fingers at opening 0:
//!
//! | carrier | markers | middle | faces |
//! | --- | --- | --- | --- |
//! | roof: a card folded by 56°, on the camera and its arm | 2 of 30 mm | fold through (0, −70, −222) | −y, yawed by ±35° and pitched 35° up |
//! | two cards in front of the rail's ends | 2 of 30 mm | (±115, −20, −107) | −y |
//! | a flag at the outer side of each finger's plate | 1 of 18 mm each | (±43.7, −13, −45) | −y |
//!
//! The cards far apart give the rotation, the folded ones keep it from being ambiguous.

use glam::DVec3;

use crate::board_check::check_side;
use crate::{Board, BoardFile, BoardMarker, Dictionary, Part};
use gripcast_base::error::{Error, Result};

/// Yaw and pitch of the roof's faces, rad.
pub(super) const ROOF_RAD: f64 = 35.0 * std::f64::consts::PI / 180.0;
/// A point of the roof's fold, at half its height, mm.
const ROOF_MM: DVec3 = DVec3::new(0.0, -70.0, -222.0);
/// Middle of the card at the rail's end on the side of +x, mm.
const RAIL_MM: DVec3 = DVec3::new(115.0, -20.0, -107.0);
/// Distance of a flag's inner edge from the gel face: the outer side of the finger's plate, mm.
const FLAG_X_MM: f64 = 32.0;
/// Height and depth of a flag's middle, mm.
const FLAG_YZ_MM: [f64; 2] = [-13.0, -45.0];
/// Largest markers that the places leave room for, m.
const MAX_M: [f64; 2] = [0.032, 0.022];

/// What the gripper's markers are.
#[derive(Clone, Debug)]
pub struct GripperTags {
    /// Name of the board.
    pub name: String,
    /// Dictionary; not that of other markers in view with the same ids.
    pub dictionary: Dictionary,
    /// Id of the first of six markers: roof −x, roof +x, rail −x, rail +x, left finger, right
    /// finger.
    pub first_id: u32,
    /// Side of the body's markers, m.
    pub body_m: f64,
    /// Side of the fingers' markers, m.
    pub finger_m: f64,
    /// What the rulers of 100 mm measure on the printed sheet, mm: the markers' sizes follow.
    pub measured_mm: [f64; 2],
}

impl GripperTags {
    /// Number of markers.
    pub const COUNT: u32 = 6;

    /// Width of a marker's card: the marker and a quiet zone of one cell around, and a fifth of a
    /// cell for the scissors, mm.
    pub(super) fn card_mm(&self, side_m: f64) -> f64 {
        let cells = self.dictionary.cells_per_side() as f64;
        1e3 * side_m * (1.0 + 2.4 / cells)
    }

    /// Checks ids and sizes.
    pub(super) fn check(&self) -> Result<()> {
        super::check_measured(self.measured_mm)?;
        self.dictionary
            .check_ids(self.first_id, Self::COUNT as usize)
            .map_err(|e| e.remedy("choose a smaller first id"))?;
        for (side, most, what) in [
            (self.body_m, MAX_M[0], "body"),
            (self.finger_m, MAX_M[1], "finger"),
        ] {
            check_side(side)?;
            if side > most {
                let what = format!(
                    "a marker of {:.1} mm has no room on the {what}, the most is {:.1} mm",
                    1e3 * side,
                    1e3 * most
                );
                return Err(Error::input(what));
            }
        }
        Ok(())
    }
}

/// The gripper's markers in its frame (fingers at opening 0), for the gripper that the renderer
/// draws.
///
/// # Errors
/// `Input` for sizes that have no room, or ids that the dictionary does not have.
pub fn gripper_board(tags: &GripperTags) -> Result<BoardFile> {
    tags.check()?;
    let nominal = |part: Part, center: DVec3, right: DVec3, up: DVec3, side_m: f64| {
        (part, center, right, up, side_m)
    };
    let flat = (DVec3::NEG_X, DVec3::NEG_Z);
    let mut places = Vec::new();
    for side in [-1.0, 1.0] {
        let (center, right, up) = roof_face(side, 1e-3 * tags.card_mm(tags.body_m));
        places.push(nominal(Part::Body, center, right, up, tags.body_m));
    }
    for side in [-1.0, 1.0] {
        let center = 1e-3 * DVec3::new(side * RAIL_MM.x, RAIL_MM.y, RAIL_MM.z);
        places.push(nominal(Part::Body, center, flat.0, flat.1, tags.body_m));
    }
    for (part, side) in [(Part::FingerLeft, -1.0), (Part::FingerRight, 1.0)] {
        let x = FLAG_X_MM + 0.5 * tags.card_mm(tags.finger_m);
        let center = 1e-3 * DVec3::new(side * x, FLAG_YZ_MM[0], FLAG_YZ_MM[1]);
        places.push(nominal(part, center, flat.0, flat.1, tags.finger_m));
    }
    let [x, y] = tags.measured_mm.map(|mm| mm / super::RULER_MM);
    let marker = |(id, (part, center, right, up, side_m)): (u32, _)| BoardMarker {
        id,
        part,
        corners_m: BoardMarker::square(center, right * x, up * y, side_m),
    };
    let board = Board {
        name: tags.name.clone(),
        dictionary: tags.dictionary.name().to_owned(),
        markers: (tags.first_id..).zip(places).map(marker).collect(),
    };
    BoardFile::new(board, tags.dictionary.clone(), None)
}

/// Middle (m), right and up of the roof's face on the side of x < 0 or x > 0 of a card `card_m`
/// wide.
fn roof_face(side: f64, card_m: f64) -> (DVec3, DVec3, DVec3) {
    let normal = roof_normal(side);
    // The faces meet along the line that is perpendicular to both normals.
    let up = roof_normal(1.0).cross(roof_normal(-1.0)).normalize();
    let up = if up.z > 0.0 { -up } else { up };
    let right = up.cross(normal);
    let outwards = if right.x * side > 0.0 { right } else { -right };
    let center = 1e-3 * ROOF_MM + outwards * (0.5 * card_m);
    (center, right, up)
}

/// −y, yawed towards ±x and pitched upwards (−z).
fn roof_normal(side: f64) -> DVec3 {
    let (sin, cos) = ROOF_RAD.sin_cos();
    DVec3::new(side * sin * cos, -cos * cos, -sin)
}

/// Angle between the normals of the roof's faces, rad: by how much the card is folded.
pub(super) fn fold_rad() -> f64 {
    roof_normal(-1.0).angle_between(roof_normal(1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tags() -> GripperTags {
        GripperTags {
            name: "gripper-umi".into(),
            dictionary: Dictionary::by_name("DICT_6X6_250").unwrap(),
            first_id: 240,
            body_m: 0.03,
            finger_m: 0.018,
            measured_mm: [100.0; 2],
        }
    }

    #[test]
    fn markers_face_forwards_upright_and_apart() {
        let file = gripper_board(&tags()).unwrap();
        let board = &file.board;
        assert_eq!(board.ids(), (240..246).collect::<Vec<u32>>());
        assert_eq!(board.of_part(Part::Body).count(), 4);
        for marker in &board.markers {
            assert!(marker.front().y < -0.6, "{}", marker.id);
            let [top, _, _, bottom] = marker.corners_m;
            // Upwards is −z: the gripper points down.
            assert!(top.z < bottom.z - 0.01, "{}", marker.id);
        }
        let front = |k: usize| board.markers[k].front();
        // Two of a part that are at least 30° apart settle the pose.
        assert!(front(0).angle_between(front(1)) > 55f64.to_radians());
        assert!(front(0).angle_between(front(2)) > 45f64.to_radians());
        let yaw = (front(1).x / -front(1).y).atan();
        assert!((yaw - ROOF_RAD).abs() < 1e-12);
        assert!(((-front(1).z).asin() - ROOF_RAD).abs() < 1e-12);
        assert!(!board.is_planar(Part::Body));
    }

    #[test]
    fn the_file_that_comes_along_is_this_board() {
        let text = include_str!("../../../../calib/boards/gripper-umi.toml");
        assert_eq!(gripper_board(&tags()).unwrap().to_toml(), text);
    }

    #[test]
    fn both_halves_mirror_each_other() {
        let file = gripper_board(&tags()).unwrap();
        let mirror = |p: DVec3| DVec3::new(-p.x, p.y, p.z);
        for pair in file.board.markers.chunks(2) {
            let (a, b) = (&pair[0], &pair[1]);
            assert!(a.center_m().x < 0.0 && b.center_m().x > 0.0);
            assert!(mirror(a.center_m()).distance(b.center_m()) < 1e-12);
            // Corners run clockwise on both.
            assert!(mirror(a.corners_m[0]).distance(b.corners_m[1]) < 1e-12);
        }
    }

    #[test]
    fn a_printers_scale_changes_the_sizes() {
        let scaled = GripperTags {
            measured_mm: [99.0, 102.0],
            ..tags()
        };
        let file = gripper_board(&scaled).unwrap();
        let [a, b, c, _] = file.board.markers[0].corners_m;
        assert!((a.distance(b) - 0.0297).abs() < 1e-12);
        assert!((b.distance(c) - 0.0306).abs() < 1e-12);
    }

    #[test]
    fn what_has_no_room_is_refused() {
        let refused = |change: &dyn Fn(&mut GripperTags)| {
            let mut changed = tags();
            change(&mut changed);
            gripper_board(&changed).unwrap_err().to_string()
        };
        assert!(refused(&|t| t.first_id = 245).contains("ends with id 249"));
        assert!(refused(&|t| t.body_m = 0.05).contains("no room on the body"));
        assert!(refused(&|t| t.finger_m = 0.03).contains("no room on the finger"));
        assert!(refused(&|t| t.finger_m = 18.0).contains("millimetres where metres"));
        assert!(refused(&|t| t.measured_mm = [30.0; 2]).contains("100 mm"));
    }
}
