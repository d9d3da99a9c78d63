//! Positions of the gripper's markers.
//!
//! Three carriers, for a camera in front of the gripper (its −y side) and above, with the gripper
//! pointing down. Gripper frame, mm; the fingers at opening 0:
//!
//! | carrier | markers | centre | faces |
//! | --- | --- | --- | --- |
//! | roof: a card folded by 56°, on the camera and its arm | 2 of 30 mm | fold through (0, −70, −222) | −y, yawed by ±35° and pitched 35° up |
//! | two cards in front of the rail's ends | 2 of 30 mm | (±115, −20, −107) | −y |
//! | a flag at the outer side of each finger's plate | 1 of 18 mm each | (±43.7, −13, −45) | −y |
//!
//! The distant cards determine the rotation, the folded ones make it unambiguous.

use glam::DVec3;

use crate::board_check::check_side;
use crate::{Board, BoardFile, BoardMarker, Body, Dictionary};
use gripcast_base::error::{Error, Result};

/// Yaw and pitch of the roof's faces, rad.
pub(super) const ROOF_RAD: f64 = 35.0 * std::f64::consts::PI / 180.0;
/// Centre of the roof's fold, mm.
const ROOF_MM: DVec3 = DVec3::new(0.0, -70.0, -222.0);
/// Centre of the card at the +x end of the rail, mm.
const RAIL_MM: DVec3 = DVec3::new(115.0, -20.0, -107.0);
/// Distance of a flag's inner edge, at the outer side of the finger's plate, from the gel face, mm.
const FLAG_X_MM: f64 = 32.0;
/// y and z of a flag's centre, mm.
const FLAG_YZ_MM: [f64; 2] = [-13.0, -45.0];
/// Maximum size of markers on the body and on the fingers, m.
const MAX_M: [f64; 2] = [0.032, 0.022];

/// Settings of the gripper's markers.
#[derive(Clone, Debug)]
pub struct GripperTags {
    /// Name of the board.
    pub name: String,
    /// Dictionary; must differ from that of other visible markers with the same ids.
    pub dictionary: Dictionary,
    /// Id of the first of six markers: roof −x, roof +x, rail −x, rail +x, left finger, right
    /// finger.
    pub first_id: u32,
    /// Side of the body's markers, m.
    pub body_m: f64,
    /// Side of the fingers' markers, m.
    pub finger_m: f64,
    /// Measured lengths of the 100 mm rulers on the printed sheet, mm. They scale the markers.
    pub measured_mm: [f64; 2],
}

impl GripperTags {
    /// Number of markers.
    pub const COUNT: u32 = 6;

    /// Width of a marker's card: marker, quiet zone of one cell, and 0.2 cells for cutting, mm.
    pub(super) fn card_mm(&self, side_m: f64) -> f64 {
        let cells = self.dictionary.cells_per_side() as f64;
        1e3 * side_m * (1.0 + 2.4 / cells)
    }

    /// Checks ids and sizes.
    pub(super) fn check(&self) -> Result<()> {
        super::check_ruler_lengths(self.measured_mm)?;
        self.dictionary
            .check_ids(self.first_id, Self::COUNT as usize)
            .map_err(|e| e.remedy("choose a smaller first id"))?;
        for (side, max, what) in [
            (self.body_m, MAX_M[0], "body"),
            (self.finger_m, MAX_M[1], "finger"),
        ] {
            check_side(side)?;
            if side > max {
                let what = format!(
                    "a marker of {:.1} mm does not fit on the {what}: the maximum is {:.1} mm",
                    1e3 * side,
                    1e3 * max
                );
                return Err(Error::input(what));
            }
        }
        Ok(())
    }
}

