//! Renders markers with ground truth of their corners.

use glam::DVec2;
use image::GrayImage;
use rayon::prelude::*;

use super::degrade::{ImageConditions, degrade};
use super::surface::{Decal, Shade, Surface, chessboard_surface, surfaces};
use crate::camera::{project, undistort};
use crate::{Board, BoardFile, Body, Detection, Dictionary};
use gripcast_geometry::Pose;
use gripcast_imaging::Intrinsics;

/// Side of a tile, px; its pixels share a list of candidates.
const TILE: u32 = 32;
/// Samples of a pixel crossed by an edge, on a lattice with one sample per row and column.
const SAMPLES: usize = 32;
const LATTICE: usize = 13;

/// A posed body of a board.
#[derive(Clone, Copy, Debug)]
pub struct PlacedBoard<'a> {
    /// The board.
    pub board: &'a Board,
    /// The body.
    pub body: Body,
    /// Dictionary; unknown markers are not drawn.
    pub dictionary: &'a Dictionary,
    /// Pose of the body in the camera frame.
    pub t_camera_body: Pose,
}

/// An image with ground truth.
#[derive(Clone, Debug)]
pub struct SyntheticImage {
    /// The image.
    pub image: GrayImage,
    /// Exact corners of the fully visible markers.
    pub truth: Vec<Detection>,
    /// Exact corners of the other markers in front of the camera: partly occluded or outside the
    /// image.
    pub covered: Vec<Detection>,
}

/// Renders markers on white sheets; coplanar markers share a sheet.
#[must_use]
pub fn render(
    intrinsics: &Intrinsics,
    placed: &[PlacedBoard<'_>],
    conditions: &ImageConditions,
    seed: u64,
) -> SyntheticImage {
    let surfaces: Vec<Surface> = placed
        .iter()
        .flat_map(|p| surfaces(p.board, p.body, p.dictionary, &p.t_camera_body, intrinsics))
        .collect();
    image_of(intrinsics, &surfaces, conditions, seed)
}

/// Renders the markers and the chessboard of a calibration board.
#[must_use]
pub fn render_board(
    intrinsics: &Intrinsics,
    file: &BoardFile,
    t_camera_board: &Pose,
    conditions: &ImageConditions,
    seed: u64,
) -> SyntheticImage {
    let (board, dictionary) = (&file.board, &file.dictionary);
    let surfaces = match &file.chessboard {
        Some(chessboard) => vec![chessboard_surface(
            board,
            chessboard,
            dictionary,
            t_camera_board,
            intrinsics,
        )],
        None => surfaces(board, Body::Object, dictionary, t_camera_board, intrinsics),
    };
    image_of(intrinsics, &surfaces, conditions, seed)
}

fn image_of(
    intrinsics: &Intrinsics,
    surfaces: &[Surface],
    conditions: &ImageConditions,
    seed: u64,
) -> SyntheticImage {
    let (width, height) = (intrinsics.width, intrinsics.height);
    let rays = Rays::new(intrinsics);
    let mut levels = vec![0.0f32; width as usize * height as usize];
    levels
        .par_chunks_mut((TILE * width) as usize)
        .enumerate()
        .for_each(|(i, rows)| render_rows(rows, i as u32 * TILE, &rays, surfaces, conditions));
    let (truth, covered) = visible(intrinsics, surfaces);
    SyntheticImage {
        image: degrade(levels, width, height, conditions, seed),
        truth,
        covered,
    }
}

/// Normalised coordinates of the corners of all pixels.
struct Rays {
    width: usize,
    corners: Vec<DVec2>,
}

impl Rays {
    fn new(intrinsics: &Intrinsics) -> Self {
        let width = intrinsics.width as usize + 1;
        let height = intrinsics.height as usize + 1;
        let mut corners = vec![DVec2::ZERO; width * height];
        corners
            .par_chunks_mut(width)
            .enumerate()
            .for_each(|(y, row)| {
                for (x, ray) in row.iter_mut().enumerate() {
                    let pixel = DVec2::new(x as f64 - 0.5, y as f64 - 0.5);
                    *ray = undistort(intrinsics, pixel).unwrap_or(DVec2::NAN);
                }
            });
        Self { width, corners }
    }

    /// Interpolates within a pixel at `fraction` (0–1).
    fn at(&self, x: usize, y: usize, fraction: DVec2) -> DVec2 {
        let [a, b, c, d] = self.around(x, y);
        a.lerp(b, fraction.x)
            .lerp(c.lerp(d, fraction.x), fraction.y)
    }

    fn around(&self, x: usize, y: usize) -> [DVec2; 4] {
        let i = y * self.width + x;
        [i, i + 1, i + self.width, i + self.width + 1].map(|i| self.corners[i])
    }
}

/// Surfaces that may be visible in a tile, with their decals there.
type Candidates<'a> = Vec<(&'a Surface, Vec<usize>)>;

