//! Inner corners of a chessboard without markers.
//!
//! Inner corners are saddle points of the image, found as maxima of the negative Hessian determinant
//! of the smoothed light. A grid grows from a corner to its neighbours: each is where the known
//! corners predict it, and its squares have opposite colours (A. Geiger et al., *Automatic camera and
//! range sensor calibration using a single shot*, ICRA 2012, grow chessboards similarly).

use std::collections::{BTreeMap, VecDeque};

use glam::DVec2;
use image::GrayImage;

use super::saddle::{ExpectedSaddle, refine_saddle};
use crate::refine::bilinear;
use gripcast_imaging::srgb_decode;

/// Scales at which saddle points are searched for: distance of the samples of the Hessian, px. Large
/// ones bridge blur, small ones resolve small squares.
const SCALES_PX: [i64; 2] = [2, 4];
/// Minimum response of a corner relative to the strongest.
const MIN_RESPONSE: f64 = 0.02;
/// Minimum response, squared linear light.
const MIN_LIGHT: f64 = 1e-5;
/// Maximum cosine of twice the angle between edge and bright square: 0 for a square seen straight.
const MAX_COSINE: f64 = 0.9;
/// Maximum number of corners that are considered.
const MAX_CORNERS: usize = 4000;
/// Maximum distance of a corner from its prediction, relative to the step of the grid: for
/// predictions from known corners, and from the edges of the first one.
const REACH: (f64, f64) = (0.28, 0.4);
/// Distance from a corner at which its squares are compared, relative to the step of the grid.
const SYMMETRY_REACH: f64 = 0.4;
/// Maximum difference of opposite squares, relative to the contrast.
const MAX_ASYMMETRY: f64 = 0.35;
/// Minimum response of a corner relative to its neighbour's.
const MIN_RATIO: f64 = 0.35;
/// Maximum response beyond the rim of the board, relative to the neighbour within.
const MAX_RIM_RATIO: f64 = 0.65;
/// Maximum number of corners that grids are grown from.
const MAX_SEEDS: usize = 60;

/// A saddle point.
#[derive(Clone, Copy, Debug)]
struct Saddle {
    at: DVec2,
    response: f64,
    /// Directions of its two edges.
    edges: [DVec2; 2],
    /// Direction of its bright squares; the dark ones are across.
    bright: DVec2,
}

impl Saddle {
    /// Whether the squares in a direction and opposite to it are bright.
    fn is_bright(&self, direction: DVec2) -> bool {
        direction.dot(self.bright).abs() > direction.dot(self.bright.perp()).abs()
    }

    /// Whether `next` may be the neighbour of this corner at the other end of an edge: its squares
    /// have the opposite colours, and opposite ones are alike; at the rim
    /// of the board they are not.
    fn continues(&self, image: &GrayImage, next: &Self) -> bool {
        let reach = SYMMETRY_REACH * self.at.distance(next.at);
        let pair = |direction: DVec2| {
            let there = bilinear(image, next.at + reach * direction)?;
            Some((there, bilinear(image, next.at - reach * direction)?))
        };
        let (Some(bright), Some(dark)) = (pair(next.bright), pair(next.bright.perp())) else {
            return false;
        };
        let contrast = 0.5 * (bright.0 + bright.1 - dark.0 - dark.1);
        let is_alike = |(a, b): (f64, f64)| (a - b).abs() < MAX_ASYMMETRY * contrast;
        next.response > MIN_RATIO * self.response
            && !self.is_bright(next.bright)
            && is_alike(bright)
            && is_alike(dark)
    }
}

/// Finds the inner corners of a chessboard, row by row from the top left corner as seen from the
/// front, with the colour of the square beyond it if the board has such a corner. Of several readings,
/// the first corner is nearest to the top left of the image. `None`: not all corners are visible.
pub(super) fn find_chessboard(
    image: &GrayImage,
    [columns, rows]: [u32; 2],
    is_first_black: bool,
) -> Option<Vec<DVec2>> {
    let light: Vec<f64> = image
        .as_raw()
        .iter()
        .map(|v| f64::from(srgb_decode(*v)))
        .collect();
    for scale in SCALES_PX {
        let saddles = saddles(
            &light,
            image.width() as usize,
            image.height() as usize,
            scale,
        );
        let mut tried = vec![false; saddles.len()];
        let mut seeds = 0;
        for seed in 0..saddles.len() {
            if tried[seed] || seeds >= MAX_SEEDS {
                continue;
            }
            seeds += 1;
            let grid = grow(image, &saddles, seed);
            grid.values().for_each(|index| tried[*index] = true);
            let ordered = ordered(&grid, &saddles, [columns, rows], is_first_black);
            if let Some(corners) = ordered.and_then(|c| refined(image, &c, columns as usize)) {
                return Some(corners);
            }
        }
    }
    None
}

