//! Sheets and cards that carry markers, as a ray sees them.

use glam::{DMat3, DQuat, DVec2, DVec3};

use crate::camera::project;
use crate::{Board, BoardMarker, Chessboard, Dictionary, MarkerCells, Part};
use gripcast_geometry::Pose;
use gripcast_imaging::Intrinsics;

/// Planes closer than this and parallel are one sheet, m.
const ONE_SHEET_M: f64 = 1e-4;
/// White around the outermost markers, in cells.
const MARGIN_CELLS: f64 = 2.0;

/// What a ray meets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Shade {
    Background,
    White,
    Black,
}

/// Pixels that something can be seen in.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bounds {
    min: DVec2,
    max: DVec2,
}

impl Bounds {
    pub(super) fn overlaps(&self, min: DVec2, max: DVec2) -> bool {
        self.min.cmple(max).all() && min.cmple(self.max).all()
    }
}

/// A flat white piece with markers.
pub(super) struct Surface {
    /// Ideal image coordinates (x, y, 1) to plane coordinates, homogeneous.
    to_plane: DMat3,
    /// Camera's height above the plane, m; the markers face the camera if it is positive.
    height: f64,
    min: DVec2,
    max: DVec2,
    pub(super) bounds: Bounds,
    pub(super) decals: Vec<Decal>,
}

/// A marker on a surface.
pub(super) struct Decal {
    pub(super) id: u32,
    pub(super) bounds: Bounds,
    /// Its corners in the camera's frame, m.
    pub(super) corners_m: [DVec3; 4],
    origin: DVec2,
    right: DVec2,
    down: DVec2,
    /// Cells along a side with the border, and of the border.
    cells: usize,
    border: usize,
    /// None for a square that is black all over.
    data: Option<MarkerCells>,
}

impl Surface {
    /// Depth (m) at which the ray (x, y, 1) meets the piece, and where on its plane.
    pub(super) fn hit(&self, ideal: DVec2) -> Option<(f64, DVec2)> {
        let h = self.to_plane * ideal.extend(1.0);
        let depth = -self.height / h.z;
        let at = h.truncate() / h.z;
        let is_hit = depth > 0.0 && at.cmpge(self.min).all() && at.cmple(self.max).all();
        is_hit.then_some((depth, at))
    }

    /// Shade at a point of the plane; `decals` are those that may be there.
    pub(super) fn shade(&self, at: DVec2, decals: &[usize]) -> Shade {
        if self.height <= 0.0 {
            return Shade::Background;
        }
        decals
            .iter()
            .find_map(|i| self.decals[*i].is_white(at))
            .map_or(Shade::White, |white| {
                if white { Shade::White } else { Shade::Black }
            })
    }
}

impl Decal {
    fn is_white(&self, at: DVec2) -> Option<bool> {
        let from = at - self.origin;
        let cell = |along: DVec2| {
            let place = from.dot(along) * self.cells as f64;
            (place >= 0.0 && place < self.cells as f64).then_some(place as usize)
        };
        let (column, row) = (cell(self.right)?, cell(self.down)?);
        let inside = self.border..self.cells - self.border;
        let is_data = inside.contains(&column) && inside.contains(&row);
        let is_white = |data: &MarkerCells| data.is_white(row - self.border, column - self.border);
        Some(is_data && self.data.as_ref().is_some_and(is_white))
    }

    /// Whether it is a marker.
    pub(super) fn is_marker(&self) -> bool {
        self.data.is_some()
    }
}

/// The sheets of one part of a board: markers of one plane share one.
pub(super) fn surfaces(
    board: &Board,
    part: Part,
    dictionary: &Dictionary,
    t_camera_part: &Pose,
    intrinsics: &Intrinsics,
) -> Vec<Surface> {
    let mut sheets: Vec<(Pose, Vec<&BoardMarker>)> = Vec::new();
    for marker in board.markers.iter().filter(|m| m.part == part) {
        let frame = plane_of(marker);
        let sheet = sheets.iter_mut().find(|(plane, _)| {
            let back = plane.inverse();
            marker
                .corners_m
                .iter()
                .all(|c| back.transform_point(*c).z.abs() < ONE_SHEET_M)
                && plane
                    .transform_vector(DVec3::Z)
                    .dot(frame.transform_vector(DVec3::Z))
                    > 0.0
        });
        match sheet {
            Some((_, markers)) => markers.push(marker),
            None => sheets.push((frame, vec![marker])),
        }
    }
    sheets
        .iter()
        .map(|(plane, markers)| {
            let pieces = pieces(markers, dictionary);
            let cell = markers.first().map_or(0.0, |m| {
                m.corners_m[0].distance(m.corners_m[1]) / dictionary.cells_per_side() as f64
            });
            surface(plane, pieces, cell, t_camera_part, intrinsics)
        })
        .collect()
}

