//! The points of a board that an image shows.

use std::collections::BTreeMap;

use glam::{DMat3, DQuat, DVec2, DVec3};
use image::GrayImage;

use super::saddle::{ExpectedSaddle, refine_saddle};
use crate::refine::refine_corners;
use crate::solve::homography::plane_to_image;
use crate::{BoardFile, BoardMarker, Chessboard, Detection, Part};
use gripcast_base::error::{Error, Result};
use gripcast_geometry::Pose;

/// Markers up to this many squares from a corner help to predict it.
const HELPING_SQUARES: f64 = 1.8;
/// The middle of a marker whose square touches a corner is at most this far, squares.
const TOUCHING_SQUARES: f64 = 0.6;

/// A point of a board in an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoardPoint {
    /// Which point of the board: the same in all images.
    pub number: u32,
    /// Where it is in the frame of the board's plane, m.
    pub place_m: DVec3,
    /// Where it was seen, px.
    pub pixel: DVec2,
}

/// What an image shows of a board.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BoardPoints {
    /// Its points, each once, by number.
    pub points: Vec<BoardPoint>,
    /// How many markers of the board were detected.
    pub markers: usize,
}

/// Finds the points of one board: the inner corners of its chessboard, else its markers' corners.
#[derive(Clone, Debug)]
pub struct PointFinder {
    file: BoardFile,
    t_plane_board: Pose,
    extent_m: f64,
    total: usize,
}

impl PointFinder {
    /// A finder for a flat board.
    ///
    /// # Errors
    /// `Input` for a board whose object markers are not in one plane.
    pub fn new(file: &BoardFile) -> Result<Self> {
        let board = &file.board;
        if !board.is_planar(Part::Object) {
            return Err(Error::input(format!(
                "{}: calibration needs a flat board with part \"object\"",
                board.name
            ))
            .remedy("`gripcast board charuco` draws one"));
        }
        let t_plane_board = plane_frame(file).inverse();
        let corners = || board.of_part(Part::Object).flat_map(|m| m.corners_m);
        let extent_m = 2.0
            * corners()
                .map(|c| t_plane_board.transform_point(c).length())
                .fold(0.0, f64::max);
        let total = match &file.chessboard {
            Some(chessboard) => chessboard.corner_count(),
            None => 4 * board.of_part(Part::Object).count(),
        };
        Ok(Self {
            file: file.clone(),
            t_plane_board,
            extent_m,
            total,
        })
    }

    /// The board.
    pub fn file(&self) -> &BoardFile {
        &self.file
    }

    /// Maps the board's frame into that of its plane: origin in the middle of the markers, z out of
    /// the sheet.
    pub fn t_plane_board(&self) -> Pose {
        self.t_plane_board
    }

    /// Number of points that the board has.
    pub fn total(&self) -> usize {
        self.total
    }

    /// Diameter of the board, m.
    pub fn extent_m(&self) -> f64 {
        self.extent_m
    }

    /// The points in an image with these detections, which need no refinement yet.
    pub fn find(&self, image: &GrayImage, detections: &[Detection]) -> BoardPoints {
        let seen = self.seen(image, detections);
        let mut points = match &self.file.chessboard {
            Some(chessboard) => self.saddles(image, chessboard, &seen),
            None => self.marker_corners(&seen),
        };
        points.sort_by_key(|p| p.number);
        BoardPoints {
            points,
            markers: seen.len(),
        }
    }

    /// Refined markers of the board by index. One that was seen twice is no evidence, and one whose
    /// border shows no four lines is hidden in part.
    fn seen(&self, image: &GrayImage, detections: &[Detection]) -> BTreeMap<usize, Detection> {
        let markers = &self.file.board.markers;
        let mut seen = BTreeMap::new();
        for detection in detections {
            let is_twice = detections.iter().filter(|d| d.id == detection.id).count() > 1;
            let place = markers
                .iter()
                .position(|m| m.id == detection.id && m.part == Part::Object);
            let (Some(place), false) = (place, is_twice) else {
                continue;
            };
            let refined = refine_corners(image, detection);
            if refined.corners_px != detection.corners_px {
                seen.insert(place, refined);
            }
        }
        seen
    }

    fn marker_corners(&self, seen: &BTreeMap<usize, Detection>) -> Vec<BoardPoint> {
        let markers = &self.file.board.markers;
        let of_marker = |(place, detection): (&usize, &Detection)| {
            let (place, pixels) = (*place, detection.corners_px);
            let corners = markers[place].corners_m;
            (0..4).map(move |k| BoardPoint {
                number: (4 * place + k) as u32,
                place_m: self.t_plane_board.transform_point(corners[k]),
                pixel: pixels[k],
            })
        };
        seen.iter().flat_map(of_marker).collect()
    }