fn candidates(surfaces: &[Surface], min: DVec2, max: DVec2) -> Candidates<'_> {
    let here = surfaces.iter().filter(|s| s.bounds.overlaps(min, max));
    here.map(|surface| {
        let decals = surface.decals.iter().enumerate();
        let near = decals.filter(|(_, d)| d.bounds.overlaps(min, max));
        (surface, near.map(|(i, _)| i).collect())
    })
    .collect()
}

/// Shade at the first intersection of a ray.
fn shade(candidates: &Candidates<'_>, ideal: DVec2) -> Shade {
    let hits = candidates
        .iter()
        .filter_map(|(surface, decals)| surface.hit(ideal).map(|hit| (hit, surface, decals)));
    hits.min_by(|a, b| a.0.0.total_cmp(&b.0.0))
        .map_or(Shade::Background, |((_, at), surface, decals)| {
            surface.shade(at, decals)
        })
}

fn render_rows(
    rows: &mut [f32],
    top: u32,
    rays: &Rays,
    surfaces: &[Surface],
    conditions: &ImageConditions,
) {
    let width = rays.width - 1;
    let height = rows.len() / width;
    for left in (0..width).step_by(TILE as usize) {
        let right = (left + TILE as usize).min(width);
        let min = DVec2::new(left as f64, f64::from(top));
        let max = DVec2::new(right as f64, f64::from(top) + height as f64);
        let here = candidates(surfaces, min, max);
        for y in 0..height {
            for x in left..right {
                rows[y * width + x] = level(&here, rays, x, top as usize + y, conditions);
            }
        }
    }
}

/// Mean light over the area of a pixel.
fn level(
    here: &Candidates<'_>,
    rays: &Rays,
    x: usize,
    y: usize,
    conditions: &ImageConditions,
) -> f32 {
    if here.is_empty() {
        return conditions.light(Shade::Background);
    }
    let corners = rays.around(x, y).map(|ray| shade(here, ray));
    if corners.iter().all(|c| *c == corners[0]) {
        return conditions.light(corners[0]);
    }
    let sum: f32 = (0..SAMPLES)
        .map(|i| {
            let lattice = DVec2::new(i as f64, (i * LATTICE % SAMPLES) as f64);
            let fraction = (lattice + 0.5) / SAMPLES as f64;
            conditions.light(shade(here, rays.at(x, y, fraction)))
        })
        .sum();
    sum / SAMPLES as f32
}

/// Fully visible markers including most of their quiet zone, and the others.
fn visible(intrinsics: &Intrinsics, surfaces: &[Surface]) -> (Vec<Detection>, Vec<Detection>) {
    let (mut truth, mut covered) = (Vec::new(), Vec::new());
    for surface in surfaces {
        for decal in surface.decals.iter().filter(|d| d.is_marker()) {
            let Some(corners_px) = corners(intrinsics, decal) else {
                continue;
            };
            let is_complete = grid(decal)
                .all(|at| is_visible(intrinsics, surfaces, surface, at).unwrap_or(false));
            let list = if is_complete {
                &mut truth
            } else {
                &mut covered
            };
            list.push(Detection {
                id: decal.pattern.id,
                corners_px,
                hamming: 0,
                margin: 0.0,
            });
        }
    }
    truth.sort_by_key(|d| d.id);
    (truth, covered)
}

fn corners(intrinsics: &Intrinsics, decal: &Decal) -> Option<[DVec2; 4]> {
    let [a, b, c, d] = decal.corners_m.map(|c| project(intrinsics, c));
    Some([a?, b?, c?, d?])
}

/// Grid over a marker and a narrow border, in the camera frame.
fn grid(decal: &Decal) -> impl Iterator<Item = glam::DVec3> {
    const STEPS: usize = 12;
    let [a, b, _, d] = decal.corners_m;
    let along = |i: usize| -0.1 + 1.2 * i as f64 / STEPS as f64;
    (0..=STEPS)
        .flat_map(move |i| (0..=STEPS).map(move |k| a + (b - a) * along(i) + (d - a) * along(k)))
}

fn is_visible(
    intrinsics: &Intrinsics,
    surfaces: &[Surface],
    own: &Surface,
    at: glam::DVec3,
) -> Option<bool> {
    let pixel = project(intrinsics, at)?;
    let size = DVec2::new(f64::from(intrinsics.width), f64::from(intrinsics.height));
    let inside = pixel.cmpge(DVec2::splat(2.0)).all() && pixel.cmple(size - 3.0).all();
    let ideal = at.truncate() / at.z;
    let (depth, _) = own.hit(ideal)?;
    let hidden = surfaces
        .iter()
        .any(|s| !std::ptr::eq(s, own) && s.hit(ideal).is_some_and(|(d, _)| d < depth));
    Some(inside && !hidden)
}