/// The sheet of a chessboard with its markers.
pub(super) fn chessboard_surface(
    board: &Board,
    chessboard: &Chessboard,
    dictionary: &Dictionary,
    t_camera_board: &Pose,
    intrinsics: &Intrinsics,
) -> Surface {
    let markers: Vec<&BoardMarker> = board.markers.iter().collect();
    let mut all = pieces(&markers, dictionary);
    let squares = chessboard.black_squares_m();
    all.extend(squares.iter().map(|corners| Piece {
        id: 0,
        corners_m: corners.map(|c| c.extend(0.0)),
        cells: 1,
        border: 1,
        data: None,
    }));
    let margin_m = 1e-3 * 0.1 * chessboard.square_mm[0];
    surface(&Pose::IDENTITY, all, margin_m, t_camera_board, intrinsics)
}

/// What becomes a [`Decal`].
struct Piece {
    id: u32,
    corners_m: [DVec3; 4],
    cells: usize,
    border: usize,
    data: Option<MarkerCells>,
}

fn pieces(markers: &[&BoardMarker], dictionary: &Dictionary) -> Vec<Piece> {
    let known = markers.iter().filter_map(|marker| {
        Some(Piece {
            id: marker.id,
            corners_m: marker.corners_m,
            cells: dictionary.cells_per_side(),
            border: dictionary.border_cells(),
            data: Some(dictionary.marker(marker.id)?),
        })
    });
    known.collect()
}

/// Origin at the top-left corner, x to the right, z towards the front.
fn plane_of(marker: &BoardMarker) -> Pose {
    let [a, b, _, d] = marker.corners_m;
    let x = (b - a).normalize_or(DVec3::X);
    let z = x.cross(a - d).normalize_or(DVec3::Z);
    let axes = DMat3::from_cols(x, z.cross(x), z);
    Pose::new(DQuat::from_mat3(&axes), a)
}

fn surface(
    plane: &Pose,
    pieces: Vec<Piece>,
    cell_m: f64,
    t_camera_part: &Pose,
    intrinsics: &Intrinsics,
) -> Surface {
    let t_camera_plane = *t_camera_part * *plane;
    let flat = |c: DVec3| plane.inverse().transform_point(c).truncate();
    let corners = || pieces.iter().flat_map(|p| p.corners_m).map(flat);
    let margin = DVec2::splat(MARGIN_CELLS * cell_m);
    let min = corners().fold(DVec2::INFINITY, DVec2::min) - margin;
    let max = corners().fold(DVec2::NEG_INFINITY, DVec2::max) + margin;
    let decals = pieces.into_iter().map(|piece| {
        let [a, b, _, d] = piece.corners_m.map(flat);
        Decal {
            id: piece.id,
            bounds: bounds(&[a, b, b + d - a, d], &t_camera_plane, intrinsics),
            corners_m: piece.corners_m.map(|c| t_camera_part.transform_point(c)),
            origin: a,
            right: (b - a) / (b - a).length_squared(),
            down: (d - a) / (d - a).length_squared(),
            cells: piece.cells,
            border: piece.border,
            data: piece.data,
        }
    });
    let decals = decals.collect();
    let outline = [min, DVec2::new(max.x, min.y), max, DVec2::new(min.x, max.y)];
    let t_plane_camera = t_camera_plane.inverse();
    let (r, o) = (
        t_plane_camera.rotation_matrix(),
        t_plane_camera.translation_m,
    );
    let row = |i: usize| r.row(i);
    let rows = [
        o.x * row(2) - o.z * row(0),
        o.y * row(2) - o.z * row(1),
        row(2),
    ];
    Surface {
        to_plane: DMat3::from_cols(rows[0], rows[1], rows[2]).transpose(),
        height: o.z,
        min,
        max,
        bounds: bounds(&outline, &t_camera_plane, intrinsics),
        decals,
    }
}

/// Pixels around a polygon of the plane; everything if a part of it cannot be projected.
fn bounds(outline: &[DVec2; 4], t_camera_plane: &Pose, intrinsics: &Intrinsics) -> Bounds {
    const PIECES: usize = 8;
    let mut bounds = Bounds {
        min: DVec2::INFINITY,
        max: DVec2::NEG_INFINITY,
    };
    for (i, a) in outline.iter().enumerate() {
        for piece in 0..PIECES {
            let at = a.lerp(outline[(i + 1) % 4], piece as f64 / PIECES as f64);
            let Some(pixel) = project(intrinsics, t_camera_plane.transform_point(at.extend(0.0)))
            else {
                return Bounds {
                    min: DVec2::NEG_INFINITY,
                    max: DVec2::INFINITY,
                };
            };
            bounds.min = bounds.min.min(pixel - 3.0);
            bounds.max = bounds.max.max(pixel + 3.0);
        }
    }
    bounds
}
