//! Calibration points of a board in an image.

use std::collections::BTreeMap;

use glam::{DMat3, DQuat, DVec2, DVec3};
use image::GrayImage;

use super::chessboard_finder::find_chessboard;
use super::saddle::{ExpectedSaddle, refine_saddle};
use crate::refine::refine_corners;
use crate::solve::homography::plane_to_image;
use crate::{BoardFile, BoardMarker, Body, Chessboard, Detection};
use gripcast_base::error::{Error, Result};
use gripcast_geometry::Pose;

/// Maximum distance of markers that predict a chessboard corner, squares.
const PREDICTING_SQUARES: f64 = 1.8;
/// Maximum distance of the centre of a marker whose square touches a corner, squares.
const TOUCHING_SQUARES: f64 = 0.6;

/// A point of a board observed in an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoardPoint {
    /// Index of the point on the board, the same in all images.
    pub index: u32,
    /// Position in the plane frame of the board, m.
    pub point_m: DVec3,
    /// Observed position, px.
    pub pixel: DVec2,
}

/// Points of a board observed in an image.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BoardPoints {
    /// The points in ascending order of their indices.
    pub points: Vec<BoardPoint>,
    /// Number of detected markers of the board.
    pub markers: usize,
    /// Black squares of a chessboard without markers, whose edges show the blur.
    pub squares: Vec<Detection>,
}

/// Finds the points of a board: the inner corners of its chessboard, else its marker corners.
#[derive(Clone, Debug)]
pub struct PointFinder {
    file: BoardFile,
    t_plane_board: Pose,
    diameter_m: f64,
}

impl PointFinder {
    /// Creates a finder for a planar board.
    ///
    /// # Errors
    /// `Input` if the object markers of the board are not in one plane.
    pub fn new(file: &BoardFile) -> Result<Self> {
        let board = &file.board;
        if let Some(chessboard) = file.plain() {
            let corners = chessboard.corners_m();
            return Ok(Self {
                file: file.clone(),
                t_plane_board: Pose::IDENTITY,
                diameter_m: 2.0 * corners.iter().map(|c| c.length()).fold(0.0, f64::max),
            });
        }
        if !board.is_planar(Body::Object) {
            return Err(Error::input(format!(
                "{}: calibration needs a planar board with markers of part \"object\"",
                board.name
            ))
            .remedy("create one with `gripcast board charuco`"));
        }
        let t_plane_board = plane_frame(file).inverse();
        let corners = || board.markers_on(Body::Object).flat_map(|m| m.corners_m);
        let radii = corners().map(|c| t_plane_board.transform_point(c).length());
        Ok(Self {
            file: file.clone(),
            t_plane_board,
            diameter_m: 2.0 * radii.fold(0.0, f64::max),
        })
    }

    /// The board.
    pub fn file(&self) -> &BoardFile {
        &self.file
    }

    /// Maps the board frame into its plane frame: origin at the centre of the markers, z out of the
    /// sheet.
    pub fn t_plane_board(&self) -> Pose {
        self.t_plane_board
    }

    /// Diameter of the board, m.
    pub fn diameter_m(&self) -> f64 {
        self.diameter_m
    }

    /// Finds the points in an image, given unrefined detections.
    pub fn find(&self, image: &GrayImage, detections: &[Detection]) -> BoardPoints {
        if let Some(chessboard) = self.file.plain() {
            return plain_points(image, chessboard);
        }
        let observed = self.refined_markers(image, detections);
        let mut points = match &self.file.chessboard {
            Some(chessboard) => self.saddles(image, chessboard, &observed),
            None => self.marker_corners(&observed),
        };
        points.sort_by_key(|p| p.index);
        BoardPoints {
            points,
            markers: observed.len(),
            squares: Vec::new(),
        }
    }

