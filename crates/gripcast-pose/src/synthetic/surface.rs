//! Ray casting of sheets with markers.

use glam::{DMat3, DQuat, DVec2, DVec3};

use crate::camera::project;
use crate::{Board, BoardMarker, Body, Chessboard, Dictionary, MarkerCells};
use gripcast_geometry::Pose;
use gripcast_imaging::Intrinsics;

/// Parallel planes closer than this share a sheet, m.
const ONE_SHEET_M: f64 = 1e-4;
/// White margin around the outermost markers, cells.
const MARGIN_CELLS: f64 = 2.0;

/// Shade at the end of a ray.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Shade {
    Background,
    White,
    Black,
}

/// Bounding box in the image, px.
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

/// A flat white sheet with markers.
pub(super) struct Surface {
    /// Homography from normalised image coordinates (x, y, 1) to the plane.
    to_plane: DMat3,
    /// Height of the camera above the plane, m; negative behind it.
    height: f64,
    min: DVec2,
    max: DVec2,
    pub(super) bounds: Bounds,
    pub(super) decals: Vec<Decal>,
}

/// A posed pattern on a surface.
pub(super) struct Decal {
    pub(super) pattern: Pattern,
    pub(super) bounds: Bounds,
    /// Corners in the camera frame, m.
    pub(super) corners_m: [DVec3; 4],
    origin: DVec2,
    right: DVec2,
    down: DVec2,
}

/// A marker or a black square.
pub(super) struct Pattern {
    pub(super) id: u32,
    /// Corners in the body frame, m.
    corners_m: [DVec3; 4],
    /// Number of cells along a side including the border, and along the border.
    cells: usize,
    border: usize,
    /// `None`: a black square.
    data: Option<MarkerCells>,
}

impl Surface {
    /// Intersection with the ray (x, y, 1): depth (m), and point of the plane.
    pub(super) fn hit(&self, ideal: DVec2) -> Option<(f64, DVec2)> {
        let h = self.to_plane * ideal.extend(1.0);
        let depth = -self.height / h.z;
        let at = h.truncate() / h.z;
        let is_hit = depth > 0.0 && at.cmpge(self.min).all() && at.cmple(self.max).all();
        is_hit.then_some((depth, at))
    }

    /// Shade at a point of the plane; `decals` are the candidates.
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
        let Pattern {
            cells,
            border,
            data,
            ..
        } = &self.pattern;
        let from = at - self.origin;
        let cell = |along: DVec2| {
            let index = from.dot(along) * *cells as f64;
            (index >= 0.0 && index < *cells as f64).then_some(index as usize)
        };
        let (column, row) = (cell(self.right)?, cell(self.down)?);
        let inside = *border..cells - border;
        let is_data = inside.contains(&column) && inside.contains(&row);
        let is_white = |data: &MarkerCells| data.is_white(row - border, column - border);
        Some(is_data && data.as_ref().is_some_and(is_white))
    }

    pub(super) fn is_marker(&self) -> bool {
        self.pattern.data.is_some()
    }
}

/// The sheets of a body; coplanar markers share a sheet.
pub(super) fn surfaces(
    board: &Board,
    body: Body,
    dictionary: &Dictionary,
    t_camera_body: &Pose,
    intrinsics: &Intrinsics,
) -> Vec<Surface> {
    let mut sheets: Vec<(Pose, Vec<&BoardMarker>)> = Vec::new();
    for marker in board.markers.iter().filter(|m| m.body == body) {
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
            let patterns = patterns(markers, dictionary);
            let cell = markers.first().map_or(0.0, |m| {
                m.corners_m[0].distance(m.corners_m[1]) / dictionary.cells_per_side() as f64
            });
            surface(plane, patterns, cell, t_camera_body, intrinsics)
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
    let mut all = patterns(&markers, dictionary);
    let squares = chessboard.black_squares_m();
    all.extend(squares.iter().map(|corners| Pattern {
        id: 0,
        corners_m: corners.map(|c| c.extend(0.0)),
        cells: 1,
        border: 1,
        data: None,
    }));
    let margin_m = 1e-3 * 0.1 * chessboard.square_mm[0];
    surface(&Pose::IDENTITY, all, margin_m, t_camera_board, intrinsics)
}

fn patterns(markers: &[&BoardMarker], dictionary: &Dictionary) -> Vec<Pattern> {
    let known = markers.iter().filter_map(|marker| {
        Some(Pattern {
            id: marker.id,
            corners_m: marker.corners_m,
            cells: dictionary.cells_per_side(),
            border: dictionary.border_cells(),
            data: Some(dictionary.marker(marker.id)?),
        })
    });
    known.collect()
}

/// Frame at the top-left corner: x to the right, z normal.
fn plane_of(marker: &BoardMarker) -> Pose {
    let [a, b, _, d] = marker.corners_m;
    let x = (b - a).normalize_or(DVec3::X);
    let z = x.cross(a - d).normalize_or(DVec3::Z);
    let axes = DMat3::from_cols(x, z.cross(x), z);
    Pose::new(DQuat::from_mat3(&axes), a)
}

fn surface(
    plane: &Pose,
    patterns: Vec<Pattern>,
    cell_m: f64,
    t_camera_body: &Pose,
    intrinsics: &Intrinsics,
) -> Surface {
    let t_camera_plane = *t_camera_body * *plane;
    let flat = |c: DVec3| plane.inverse().transform_point(c).truncate();
    let corners = || patterns.iter().flat_map(|p| p.corners_m).map(flat);
    let margin = DVec2::splat(MARGIN_CELLS * cell_m);
    let min = corners().fold(DVec2::INFINITY, DVec2::min) - margin;
    let max = corners().fold(DVec2::NEG_INFINITY, DVec2::max) + margin;
    let decals = patterns.into_iter().map(|pattern| {
        let [a, b, _, d] = pattern.corners_m.map(flat);
        Decal {
            bounds: bounds(&[a, b, b + d - a, d], &t_camera_plane, intrinsics),
            corners_m: pattern.corners_m.map(|c| t_camera_body.transform_point(c)),
            origin: a,
            right: (b - a) / (b - a).length_squared(),
            down: (d - a) / (d - a).length_squared(),
            pattern,
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

/// Bounding box of a polygon of the plane; infinite if it cannot be projected.
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
