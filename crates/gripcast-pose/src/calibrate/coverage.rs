//! Coverage of the views, and hints for the next one.

use std::fmt;

use glam::{DVec2, DVec3};

use super::board_points::BoardPoint;
use gripcast_geometry::Pose;

/// Cells of the image: columns and rows.
pub(super) const CELLS: [usize; 2] = [4, 3];
/// Minimum number of points in a cell.
const POINTS_IN_CELL: usize = 6;
/// Minimum angle between board and image plane of a tilted view, rad: 15°.
const TILTED_RAD: f64 = 0.26;

/// Edge of the board that is farther from the camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tilt {
    /// The left edge in the image.
    Left,
    /// The right edge.
    Right,
    /// The upper edge.
    Up,
    /// The lower edge.
    Down,
}

impl Tilt {
    /// All edges.
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

    /// Tilt from the board normal in the camera frame; none for a board that faces the camera.
    pub(super) fn from_normal(normal: DVec3) -> Option<Self> {
        if normal.z.abs().min(1.0).acos() < TILTED_RAD {
            return None;
        }
        // The normal points towards the camera, to the side of the farther edge.
        let is_horizontal = normal.x.abs() > normal.y.abs();
        Some(match is_horizontal {
            true if normal.x < 0.0 => Self::Left,
            true => Self::Right,
            false if normal.y < 0.0 => Self::Up,
            false => Self::Down,
        })
    }
}

/// The view that improves the calibration most.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hint {
    /// Board in this cell of the image: column and row.
    MoveTo([usize; 2]),
    /// Board tilted so that this edge is farther away.
    Tilt(Tilt),
    /// Board nearer to the camera.
    Nearer,
    /// Board farther from the camera.
    Farther,
    /// Any other view.
    More,
    /// None: there are enough views.
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
                    "move the board to the {} {} of the image",
                    height[(*row).min(2)],
                    side[(*column).min(3)]
                )
            }
            Self::Tilt(tilt) => write!(
                f,
                "tilt the board by 20° to 40°: its {} edge away from the camera",
                tilt.edge()
            ),
            Self::Nearer => f.write_str("move the board nearer, until it fills the image"),
            Self::Farther => f.write_str("move the board farther away, to half its size"),
            Self::More => f.write_str("show the board from another direction"),
            Self::Enough => f.write_str("enough views"),
        }
    }
}

/// What the views cover.
#[derive(Clone, Debug, PartialEq)]
pub struct Coverage {
    /// Number of points in each cell of the image: by row, then column.
    pub cells: [[usize; CELLS[0]]; CELLS[1]],
    /// Number of views of each tilt in [`Tilt::ALL`].
    pub tilts: [usize; 4],
    /// Ratio of the maximum to the minimum distance of the board.
    pub distance_ratio: f64,
    /// Number of views.
    pub views: usize,
    /// Required number of views.
    pub wanted: usize,
    /// Maximum height of the board in the image, fraction of the image height.
    max_height: f64,
}

impl Coverage {
    /// Required views of each tilt.
    pub const VIEWS_PER_TILT: usize = 2;
    /// Required [`Self::distance_ratio`].
    pub const MIN_DISTANCE_RATIO: f64 = 1.25;