    /// Refined markers by index on the board. Skips markers that are detected twice or whose
    /// corners cannot be refined, because they are partly occluded.
    fn refined_markers(
        &self,
        image: &GrayImage,
        detections: &[Detection],
    ) -> BTreeMap<usize, Detection> {
        let markers = self.file.board.markers.iter();
        let mut observed = BTreeMap::new();
        for detection in detections {
            let is_twice = detections.iter().filter(|d| d.id == detection.id).count() > 1;
            let index = markers
                .clone()
                .position(|m| m.id == detection.id && m.body == Body::Object);
            let (Some(index), false) = (index, is_twice) else {
                continue;
            };
            let refined = refine_corners(image, detection);
            if refined.corners_px != detection.corners_px {
                observed.insert(index, refined);
            }
        }
        observed
    }

    fn marker_corners(&self, observed: &BTreeMap<usize, Detection>) -> Vec<BoardPoint> {
        let of_marker = |(marker, detection): (&usize, &Detection)| {
            let (marker, pixels) = (*marker, detection.corners_px);
            let corners = self.file.board.markers[marker].corners_m;
            (0..4).map(move |k| BoardPoint {
                index: (4 * marker + k) as u32,
                point_m: self.t_plane_board.transform_point(corners[k]),
                pixel: pixels[k],
            })
        };
        observed.iter().flat_map(of_marker).collect()
    }

    fn saddles(
        &self,
        image: &GrayImage,
        chessboard: &Chessboard,
        observed: &BTreeMap<usize, Detection>,
    ) -> Vec<BoardPoint> {
        let corners = chessboard.corners_m();
        let columns = chessboard.squares[0] - 1;
        let points = (0..).zip(corners).filter_map(|(index, corner)| {
            let square = [index % columns + 1, index / columns + 1];
            let expected = self.predict_saddle(chessboard, square, observed)?;
            Some(BoardPoint {
                index,
                point_m: self.t_plane_board.transform_point(corner.extend(0.0)),
                pixel: refine_saddle(image, &expected)?,
            })
        });
        points.collect()
    }

    /// Predicts the inner corner at the top left of square `column`, `row` by the homography of the
    /// markers around it. None if no adjacent marker was observed.
    fn predict_saddle(
        &self,
        chessboard: &Chessboard,
        [column, row]: [u32; 2],
        observed: &BTreeMap<usize, Detection>,
    ) -> Option<ExpectedSaddle> {
        let markers = &self.file.board.markers;
        let corner = chessboard.point_m(f64::from(column), f64::from(row));
        let square = 1e-3 * DVec2::from_array(chessboard.square_mm);
        let squares_off = |marker: &BoardMarker| {
            ((marker.center_m().truncate() - corner) / square)
                .abs()
                .max_element()
        };
        let is_adjacent = |marker: &BoardMarker| squares_off(marker) <= TOUCHING_SQUARES;
        if !observed.keys().any(|k| is_adjacent(&markers[*k])) {
            return None;
        }
        let predicting = || {
            let all = observed.iter();
            all.filter(|(k, _)| squares_off(&markers[**k]) <= PREDICTING_SQUARES)
        };
        let plane: Vec<DVec2> = predicting()
            .flat_map(|(k, _)| markers[*k].corners_m)
            .map(|c| c.truncate() - corner)
            .collect();
        let pixels: Vec<DVec2> = predicting().flat_map(|(_, d)| d.corners_px).collect();
        let homography = plane_to_image(&plane, &pixels)?;
        let adjacent: Vec<&BoardMarker> = markers.iter().filter(|m| is_adjacent(m)).collect();
        let nearest = nearest_corner(&adjacent, corner)?;
        let pixel = apply(&homography, DVec2::ZERO)?;
        let free_px = distance_to_markers(&homography, &adjacent, corner, pixel)?;
        // Between the corner and the markers, and equally far from it in the black squares.
        let off = |x: f64, y: f64| apply(&homography, 0.7 * nearest * DVec2::new(x, y));
        let rising = [off(1.0, 1.0)?, off(-1.0, -1.0)?];
        let falling = [off(-1.0, 1.0)?, off(1.0, -1.0)?];
        // The square above and to the left is on the falling diagonal.
        let (white, black) = if chessboard.is_black(column - 1, row - 1) {
            (rising, falling)
        } else {
            (falling, rising)
        };
        Some(ExpectedSaddle {
            pixel,
            white,
            black,
            free_px,
        })
    }
}

