//! Which views are still needed.

use std::fmt;

use glam::{DVec2, DVec3};

use super::board_points::BoardPoint;
use gripcast_geometry::Pose;

/// Cells of the image: columns and rows.
pub(super) const CELLS: [usize; 2] = [4, 3];
/// Points that a cell needs.
const POINTS_IN_CELL: usize = 6;
/// Least angle of the board against the image that counts as tilted, rad: 15°.
const TILTED_RAD: f64 = 0.26;

/// Which edge of the board is farther from the camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tilt {
    /// The left edge, as the camera sees it.
    Left,
    /// The right edge.
    Right,
    /// The upper edge.
    Up,
    /// The lower edge.
    Down,
}

impl Tilt {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Left, Self::Right, Self::Up, Self::Down];

    /// The name of the edge.
    pub fn edge(self) -> &'static str {
        match self {
            Self::Left => "left",
            Self::Right => "right",
            Self::Up => "upper",
            Self::Down => "lower",
        }
    }

    /// Tilt of a board whose normal is given in the camera's frame; none for one that faces the
    /// camera.
    pub(super) fn of(normal: DVec3) -> Option<Self> {
        // The normal points towards the camera, to the side of the edge that is farther away.
        if normal.z.abs().min(1.0).acos() < TILTED_RAD {
            return None;
        }
        Some(if normal.x.abs() > normal.y.abs() {
            if normal.x < 0.0 {
                Self::Left
            } else {
                Self::Right
            }
        } else if normal.y < 0.0 {
            Self::Up
        } else {
            Self::Down
        })
    }
}

/// What to do next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hint {
    /// Move the board to a cell of the image: column and row.
    MoveTo([usize; 2]),
    /// Tilt it so that this edge is farther away.
    Tilt(Tilt),
    /// Bring it nearer to the camera.
    Nearer,
    /// Take it farther away.
    Farther,
    /// Any other view.
    More,
    /// There are enough views.
    Enough,
}

impl fmt::Display for Hint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::MoveTo([column, row]) => {
                let side = ["left", "middle left", "middle right", "right"];
                let height = ["upper", "middle", "lower"];
                write!(
                    f,
                    "hold the board to the {} {} of the image",
                    height[(*row).min(2)],
                    side[(*column).min(3)]
                )
            }
            Self::Tilt(tilt) => write!(
                f,
                "tilt the board by 20° to 40°: its {} edge away from the camera",
                tilt.edge()
            ),
            Self::Nearer => f.write_str("bring the board nearer, until it fills the image"),
            Self::Farther => f.write_str("take the board farther away, to half its size"),
            Self::More => f.write_str("take a view from another direction"),
            Self::Enough => f.write_str("enough views"),
        }
    }
}

/// What the views so far cover.
#[derive(Clone, Debug, PartialEq)]
pub struct Coverage {
    /// Points of all views in each cell of the image: by row, then column.
    pub cells: [[usize; CELLS[0]]; CELLS[1]],
    /// Views by [`Tilt::ALL`].
    pub tilts: [usize; 4],
    /// Least and largest distance of the board's middle, relative to each other: 1 or more.
    pub distance_ratio: f64,
    /// Views.
    pub views: usize,
    /// Views that are enough if all else is covered.
    pub wanted: usize,
    /// Size of the image in which the views are nearest: part of the image's height.
    largest: f64,
}

impl Coverage {
    /// Views that each tilt needs.
    pub const VIEWS_OF_TILT: usize = 2;
    /// Ratio of the farthest to the nearest view that is needed.
    pub const DISTANCES: f64 = 1.25;