/// Saddle points, the strongest first.
fn saddles(light: &[f64], width: usize, height: usize, scale: i64) -> Vec<Saddle> {
    let smooth = box_mean(light, width, height, scale as usize / 2);
    let margin = 2 * scale as usize + 1;
    if width <= 2 * margin || height <= 2 * margin {
        return Vec::new();
    }
    let at = |x: usize, y: usize, dx: i64, dy: i64| {
        let index = (y as i64 + dy) * width as i64 + x as i64 + dx;
        smooth[index as usize]
    };
    // Second derivatives xx, xy, yy times the squared scale.
    let hessian = |x: usize, y: usize| {
        let s = scale;
        let middle = at(x, y, 0, 0);
        let xx = at(x, y, s, 0) - 2.0 * middle + at(x, y, -s, 0);
        let yy = at(x, y, 0, s) - 2.0 * middle + at(x, y, 0, -s);
        let xy = 0.25 * (at(x, y, s, s) + at(x, y, -s, -s) - at(x, y, s, -s) - at(x, y, -s, s));
        [xx, xy, yy]
    };
    let mut response = vec![0.0; light.len()];
    for y in margin..height - margin {
        for x in margin..width - margin {
            let [xx, xy, yy] = hessian(x, y);
            response[y * width + x] = xy * xy - xx * yy;
        }
    }
    let strongest = response.iter().copied().fold(0.0, f64::max);
    let least = (MIN_RESPONSE * strongest).max(MIN_LIGHT);
    let mut found = Vec::new();
    let reach = scale as usize + 1;
    for y in margin..height - margin {
        for x in margin..width - margin {
            let value = response[y * width + x];
            let is_maximum = value >= least
                && (y - reach..=y + reach).all(|v| {
                    (x - reach..=x + reach).all(|u| {
                        let other = response[v * width + u];
                        // Of equal ones, the first.
                        other < value || (other == value && (v, u) >= (y, x))
                    })
                });
            if let (true, Some((edges, bright))) = (is_maximum, edges(hessian(x, y))) {
                found.push(Saddle {
                    at: DVec2::new(x as f64, y as f64),
                    response: value,
                    edges,
                    bright,
                });
            }
        }
    }
    found.sort_by(|a, b| b.response.total_cmp(&a.response));
    found.truncate(MAX_CORNERS);
    found
}

/// Mean over windows of 2 r + 1 pixels.
fn box_mean(light: &[f64], width: usize, height: usize, radius: usize) -> Vec<f64> {
    let mean = |values: &[f64], count: usize, stride: usize, offset: usize, out: &mut [f64]| {
        for i in 0..count {
            let (low, high) = (i.saturating_sub(radius), (i + radius).min(count - 1));
            let sum: f64 = (low..=high).map(|k| values[offset + k * stride]).sum();
            out[offset + i * stride] = sum / (high - low + 1) as f64;
        }
    };
    let mut across = vec![0.0; light.len()];
    (0..height).for_each(|y| mean(light, width, 1, y * width, &mut across));
    let mut both = vec![0.0; light.len()];
    (0..width).for_each(|x| mean(&across, height, width, x, &mut both));
    both
}

/// Directions in which the second derivative vanishes, and that in which it is largest: light grows
/// from the corner into bright squares.
fn edges([xx, xy, yy]: [f64; 3]) -> Option<([DVec2; 2], DVec2)> {
    // q(φ) = m + a cos(2 (φ − axis)) vanishes where the cosine is −m/a.
    let (mean, amplitude) = (0.5 * (xx + yy), (0.5 * (xx - yy)).hypot(xy));
    let axis = 0.5 * xy.atan2(0.5 * (xx - yy));
    let cosine = -mean / amplitude;
    let half = 0.5 * cosine.clamp(-1.0, 1.0).acos();
    let edges = [axis - half, axis + half].map(DVec2::from_angle);
    (cosine.abs() < MAX_COSINE).then(|| (edges, DVec2::from_angle(axis)))
}

