//! Boards: markers with known positions on rigid bodies.

use std::fmt;
use std::str::FromStr;

use glam::DVec3;

use gripcast_base::error::{Error, Result, unknown_name};

/// Rigid body that a marker is fixed to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Body {
    /// The sheet or table that the object stands on; object frame.
    Object,
    /// The gripper's housing; gripper frame.
    Gripper,
    /// The left finger, which moves with the opening; gripper frame at opening 0.
    FingerLeft,
    /// The right finger; gripper frame at opening 0.
    FingerRight,
}

impl Body {
    /// All bodies.
    pub const ALL: [Self; 4] = [
        Self::Object,
        Self::Gripper,
        Self::FingerLeft,
        Self::FingerRight,
    ];

    /// Name in board files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Object => "object",
            Self::Gripper => "body",
            Self::FingerLeft => "finger_left",
            Self::FingerRight => "finger_right",
        }
    }

    /// Displacement along the gripper's x axis per metre of opening.
    pub(crate) fn slide(self) -> f64 {
        match self {
            Self::FingerLeft => -0.5,
            Self::FingerRight => 0.5,
            Self::Gripper | Self::Object => 0.0,
        }
    }
}

impl fmt::Display for Body {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Body {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let body = Self::ALL.into_iter().find(|body| body.name() == text);
        body.ok_or_else(|| unknown_name("part", text, &Self::ALL.map(Self::name)))
    }
}

/// A marker of a board.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardMarker {
    /// Id in the dictionary.
    pub id: u32,
    /// Body that carries the marker.
    pub body: Body,
    /// Outer corners of the black border in the body frame, m: top left, top right, bottom right,
    /// bottom left.
    pub corners_m: [DVec3; 4],
}

/// Markers of one dictionary with known positions.
#[derive(Clone, Debug, PartialEq)]
pub struct Board {
    /// Display name.
    pub name: String,
    /// Name of the dictionary, such as `DICT_6X6_250` or `36h11`.
    pub dictionary: String,
    /// The markers; ids are unique.
    pub markers: Vec<BoardMarker>,
}

impl BoardMarker {
    /// Centre in the body frame, m.
    pub fn center_m(&self) -> DVec3 {
        self.corners_m.iter().sum::<DVec3>() / 4.0
    }

    /// Mean side length, m.
    pub fn side_m(&self) -> f64 {
        let side = |k: usize| self.corners_m[k].distance(self.corners_m[(k + 1) % 4]);
        (0..4).map(side).sum::<f64>() / 4.0
    }

    /// Unit normal of the printed side; zero if the corners span no area.
    pub fn normal(&self) -> DVec3 {
        let [a, b, c, d] = self.corners_m;
        (d - b).cross(c - a).normalize_or_zero()
    }

    /// Corners of a square marker from its centre (m) and two perpendicular unit vectors that point
    /// right and up when the marker is read upright.
    pub fn square_corners(center_m: DVec3, right: DVec3, up: DVec3, side_m: f64) -> [DVec3; 4] {
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
    /// Marker ids in ascending order: the whitelist for detection.
    pub fn ids(&self) -> Vec<u32> {
        let mut ids: Vec<u32> = self.markers.iter().map(|m| m.id).collect();
        ids.sort_unstable();
        ids
    }

    /// Markers fixed to a body.
    pub fn markers_on(&self, body: Body) -> impl Iterator<Item = &BoardMarker> {
        self.markers.iter().filter(move |m| m.body == body)
    }

    /// Whether the markers of a body lie in one plane, within 1 % of their extent, and face the
    /// same side. False for a body without markers.
    pub fn is_planar(&self, body: Body) -> bool {
        let Some(first) = self.markers_on(body).next() else {
            return false;
        };
        let (origin, normal) = (first.center_m(), first.normal());
        let mut reach: f64 = 0.0;
        let mut height: f64 = 0.0;
        for marker in self.markers_on(body) {
            if marker.normal().dot(normal) < 0.0 {
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
            body: Body::Gripper,
            corners_m: BoardMarker::square_corners(center, right, up, 0.03),
        }
    }

    #[test]
    fn square_corners_give_normal_side_and_center() {
        let flat = marker(1, DVec3::new(0.1, 0.2, 0.0), DVec3::X, DVec3::Y);
        assert_eq!(flat.normal(), DVec3::Z);
        assert!((flat.side_m() - 0.03).abs() < 1e-15);
        assert!(flat.center_m().distance(DVec3::new(0.1, 0.2, 0.0)) < 1e-15);
        // The first corner is the top left one.
        assert!(flat.corners_m[0].distance(DVec3::new(0.085, 0.215, 0.0)) < 1e-15);
    }

    #[test]
    fn is_planar_rejects_tilted_marker() {
        let mut board = Board {
            name: "b".into(),
            dictionary: "DICT_4X4_50".into(),
            markers: vec![
                marker(3, DVec3::ZERO, DVec3::X, DVec3::Y),
                marker(1, DVec3::X * 0.1, DVec3::X, DVec3::Y),
            ],
        };
        assert!(board.is_planar(Body::Gripper) && !board.is_planar(Body::Object));
        assert_eq!(board.ids(), [1, 3]);
        let pitched = DVec3::new(0.0, 0.8, 0.6);
        board
            .markers
            .push(marker(2, DVec3::Y * 0.1, DVec3::X, pitched));
        assert!(!board.is_planar(Body::Gripper));
    }

    #[test]
    fn body_names_round_trip() {
        for body in Body::ALL {
            assert_eq!(body.name().parse::<Body>().unwrap(), body);
        }
        let text = "fingerleft".parse::<Body>().unwrap_err().to_string();
        assert!(text.contains("did you mean finger_left?"), "{text}");
    }
}