    fn saddles(
        &self,
        image: &GrayImage,
        chessboard: &Chessboard,
        seen: &BTreeMap<usize, Detection>,
    ) -> Vec<BoardPoint> {
        let corners = chessboard.corners_m();
        let columns = chessboard.squares[0] - 1;
        let found = corners.iter().enumerate().filter_map(|(number, place)| {
            let [column, row] = [number as u32 % columns + 1, number as u32 / columns + 1];
            let expected = self.expected(chessboard, [column, row], seen)?;
            Some(BoardPoint {
                number: number as u32,
                place_m: self.t_plane_board.transform_point(place.extend(0.0)),
                pixel: refine_saddle(image, &expected)?,
            })
        });
        found.collect()
    }

    /// Where the inner corner below and to the right of `column − 1`, `row − 1` should be, by the
    /// homography of the markers around it; none if no marker beside it was seen.
    fn expected(
        &self,
        chessboard: &Chessboard,
        [column, row]: [u32; 2],
        seen: &BTreeMap<usize, Detection>,
    ) -> Option<ExpectedSaddle> {
        let markers = &self.file.board.markers;
        let place = chessboard.place_m(f64::from(column), f64::from(row));
        let square = 1e-3 * DVec2::from_array(chessboard.square_mm);
        let squares_off = |marker: &BoardMarker| {
            ((marker.center_m().truncate() - place) / square)
                .abs()
                .max_element()
        };
        let is_beside = |marker: &BoardMarker| squares_off(marker) <= TOUCHING_SQUARES;
        if !seen.keys().any(|k| is_beside(&markers[*k])) {
            return None;
        }
        let helping = || {
            seen.iter()
                .filter(|(k, _)| squares_off(&markers[**k]) <= HELPING_SQUARES)
        };
        let plane: Vec<DVec2> = helping()
            .flat_map(|(k, _)| markers[*k].corners_m)
            .map(|c| c.truncate() - place)
            .collect();
        let pixels: Vec<DVec2> = helping().flat_map(|(_, d)| d.corners_px).collect();
        let homography = plane_to_image(&plane, &pixels)?;
        let beside: Vec<&BoardMarker> = markers.iter().filter(|m| is_beside(m)).collect();
        let nearest = nearest_corner(&beside, place)?;
        let at = mapped(&homography, DVec2::ZERO)?;
        let free_px = free_distance(&homography, &beside, place, at)?;
        // Between the corner and the markers, and as far from it in the black squares.
        let off = |x: f64, y: f64| mapped(&homography, 0.7 * nearest * DVec2::new(x, y));
        let rising = [off(1.0, 1.0)?, off(-1.0, -1.0)?];
        let falling = [off(-1.0, 1.0)?, off(1.0, -1.0)?];
        // The square above and to the left is on the falling diagonal.
        let (white, black) = if chessboard.is_black(column - 1, row - 1) {
            (rising, falling)
        } else {
            (falling, rising)
        };
        Some(ExpectedSaddle {
            at,
            white,
            black,
            free_px,
        })
    }
}

/// Distances along x and y to the nearest corner of the markers beside a place, m.
fn nearest_corner(beside: &[&BoardMarker], place: DVec2) -> Option<DVec2> {
    let corners = beside.iter().flat_map(|m| m.corners_m);
    corners
        .map(|c| (c.truncate() - place).abs())
        .min_by(|a, b| a.length().total_cmp(&b.length()))
}

/// Distance in the image from `at` to the outlines of the markers beside it.
fn free_distance(
    homography: &DMat3,
    beside: &[&BoardMarker],
    place: DVec2,
    at: DVec2,
) -> Option<f64> {
    let mut least = f64::INFINITY;
    for marker in beside {
        let corners = marker
            .corners_m
            .map(|c| mapped(homography, c.truncate() - place));
        let [Some(a), Some(b), Some(c), Some(d)] = corners else {
            return None;
        };
        for (p, q) in [(a, b), (b, c), (c, d), (d, a)] {
            least = least.min(distance_to_segment(at, p, q));
        }
    }
    Some(least)
}

fn distance_to_segment(at: DVec2, a: DVec2, b: DVec2) -> f64 {
    let along = (at - a).dot(b - a) / (b - a).length_squared().max(f64::MIN_POSITIVE);
    at.distance(a.lerp(b, along.clamp(0.0, 1.0)))
}

fn mapped(homography: &DMat3, at: DVec2) -> Option<DVec2> {
    let h = *homography * at.extend(1.0);
    let pixel = h.truncate() / h.z;
    pixel.is_finite().then_some(pixel)
}

/// Frame with its origin in the middle of the object's markers and z out of the sheet, as seen from
/// the board.
fn plane_frame(file: &BoardFile) -> Pose {
    let markers: Vec<&BoardMarker> = file.board.of_part(Part::Object).collect();
    let middle = markers.iter().map(|m| m.center_m()).sum::<DVec3>() / markers.len().max(1) as f64;
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
    Pose::new(DQuat::from_mat3(&axes), middle)
}