    /// Coverage of views in images of `size`, each with its points and the board's pose
    /// `t_camera_plane`; `wanted` is the required number of views.
    pub(super) fn new<'a>(
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
            max_height: 0.0,
        };
        let cell_px = DVec2::new(f64::from(size[0]), f64::from(size[1]))
            / DVec2::new(CELLS[0] as f64, CELLS[1] as f64);
        let (mut nearest, mut farthest) = (f64::INFINITY, 0.0f64);
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
            coverage.max_height = coverage.max_height.max((high - low) / f64::from(size[1]));
            if let Some(tilt) = Tilt::from_normal(pose.transform_vector(DVec3::Z)) {
                coverage.tilts[tilt as usize] += 1;
            }
            nearest = nearest.min(pose.translation_m.z);
            farthest = farthest.max(pose.translation_m.z);
        }
        if nearest > 0.0 && farthest > 0.0 {
            coverage.distance_ratio = farthest / nearest;
        }
        coverage
    }

    /// The most useful next view.
    pub fn hint(&self) -> Hint {
        let min = self.tilts.iter().copied().min().unwrap_or(0);
        let tilt = Tilt::ALL[self.tilts.iter().position(|n| *n == min).unwrap_or(0)];
        let empty = self.emptiest_cell();
        // Alternate tilts and cells.
        if min < Self::VIEWS_PER_TILT && (self.views.is_multiple_of(2) || empty.is_none()) {
            return Hint::Tilt(tilt);
        }
        if let Some(cell) = empty {
            return Hint::MoveTo(cell);
        }
        if self.distance_ratio < Self::MIN_DISTANCE_RATIO {
            return if self.max_height < 0.6 {
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

    /// Progress, 0 to 1.
    pub fn progress(&self) -> f64 {
        let cells = self.cells.iter().flatten();
        let cells = cells.filter(|n| **n >= POINTS_IN_CELL).count();
        let tilts = self.tilts.iter().map(|n| (*n).min(Self::VIEWS_PER_TILT));
        let tilts = tilts.sum::<usize>();
        let views = self.views.min(self.wanted);
        let all = CELLS[0] * CELLS[1] + 4 * Self::VIEWS_PER_TILT + self.wanted;
        (cells + tilts + views) as f64 / all as f64
    }

    /// Whether a cell has enough points.
    pub fn is_covered(&self, column: usize, row: usize) -> bool {
        self.cells[row][column] >= POINTS_IN_CELL
    }

    /// The cell with the fewest points, if it is not covered.
    fn emptiest_cell(&self) -> Option<[usize; 2]> {
        let cells = (0..CELLS[1]).flat_map(|row| (0..CELLS[0]).map(move |column| [column, row]));
        cells
            .min_by_key(|[column, row]| self.cells[*row][*column])
            .filter(|[column, row]| !self.is_covered(*column, *row))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;

    /// A rotated board; without rotation its z axis points towards the camera.
    fn pose(rotation: DQuat, depth: f64) -> Pose {
        let facing = DQuat::from_rotation_x(std::f64::consts::PI);
        Pose::new(rotation * facing, DVec3::Z * depth)
    }

    fn points(size: [u32; 2], region: [f64; 4]) -> Vec<BoardPoint> {
        let [left, top, right, bottom] = region;
        let pixel = |k: u32| {
            let (x, y) = (f64::from(k % 8) / 7.0, f64::from(k / 8) / 7.0);
            DVec2::new(
                f64::from(size[0]) * (left + (right - left) * x),
                f64::from(size[1]) * (top + (bottom - top) * y),
            )
        };
        (0..64)
            .map(|index| BoardPoint {
                index,
                point_m: DVec3::ZERO,
                pixel: pixel(index) - 0.5,
            })
            .collect()
    }

    #[test]
    fn tilt_names_farther_edge() {
        for (rotation, expected) in [
            (DQuat::from_rotation_y(-0.5), Tilt::Right),
            (DQuat::from_rotation_y(0.5), Tilt::Left),
            (DQuat::from_rotation_x(-0.5), Tilt::Up),
            (DQuat::from_rotation_x(0.5), Tilt::Down),
        ] {
            let pose = pose(rotation, 0.5);
            assert_eq!(
                Tilt::from_normal(pose.transform_vector(DVec3::Z)),
                Some(expected)
            );
            // The edge is farther away; the board's y axis points up in the image.
            let edge = match expected {
                Tilt::Left => DVec3::NEG_X,
                Tilt::Right => DVec3::X,
                Tilt::Up => DVec3::Y,
                Tilt::Down => DVec3::NEG_Y,
            };
            assert!(pose.transform_vector(edge).z > 0.4, "{expected:?}");
        }
        assert_eq!(
            Tilt::from_normal(pose(DQuat::from_rotation_x(0.2), 0.5).transform_vector(DVec3::Z)),
            None
        );
    }

    #[test]
    fn following_hints_completes_coverage() {
        let size = [1280, 720];
        let mut views: Vec<(Vec<BoardPoint>, Pose)> = Vec::new();
        let mut hints = Vec::new();
        let mut depth = 0.5;
        for _ in 0..40 {
            let all = views.iter().map(|(p, pose)| (&p[..], pose));
            let coverage = Coverage::new(size, all, 12);
            let hint = coverage.hint();
            hints.push(hint);
            let mut region = [0.3, 0.3, 0.7, 0.7];
            let mut rotation = DQuat::IDENTITY;
            match hint {
                Hint::Enough => {
                    assert_eq!(coverage.progress(), 1.0);
                    break;
                }
                Hint::MoveTo([column, row]) => {
                    let (x, y) = (0.25 * column as f64, row as f64 / 3.0);
                    region = [x + 0.01, y + 0.01, x + 0.24, y + 0.32];
                }
                Hint::Tilt(tilt) => {
                    rotation = match tilt {
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
            views.push((points(size, region), pose(rotation, depth)));
        }
        assert_eq!(hints.last(), Some(&Hint::Enough), "{hints:?}");
        assert!(hints.contains(&Hint::Nearer) && hints.contains(&Hint::MoveTo([0, 0])));
        let all: Vec<String> = hints.iter().map(ToString::to_string).collect();
        assert!(all.contains(&"move the board to the upper left of the image".to_owned()));
    }
}