/// Grows a grid from a saddle point: indices by column and row, along its edges.
fn grow(image: &GrayImage, saddles: &[Saddle], seed: usize) -> BTreeMap<[i32; 2], usize> {
    let mut grid = BTreeMap::from([([0, 0], seed)]);
    let start = &saddles[seed];
    let mut queue = VecDeque::new();
    for (axis, edge) in start.edges.into_iter().enumerate() {
        for sign in [1, -1] {
            if let Some(next) = along(image, saddles, seed, edge * f64::from(sign)) {
                let mut cell = [0, 0];
                cell[axis] = sign;
                grid.insert(cell, next);
                queue.push_back(cell);
            }
        }
    }
    while let Some(cell) = queue.pop_front() {
        for step in [[1, 0], [-1, 0], [0, 1], [0, -1]] {
            let next = [cell[0] + step[0], cell[1] + step[1]];
            if grid.contains_key(&next) || grid.len() > MAX_CORNERS {
                continue;
            }
            let Some((expected, reach)) = prediction(&grid, saddles, cell, step) else {
                continue;
            };
            let from = grid[&cell];
            let found = nearest(saddles, expected, reach)
                .filter(|index| saddles[from].continues(image, &saddles[*index]))
                .filter(|index| !grid.values().any(|known| known == index));
            if let Some(found) = found {
                grid.insert(next, found);
                queue.push_back(next);
            }
        }
    }
    grid
}

/// The nearest corner along an edge of the first one.
fn along(image: &GrayImage, saddles: &[Saddle], from: usize, edge: DVec2) -> Option<usize> {
    let start = &saddles[from];
    let candidates = (0..saddles.len()).filter(|index| {
        let off = saddles[*index].at - start.at;
        let distance = off.length();
        distance > 4.0
            && off.dot(edge) > 0.0
            && off.perp_dot(edge).abs() < 0.5 * REACH.1 * distance
            && start.continues(image, &saddles[*index])
    });
    candidates.min_by(|a, b| {
        let distance = |index: usize| saddles[index].at.distance_squared(start.at);
        distance(*a).total_cmp(&distance(*b))
    })
}

/// Expected position beyond `cell` in direction `step`, and the distance within which it may be: from
/// the corners before it, else from a parallel edge.
fn prediction(
    grid: &BTreeMap<[i32; 2], usize>,
    saddles: &[Saddle],
    cell: [i32; 2],
    [dx, dy]: [i32; 2],
) -> Option<(DVec2, f64)> {
    let at = |x: i32, y: i32| Some(saddles[*grid.get(&[cell[0] + x, cell[1] + y])?].at);
    let here = at(0, 0)?;
    let straight = || Some(here - at(-dx, -dy)?);
    let parallel = |sx: i32, sy: i32| Some(at(sx + dx, sy + dy)? - at(sx, sy)?);
    let step = parallel(dy, dx)
        .or_else(|| parallel(-dy, -dx))
        .or_else(straight)?;
    Some((here + step, REACH.0 * step.length()))
}

fn nearest(saddles: &[Saddle], at: DVec2, reach: f64) -> Option<usize> {
    let distance = |index: usize| saddles[index].at.distance(at);
    (0..saddles.len())
        .filter(|index| distance(*index) < reach)
        .min_by(|a, b| distance(*a).total_cmp(&distance(*b)))
}

/// Lowest column and row of the part of a grid with `size` columns and rows that is complete and
/// whose neighbours outside are much weaker: junctions of squares and background.
fn part_of(
    grid: &BTreeMap<[i32; 2], usize>,
    saddles: &[Saddle],
    [columns, rows]: [i32; 2],
) -> Option<[i32; 2]> {
    let response = |x: i32, y: i32| Some(saddles[*grid.get(&[x, y])?].response);
    grid.keys().copied().find(|[left, top]| {
        let (right, bottom) = (left + columns - 1, top + rows - 1);
        let is_weak = |inside: (i32, i32), outside: (i32, i32)| {
            let (a, b) = (response(inside.0, inside.1), response(outside.0, outside.1));
            b.is_none() || a.zip(b).is_some_and(|(a, b)| b < MAX_RIM_RATIO * a)
        };
        let is_complete =
            (*left..=right).all(|x| (*top..=bottom).all(|y| grid.contains_key(&[x, y])));
        is_complete
            && (*left..=right)
                .all(|x| is_weak((x, *top), (x, top - 1)) && is_weak((x, bottom), (x, bottom + 1)))
            && (*top..=bottom)
                .all(|y| is_weak((*left, y), (left - 1, y)) && is_weak((right, y), (right + 1, y)))
    })
}