/// Points of a chessboard without markers; none unless all of it is visible.
fn plain_points(image: &GrayImage, chessboard: &Chessboard) -> BoardPoints {
    let [columns, rows] = chessboard.squares.map(|n| n - 1);
    let Some(pixels) = find_chessboard(image, [columns, rows], chessboard.is_black(0, 0)) else {
        return BoardPoints::default();
    };
    let point = |(index, (corner, pixel)): (u32, (DVec2, &DVec2))| BoardPoint {
        index,
        point_m: corner.extend(0.0),
        pixel: *pixel,
    };
    let at = |column: u32, row: u32| pixels[(row * columns + column) as usize];
    let square = |(column, row): (u32, u32)| Detection {
        id: row * columns + column,
        corners_px: [
            at(column, row),
            at(column + 1, row),
            at(column + 1, row + 1),
            at(column, row + 1),
        ],
        hamming: 0,
        margin: 0.0,
    };
    let squares = (0..rows - 1)
        .flat_map(|row| (0..columns - 1).map(move |column| (column, row)))
        .filter(|(column, row)| chessboard.is_black(column + 1, row + 1));
    BoardPoints {
        points: (0..)
            .zip(chessboard.corners_m().into_iter().zip(&pixels))
            .map(point)
            .collect(),
        markers: 0,
        squares: squares.map(square).collect(),
    }
}

/// Distances along x and y from `point` to the nearest marker corner, m.
fn nearest_corner(markers: &[&BoardMarker], point: DVec2) -> Option<DVec2> {
    let corners = markers.iter().flat_map(|m| m.corners_m);
    corners
        .map(|c| (c.truncate() - point).abs())
        .min_by(|a, b| a.length().total_cmp(&b.length()))
}

/// Distance from `pixel` to the outlines of the markers in the image, px; `origin` is the origin of
/// the homography on the board.
fn distance_to_markers(
    homography: &DMat3,
    markers: &[&BoardMarker],
    origin: DVec2,
    pixel: DVec2,
) -> Option<f64> {
    let mut min = f64::INFINITY;
    for marker in markers {
        let [a, b, c, d] = marker
            .corners_m
            .map(|c| apply(homography, c.truncate() - origin));
        let [a, b, c, d] = [a?, b?, c?, d?];
        for (p, q) in [(a, b), (b, c), (c, d), (d, a)] {
            min = min.min(distance_to_segment(pixel, p, q));
        }
    }
    Some(min)
}

fn distance_to_segment(point: DVec2, a: DVec2, b: DVec2) -> f64 {
    let along = (point - a).dot(b - a) / (b - a).length_squared().max(f64::MIN_POSITIVE);
    point.distance(a.lerp(b, along.clamp(0.0, 1.0)))
}

fn apply(homography: &DMat3, point: DVec2) -> Option<DVec2> {
    let h = *homography * point.extend(1.0);
    let pixel = h.truncate() / h.z;
    pixel.is_finite().then_some(pixel)
}

/// Frame with its origin at the centre of the object markers and z out of the sheet, in the board
/// frame.
fn plane_frame(file: &BoardFile) -> Pose {
    let markers: Vec<&BoardMarker> = file.board.markers_on(Body::Object).collect();
    let center = markers.iter().map(|m| m.center_m()).sum::<DVec3>() / markers.len().max(1) as f64;
    let across: DVec3 = markers
        .iter()
        .map(|m| (m.corners_m[3] - m.corners_m[1]).cross(m.corners_m[2] - m.corners_m[0]))
        .sum();
    let z = across.normalize_or(DVec3::Z);
    let right = markers
        .first()
        .map_or(DVec3::X, |m| m.corners_m[1] - m.corners_m[0]);
    let x = right
        .reject_from(z)
        .try_normalize()
        .unwrap_or_else(|| z.any_orthonormal_vector());
    let axes = DMat3::from_cols(x, z.cross(x), z);
    Pose::new(DQuat::from_mat3(&axes), center)
}
