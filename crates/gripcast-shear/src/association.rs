//! Which dot of an image is which gel marker.
//!
//! Dots move by less than half a pitch between two frames, but not all alike. The most common
//! motion comes first; then gel markers are assigned in the order of their certainty, each predicted from
//! neighbours that are assigned already.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use crate::dots::{Dot, distance};
use crate::lattice::median;

/// Cells of a pitch in the search for the common motion.
const VOTE_CELLS: f32 = 12.0;
/// Maximum motion between two frames, pitches; a little more than the half that is told apart.
const MAX_MOTION: f32 = 0.65;
/// Weight that a vote loses for the motion of a pitch: of motions that differ by a pitch, the
/// smaller is the likelier one.
const VOTE_LOSS: f32 = 1.5;
/// Gel markers below which a fraction of them says little.
const MIN_VOTERS: usize = 6;
/// Maximum distance of a dot from its prediction, pitches.
const MAX_PREDICTION_ERROR: f32 = 0.35;
/// Maximum difference of a displacement from the median of its neighbours, pitches.
const MAX_JUMP: f32 = 0.4;

/// A gel marker in the frame before.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Known {
    pub(crate) rest: [f32; 2],
    pub(crate) position: [f32; 2],
}

/// The lattice of gel markers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Grid {
    pub(crate) columns: usize,
    pub(crate) rows: usize,
    /// Shorter distance of neighbours, px.
    pub(crate) pitch: f32,
    /// Width and height of the image, px.
    pub(crate) size: [u32; 2],
}

impl Grid {
    /// Indices of the up to eight neighbours of a lattice point.
    pub(crate) fn neighbours(self, at: usize) -> impl Iterator<Item = usize> {
        let (column, row) = (at % self.columns, at / self.columns);
        let rows = row.saturating_sub(1)..(row + 2).min(self.rows);
        let columns = column.saturating_sub(1)..(column + 2).min(self.columns);
        rows.flat_map(move |r| columns.clone().map(move |c| r * self.columns + c))
            .filter(move |other| *other != at)
    }
}

/// Returns the index of the dot of each gel marker; `None` for lost ones.
pub(crate) fn associate(grid: Grid, known: &[Option<Known>], dots: &[Dot]) -> Vec<Option<usize>> {
    let mut found = grow(grid, known, dots, common_motion(grid, known, dots));
    drop_jumps(grid, known, dots, &mut found);
    found
}

/// The motion between two frames that most gel markers could have.
fn common_motion(grid: Grid, known: &[Option<Known>], dots: &[Dot]) -> [f32; 2] {
    let cell = grid.pitch / VOTE_CELLS;
    let half = (MAX_MOTION * VOTE_CELLS).ceil() as i32 + 1;
    let side = (2 * half + 1) as usize;
    let mut votes = vec![0.0_f32; side * side];
    let motions = |visit: &mut dyn FnMut([f32; 2])| {
        for marker in known.iter().flatten() {
            for dot in dots {
                let motion = [0, 1].map(|a| dot.position[a] - marker.position[a]);
                if motion[0].hypot(motion[1]) <= MAX_MOTION * grid.pitch {
                    visit(motion);
                }
            }
        }
    };
    motions(&mut |motion| {
        let [column, row] = motion.map(|m| (m / cell).round() as i32 + half);
        let weight = 1.0 - VOTE_LOSS * motion[0].hypot(motion[1]) / grid.pitch;
        // The cells around get a vote, too: motions differ.
        for (dy, dx) in (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dy, dx))) {
            let at = (row + dy) * side as i32 + column + dx;
            if let Some(vote) = usize::try_from(at).ok().and_then(|at| votes.get_mut(at)) {
                *vote += weight;
            }
        }
    });
    let motion_of = |at: usize| [at % side, at / side].map(|i| (i as i32 - half) as f32 * cell);
    // Of the gel markers that would be inside the image, the fraction that finds a dot: a motion
    // that moves known gel markers out of the image is no worse than one that does not.
    let score = |at: usize, votes: f32| {
        let motion = motion_of(at);
        let is_inside = |marker: &&Known| {
            (0..2).all(|a| (0.0..grid.size[a] as f32).contains(&(marker.position[a] + motion[a])))
        };
        let inside = known.iter().flatten().filter(is_inside).count();
        votes / inside.max(MIN_VOTERS) as f32
    };
    let scores = votes.iter().enumerate().filter(|(_, votes)| **votes > 0.0);
    let scores = scores.map(|(at, votes)| (at, score(at, *votes)));
    let Some((best, _)) = scores.max_by(|a, b| a.1.total_cmp(&b.1)) else {
        return [0.0; 2];
    };
    let peak = motion_of(best);
    let mut near: [Vec<f32>; 2] = Default::default();
    motions(&mut |motion| {
        if distance(motion, peak) <= 2.0 * cell {
            near[0].push(motion[0]);
            near[1].push(motion[1]);
        }
    });
    let [x, y] = near.map(median);
    [x.unwrap_or(0.0), y.unwrap_or(0.0)]
}

