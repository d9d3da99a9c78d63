//! What carries the markers.

use std::fmt;
use std::str::FromStr;

use glam::DVec3;

use gripcast_base::error::{Error, Result, unknown_name};

/// What a board is fixed to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Part {
    /// The table or the sheet that the object stands on: the object's frame.
    Object,
    /// The gripper's body: the gripper's frame.
    Body,
    /// The left finger, which moves with the opening: the gripper's frame at opening 0.
    FingerLeft,
    /// The right finger.
    FingerRight,
}

impl Part {
    /// All parts.
    pub const ALL: [Self; 4] = [
        Self::Object,
        Self::Body,
        Self::FingerLeft,
        Self::FingerRight,
    ];

    /// Its name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Object => "object",
            Self::Body => "body",
            Self::FingerLeft => "finger_left",
            Self::FingerRight => "finger_right",
        }
    }

    /// How far it moves along the gripper's x axis per metre of opening.
    pub(crate) fn slide(self) -> f64 {
        match self {
            Self::FingerLeft => -0.5,
            Self::FingerRight => 0.5,
            Self::Body | Self::Object => 0.0,
        }
    }
}

impl fmt::Display for Part {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Part {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let known = Self::ALL.into_iter().find(|part| part.name() == text);
        known.ok_or_else(|| unknown_name("part", text, &Self::ALL.map(Self::name)))
    }
}

/// One marker.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardMarker {
    /// Its number in the dictionary.
    pub id: u32,
    /// What it is fixed to.
    pub part: Part,
    /// Outer corners of its black border in the part's frame, m: top left, top right, bottom
    /// right, bottom left.
    pub corners_m: [DVec3; 4],
}

/// Markers of one dictionary with known places.
#[derive(Clone, Debug, PartialEq)]
pub struct Board {
    /// Name, as people call it.
    pub name: String,
    /// Name of the dictionary, such as `DICT_6X6_250` or `36h11`.
    pub dictionary: String,
    /// The markers; every id once.
    pub markers: Vec<BoardMarker>,
}

impl BoardMarker {
    /// Its middle in the part's frame, m.
    pub fn center_m(&self) -> DVec3 {
        self.corners_m.iter().sum::<DVec3>() / 4.0
    }

    /// Mean length of its sides, m.
    pub fn side_m(&self) -> f64 {
        let side = |k: usize| self.corners_m[k].distance(self.corners_m[(k + 1) % 4]);
        (0..4).map(side).sum::<f64>() / 4.0
    }

    /// Unit normal towards whoever reads it upright; zero where the corners span no area.
    pub fn front(&self) -> DVec3 {
        let [a, b, c, d] = self.corners_m;
        (d - b).cross(c - a).normalize_or_zero()
    }

    /// Corners of a square marker from its middle, m, and two perpendicular unit vectors: to the
    /// right and upwards for whoever reads it.
    pub fn square(center_m: DVec3, right: DVec3, up: DVec3, side_m: f64) -> [DVec3; 4] {
        let (x, y) = (right * (0.5 * side_m), up * (0.5 * side_m));
        [
            center_m - x + y,
            center_m + x + y,
            center_m + x - y,
            center_m - x - y,
        ]
    }
}

impl Board {
    /// Ids of all its markers, ascending: the only ones that may be detected.
    pub fn ids(&self) -> Vec<u32> {
        let mut ids: Vec<u32> = self.markers.iter().map(|m| m.id).collect();
        ids.sort_unstable();
        ids
    }

    /// Markers that are fixed to a part.
    pub fn of_part(&self, part: Part) -> impl Iterator<Item = &BoardMarker> {
        self.markers.iter().filter(move |m| m.part == part)
    }

    /// Whether all markers of a part lie in one plane and face the same side, within a hundredth
    /// of the largest distance between them. A part without markers is no plane.
    pub fn is_planar(&self, part: Part) -> bool {
        let Some(first) = self.of_part(part).next() else {
            return false;
        };
        let (origin, normal) = (first.center_m(), first.front());
        let mut reach: f64 = 0.0;
        let mut height: f64 = 0.0;
        for marker in self.of_part(part) {
            if marker.front().dot(normal) < 0.0 {
                return false;
            }
            for corner in marker.corners_m {
                reach = reach.max(corner.distance(origin));
                height = height.max((corner - origin).dot(normal).abs());
            }
        }
        height <= 0.01 * reach
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn marker(id: u32, center: DVec3, right: DVec3, up: DVec3) -> BoardMarker {
        BoardMarker {
            id,
            part: Part::Body,
            corners_m: BoardMarker::square(center, right, up, 0.03),
        }
    }

    #[test]
    fn squares_face_whoever_reads_them() {
        let flat = marker(1, DVec3::new(0.1, 0.2, 0.0), DVec3::X, DVec3::Y);
        assert_eq!(flat.front(), DVec3::Z);
        assert!((flat.side_m() - 0.03).abs() < 1e-15);
        assert!(flat.center_m().distance(DVec3::new(0.1, 0.2, 0.0)) < 1e-15);
        // The first corner is the top left one.
        assert!(flat.corners_m[0].distance(DVec3::new(0.085, 0.215, 0.0)) < 1e-15);
    }

    #[test]
    fn planes_are_told_from_folds() {
        let mut board = Board {
            name: "b".into(),
            dictionary: "DICT_4X4_50".into(),
            markers: vec![
                marker(3, DVec3::ZERO, DVec3::X, DVec3::Y),
                marker(1, DVec3::X * 0.1, DVec3::X, DVec3::Y),
            ],
        };
        assert!(board.is_planar(Part::Body) && !board.is_planar(Part::Object));
        assert_eq!(board.ids(), [1, 3]);
        let tilted = DVec3::new(0.0, 0.8, 0.6);
        board
            .markers
            .push(marker(2, DVec3::Y * 0.1, DVec3::X, tilted));
        assert!(!board.is_planar(Part::Body));
    }

    #[test]
    fn parts_have_names() {
        for part in Part::ALL {
            assert_eq!(part.name().parse::<Part>().unwrap(), part);
        }
        let text = "fingerleft".parse::<Part>().unwrap_err().to_string();
        assert!(text.contains("did you mean finger_left?"), "{text}");
    }
}