/// The corners of a grid in the order of the board.
fn ordered(
    grid: &BTreeMap<[i32; 2], usize>,
    saddles: &[Saddle],
    [columns, rows]: [u32; 2],
    is_first_black: bool,
) -> Option<Vec<DVec2>> {
    let wanted = [i64::from(columns), i64::from(rows)];
    let (columns, rows) = (i32::try_from(columns).ok()?, i32::try_from(rows).ok()?);
    let along = part_of(grid, saddles, [columns, rows]).map(|first| (first, wanted));
    let across = || part_of(grid, saddles, [rows, columns]).map(|f| (f, [wanted[1], wanted[0]]));
    let ([left, top], size) = along.or_else(across)?;
    let at = |x: i64, y: i64| {
        let cell = [left + x as i32, top + y as i32];
        grid.get(&cell).map(|index| &saddles[*index])
    };
    let mut best: Option<(bool, f64, Vec<DVec2>)> = None;
    for turn in 0..8 {
        let (swap, flip_x, flip_y) = (turn & 1 == 1, turn & 2 == 2, turn & 4 == 4);
        let turned = if swap { [size[1], size[0]] } else { size };
        if turned != wanted {
            continue;
        }
        let cell = |column: i64, row: i64| {
            let column = if flip_x {
                wanted[0] - 1 - column
            } else {
                column
            };
            let row = if flip_y { wanted[1] - 1 - row } else { row };
            if swap {
                at(row, column)
            } else {
                at(column, row)
            }
        };
        let (first, right, below) = (cell(0, 0)?, cell(1, 0)?, cell(0, 1)?);
        let (x, y) = (right.at - first.at, below.at - first.at);
        // Seen from the front, x to the right and y down turn clockwise.
        let is_front = x.perp_dot(y) > 0.0;
        if !is_front {
            continue;
        }
        let is_black = !first.is_bright(x.normalize_or_zero() + y.normalize_or_zero());
        let (is_other, distance) = (is_black != is_first_black, first.at.x + first.at.y);
        let is_better = |(other, d, _): &(bool, f64, _)| (is_other, distance) < (*other, *d);
        if best.as_ref().is_none_or(is_better) {
            let corners: Option<Vec<DVec2>> = (0..wanted[1])
                .flat_map(|row| (0..wanted[0]).map(move |column| (column, row)))
                .map(|(column, row)| Some(cell(column, row)?.at))
                .collect();
            best = Some((is_other, distance, corners?));
        }
    }
    best.map(|(_, _, corners)| corners)
}

/// Refines the corners; `None` if one of them is no saddle point between black and white squares.
fn refined(image: &GrayImage, corners: &[DVec2], columns: usize) -> Option<Vec<DVec2>> {
    let rows = corners.len() / columns;
    let at = |column: usize, row: usize| corners[row * columns + column];
    let mut result = Vec::with_capacity(corners.len());
    for row in 0..rows {
        for column in 0..columns {
            let here = at(column, row);
            // Steps to the right and down, mirrored at the last column and row.
            let x = if column + 1 < columns {
                at(column + 1, row) - here
            } else {
                here - at(column - 1, row)
            };
            let y = if row + 1 < rows {
                at(column, row + 1) - here
            } else {
                here - at(column, row - 1)
            };
            let falling = [here + 0.3 * (x + y), here - 0.3 * (x + y)];
            let rising = [here + 0.3 * (x - y), here - 0.3 * (x - y)];
            let free_px = 0.7 * x.length().min(y.length());
            let expected = |white: [DVec2; 2], black: [DVec2; 2]| ExpectedSaddle {
                pixel: here,
                white,
                black,
                free_px,
            };
            let corner = refine_saddle(image, &expected(falling, rising))
                .or_else(|| refine_saddle(image, &expected(rising, falling)))?;
            result.push(corner);
        }
    }
    Some(result)
}