/// The markers of the rendered gripper, in the gripper frame at opening 0.
///
/// # Errors
/// `Input` for markers that do not fit, or ids outside the dictionary.
pub fn gripper_board(tags: &GripperTags) -> Result<BoardFile> {
    tags.check()?;
    let (right, up) = (DVec3::NEG_X, DVec3::NEG_Z);
    let mut squares = Vec::new();
    for side in [-1.0, 1.0] {
        let (center, right, up) = roof_face(side, 1e-3 * tags.card_mm(tags.body_m));
        squares.push((Body::Gripper, center, right, up, tags.body_m));
    }
    for side in [-1.0, 1.0] {
        let center = 1e-3 * DVec3::new(side * RAIL_MM.x, RAIL_MM.y, RAIL_MM.z);
        squares.push((Body::Gripper, center, right, up, tags.body_m));
    }
    for (body, side) in [(Body::FingerLeft, -1.0), (Body::FingerRight, 1.0)] {
        let x = FLAG_X_MM + 0.5 * tags.card_mm(tags.finger_m);
        let center = 1e-3 * DVec3::new(side * x, FLAG_YZ_MM[0], FLAG_YZ_MM[1]);
        squares.push((body, center, right, up, tags.finger_m));
    }
    let [x, y] = tags.measured_mm.map(|mm| mm / super::RULER_MM);
    let marker = |(id, (body, center, right, up, side_m)): (u32, _)| BoardMarker {
        id,
        body,
        corners_m: BoardMarker::square_corners(center, right * x, up * y, side_m),
    };
    let board = Board {
        name: tags.name.clone(),
        dictionary: tags.dictionary.name().to_owned(),
        markers: (tags.first_id..).zip(squares).map(marker).collect(),
    };
    BoardFile::new(board, tags.dictionary.clone(), None)
}

/// Centre (m), right and up of the roof's face at x < 0 or x > 0, made of a card `card_m` wide.
fn roof_face(side: f64, card_m: f64) -> (DVec3, DVec3, DVec3) {
    let normal = roof_normal(side);
    // The fold is perpendicular to both normals.
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

/// Folding angle: between the normals of the roof's faces, rad.
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
    fn markers_face_forwards_and_upright() {
        let file = gripper_board(&tags()).unwrap();
        let board = &file.board;
        assert_eq!(board.ids(), (240..246).collect::<Vec<u32>>());
        assert_eq!(board.markers_on(Body::Gripper).count(), 4);
        for marker in &board.markers {
            assert!(marker.normal().y < -0.6, "{}", marker.id);
            let [top, _, _, bottom] = marker.corners_m;
            // The gripper points down: −z is up.
            assert!(top.z < bottom.z - 0.01, "{}", marker.id);
        }
        let normal = |k: usize| board.markers[k].normal();
        // 30° between two normals make the pose unambiguous.
        assert!(normal(0).angle_between(normal(1)) > 55f64.to_radians());
        assert!(normal(0).angle_between(normal(2)) > 45f64.to_radians());
        let yaw = (normal(1).x / -normal(1).y).atan();
        assert!((yaw - ROOF_RAD).abs() < 1e-12);
        assert!(((-normal(1).z).asin() - ROOF_RAD).abs() < 1e-12);
        assert!(!board.is_planar(Body::Gripper));
    }

    #[test]
    fn bundled_board_file_matches() {
        let text = include_str!("../../../../calib/boards/gripper-umi.toml");
        assert_eq!(gripper_board(&tags()).unwrap().to_toml(), text);
    }

    #[test]
    fn markers_are_mirror_symmetric() {
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
    fn printer_scale_changes_the_sizes() {
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
    fn invalid_settings_are_rejected() {
        let error = |change: &dyn Fn(&mut GripperTags)| {
            let mut changed = tags();
            change(&mut changed);
            gripper_board(&changed).unwrap_err().to_string()
        };
        assert!(error(&|t| t.first_id = 245).contains("ends with id 249"));
        assert!(error(&|t| t.body_m = 0.05).contains("does not fit on the body"));
        assert!(error(&|t| t.finger_m = 0.03).contains("does not fit on the finger"));
        assert!(error(&|t| t.finger_m = 18.0).contains("millimetres where metres"));
        assert!(error(&|t| t.measured_mm = [30.0; 2]).contains("100 mm"));
    }
}