    /// Of the points of views and the board's pose in each, `t_camera_plane`, in images of
    /// `size`; `wanted` views are enough.
    pub(super) fn of<'a>(
        size: [u32; 2],
        views: impl Iterator<Item = (&'a [BoardPoint], &'a Pose)>,
        wanted: usize,
    ) -> Self {
        let mut coverage = Self {
            cells: [[0; CELLS[0]]; CELLS[1]],
            tilts: [0; 4],
            distance_ratio: 1.0,
            views: 0,
            wanted,
            largest: 0.0,
        };
        let cell_px = DVec2::new(f64::from(size[0]), f64::from(size[1]))
            / DVec2::new(CELLS[0] as f64, CELLS[1] as f64);
        let (mut least, mut most) = (f64::INFINITY, 0.0f64);
        for (points, pose) in views {
            coverage.views += 1;
            let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
            for point in points {
                let at = (point.pixel + 0.5) / cell_px;
                let (column, row) = (at.x.max(0.0) as usize, at.y.max(0.0) as usize);
                coverage.cells[row.min(CELLS[1] - 1)][column.min(CELLS[0] - 1)] += 1;
                low = low.min(point.pixel.y);
                high = high.max(point.pixel.y);
            }
            coverage.largest = coverage.largest.max((high - low) / f64::from(size[1]));
            if let Some(tilt) = Tilt::of(pose.transform_vector(DVec3::Z)) {
                coverage.tilts[tilt as usize] += 1;
            }
            least = least.min(pose.translation_m.z);
            most = most.max(pose.translation_m.z);
        }
        if least > 0.0 && most > 0.0 {
            coverage.distance_ratio = most / least;
        }
        coverage
    }

    /// What to do next: first what the calibration suffers from most.
    pub fn hint(&self) -> Hint {
        let fewest = self.tilts.iter().copied().min().unwrap_or(0);
        let tilt = Tilt::ALL[self.tilts.iter().position(|n| *n == fewest).unwrap_or(0)];
        let empty = self.emptiest();
        // Tilts and places in turn, so that they come together.
        if fewest < Self::VIEWS_OF_TILT && (self.views.is_multiple_of(2) || empty.is_none()) {
            return Hint::Tilt(tilt);
        }
        if let Some(cell) = empty {
            return Hint::MoveTo(cell);
        }
        if fewest < Self::VIEWS_OF_TILT {
            return Hint::Tilt(tilt);
        }
        if self.distance_ratio < Self::DISTANCES {
            return if self.largest < 0.6 {
                Hint::Nearer
            } else {
                Hint::Farther
            };
        }
        if self.views < self.wanted {
            return Hint::More;
        }
        Hint::Enough
    }

    /// Parts of what is needed, 0 to 1.
    pub fn progress(&self) -> f64 {
        let cells = self
            .cells
            .iter()
            .flatten()
            .filter(|n| **n >= POINTS_IN_CELL)
            .count();
        let tilts: usize = self
            .tilts
            .iter()
            .map(|n| (*n).min(Self::VIEWS_OF_TILT))
            .sum();
        let views = self.views.min(self.wanted);
        let all = CELLS[0] * CELLS[1] + 4 * Self::VIEWS_OF_TILT + self.wanted;
        (cells + tilts + views) as f64 / all as f64
    }

    /// Whether a cell has enough points.
    pub fn is_covered(&self, column: usize, row: usize) -> bool {
        self.cells[row][column] >= POINTS_IN_CELL
    }

    /// The cell with fewest points, if they are too few.
    fn emptiest(&self) -> Option<[usize; 2]> {
        let places = (0..CELLS[1]).flat_map(|row| (0..CELLS[0]).map(move |column| [column, row]));
        places
            .min_by_key(|[column, row]| self.cells[*row][*column])
            .filter(|[column, row]| !self.is_covered(*column, *row))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;

    /// A board that faces the camera (its z axis towards it), then turned.
    fn pose(turn: DQuat, depth: f64) -> Pose {
        let facing = DQuat::from_rotation_x(std::f64::consts::PI);
        Pose::new(turn * facing, DVec3::Z * depth)
    }

    fn points(size: [u32; 2], part: [f64; 4]) -> Vec<BoardPoint> {
        let [left, top, right, bottom] = part;
        let place = |k: u32| {
            let (x, y) = (f64::from(k % 8) / 7.0, f64::from(k / 8) / 7.0);
            DVec2::new(
                f64::from(size[0]) * (left + (right - left) * x),
                f64::from(size[1]) * (top + (bottom - top) * y),
            )
        };
        (0..64)
            .map(|number| BoardPoint {
                number,
                place_m: DVec3::ZERO,
                pixel: place(number) - 0.5,
            })
            .collect()
    }

    #[test]
    fn tilts_are_named_after_the_far_edge() {
        for (turn, expected) in [
            (DQuat::from_rotation_y(-0.5), Tilt::Right),
            (DQuat::from_rotation_y(0.5), Tilt::Left),
            (DQuat::from_rotation_x(-0.5), Tilt::Up),
            (DQuat::from_rotation_x(0.5), Tilt::Down),
        ] {
            let pose = pose(turn, 0.5);
            assert_eq!(Tilt::of(pose.transform_vector(DVec3::Z)), Some(expected));
            // The edge is really farther away; the board's y axis points upwards in the image.
            let edge = match expected {
                Tilt::Left => DVec3::NEG_X,
                Tilt::Right => DVec3::X,
                Tilt::Up => DVec3::Y,
                Tilt::Down => DVec3::NEG_Y,
            };
            assert!(pose.transform_vector(edge).z > 0.4, "{expected:?}");
        }
        assert_eq!(
            Tilt::of(pose(DQuat::from_rotation_x(0.2), 0.5).transform_vector(DVec3::Z)),
            None
        );
    }

    #[test]
    fn hints_lead_to_enough() {
        let size = [1280, 720];
        let mut views: Vec<(Vec<BoardPoint>, Pose)> = Vec::new();
        let mut said = Vec::new();
        let mut depth = 0.5;
        for _ in 0..40 {
            let all = views.iter().map(|(p, pose)| (&p[..], pose));
            let coverage = Coverage::of(size, all, 12);
            let hint = coverage.hint();
            said.push(hint);
            let mut part = [0.3, 0.3, 0.7, 0.7];
            let mut turn = DQuat::IDENTITY;
            match hint {
                Hint::Enough => {
                    assert_eq!(coverage.progress(), 1.0);
                    break;
                }
                Hint::MoveTo([column, row]) => {
                    let (x, y) = (0.25 * column as f64, row as f64 / 3.0);
                    part = [x + 0.01, y + 0.01, x + 0.24, y + 0.32];
                }
                Hint::Tilt(tilt) => {
                    turn = match tilt {
                        Tilt::Left => DQuat::from_rotation_y(0.5),
                        Tilt::Right => DQuat::from_rotation_y(-0.5),
                        Tilt::Up => DQuat::from_rotation_x(-0.5),
                        Tilt::Down => DQuat::from_rotation_x(0.5),
                    }
                }
                Hint::Nearer => depth = 0.3,
                Hint::Farther => depth = 0.8,
                Hint::More => {}
            }
            views.push((points(size, part), pose(turn, depth)));
        }
        assert_eq!(said.last(), Some(&Hint::Enough), "{said:?}");
        assert!(said.contains(&Hint::Nearer) && said.contains(&Hint::MoveTo([0, 0])));
        let all: Vec<String> = said.iter().map(ToString::to_string).collect();
        assert!(all.contains(&"hold the board to the upper left of the image".to_owned()));
    }
}