/// A possible assignment; the nearest to its prediction comes first.
#[derive(PartialEq)]
struct Candidate {
    error: f32,
    marker: usize,
    dot: usize,
}

impl Eq for Candidate {}

impl PartialOrd for Candidate {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Candidate {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        let errors = self.error.total_cmp(&other.error);
        errors.then(self.marker.cmp(&other.marker))
    }
}

/// Assigns the most certain gel marker, predicts its neighbours from it, and so on.
fn grow(grid: Grid, known: &[Option<Known>], dots: &[Dot], common: [f32; 2]) -> Vec<Option<usize>> {
    let mut found: Vec<Option<usize>> = vec![None; known.len()];
    let mut is_taken = vec![false; dots.len()];
    let motion = |found: &[Option<usize>], at: usize| {
        let (dot, marker) = (dots.get(found[at]?)?, known[at]?);
        Some([0, 1].map(|a| dot.position[a] - marker.position[a]))
    };
    let candidate = |found: &[Option<usize>], is_taken: &[bool], marker: usize| {
        let known = known[marker]?;
        let mut predicted = common;
        let motions = grid
            .neighbours(marker)
            .filter_map(|other| motion(found, other));
        let (mut sum, mut count) = ([0.0; 2], 0.0);
        for motion in motions {
            sum = [sum[0] + motion[0], sum[1] + motion[1]];
            count += 1.0;
        }
        if count > 0.0 {
            predicted = sum.map(|s| s / count);
        }
        let expected = [0, 1].map(|a| known.position[a] + predicted[a]);
        let free = dots.iter().enumerate().filter(|(dot, _)| !is_taken[*dot]);
        let errors = free.map(|(dot, at)| (distance(at.position, expected), dot));
        let (error, dot) = errors.min_by(|a, b| a.0.total_cmp(&b.0))?;
        let is_near = error <= MAX_PREDICTION_ERROR * grid.pitch;
        is_near.then_some(Candidate { error, marker, dot })
    };
    let mut open: BinaryHeap<Reverse<Candidate>> = (0..known.len())
        .filter_map(|marker| candidate(&found, &is_taken, marker).map(Reverse))
        .collect();
    while let Some(Reverse(best)) = open.pop() {
        if found[best.marker].is_some() {
            continue;
        }
        // Neighbours that were assigned since may have changed the prediction.
        let Some(now) = candidate(&found, &is_taken, best.marker) else {
            continue;
        };
        if now != best {
            open.push(Reverse(now));
            continue;
        }
        found[best.marker] = Some(best.dot);
        is_taken[best.dot] = true;
        for other in grid.neighbours(best.marker) {
            if found[other].is_none() {
                open.extend(candidate(&found, &is_taken, other).map(Reverse));
            }
        }
    }
    found
}

/// Gives up gel markers whose displacement is not that of their neighbours: skin does not tear.
fn drop_jumps(grid: Grid, known: &[Option<Known>], dots: &[Dot], found: &mut [Option<usize>]) {
    let displacements: Vec<Option<[f32; 2]>> = found
        .iter()
        .zip(known)
        .map(|(dot, known)| {
            let (dot, known) = (dots.get((*dot)?)?, (*known)?);
            Some([0, 1].map(|a| dot.position[a] - known.rest[a]))
        })
        .collect();
    for (at, displacement) in displacements.iter().enumerate() {
        let Some(displacement) = displacement else {
            continue;
        };
        let around: Vec<[f32; 2]> = grid
            .neighbours(at)
            .filter_map(|i| displacements[i])
            .collect();
        let component = |a: usize| median(around.iter().map(|d| d[a]).collect());
        if let (Some(x), Some(y)) = (component(0), component(1))
            && distance(*displacement, [x, y]) > MAX_JUMP * grid.pitch
        {
            found[at] = None;
        }
    }
}
