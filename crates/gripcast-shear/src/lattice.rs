//! The lattice of a gel's dots, from the image of the untouched gel.

use std::collections::{BTreeMap, BTreeSet};

use gripcast_base::linear::NormalEquations;

use crate::darkness::Brightness;
use crate::dots::{Dot, DotFilter, distance};

/// Diameters of dots that are tried, px.
const DIAMETERS: [f32; 8] = [2.0, 3.0, 4.2, 6.0, 8.5, 12.0, 16.0, 21.0];
/// Minimum darkness of a dot when nothing is known, twice the threshold.
const UNKNOWN_DEPTH: f32 = 0.3;
/// Minimum distance of two dots, diameters.
const MIN_PITCH_DIAMETERS: f32 = 1.5;
/// Maximum dots: more are noise.
const MAX_DOTS: usize = 2500;
/// Minimum dots of a lattice.
const MIN_DOTS: usize = 9;
/// Minimum fraction of the lattice points with a dot.
const MIN_OCCUPIED: f32 = 0.5;
/// Minimum fraction of all dots that are on the lattice.
const MIN_ON_LATTICE: f32 = 0.6;
/// Maximum distance of a dot from where its neighbours expect it, pitches.
const MAX_OFFSET: f32 = 0.3;
/// Maximum root mean square distance of the dots from a smooth lattice, pitches.
const MAX_RESIDUAL: f32 = 0.3;
/// Distance of a displaced dot from the smooth lattice, pitches.
const DISPLACED: f32 = 0.1;
/// Fraction of displaced dots from which something deforms the gel; torn dots are fewer.
const DEFORMED: f32 = 0.06;
/// Maximum tilt, as the tangent: beyond, columns and rows could be confused.
const MAX_TILT: f32 = 0.5;

/// Dots of the untouched gel on their lattice.
#[derive(Clone, Debug)]
pub(crate) struct Lattice {
    pub(crate) columns: usize,
    pub(crate) rows: usize,
    /// Row-major.
    pub(crate) dots: Vec<Option<Dot>>,
    /// Steps to the next column and to the next row, px.
    pub(crate) steps: [[f32; 2]; 2],
    /// What the dots look like.
    pub(crate) filter: DotFilter,
    /// Whether the dots are not where they are on a gel that nothing touches.
    pub(crate) is_deformed: bool,
}

impl Lattice {
    /// Finds the lattice of an image; `None` for a gel without markers.
    pub(crate) fn find(brightness: &Brightness) -> Option<Self> {
        let longest = brightness.width.min(brightness.height) as f32;
        let coarse = DIAMETERS.iter().filter(|d| 6.0 * **d < longest);
        let coarse = coarse.filter_map(|diameter| {
            let filter = DotFilter {
                diameter: *diameter,
                background: 3.0 * diameter,
                distance: MIN_PITCH_DIAMETERS * diameter,
                depth: UNKNOWN_DEPTH,
            };
            Self::of_dots(filter.find(brightness), filter)
        });
        let score = |lattice: &Self| lattice.present().map(|dot| dot.depth).sum::<f32>();
        let mut lattice = coarse.max_by(|a, b| score(a).total_cmp(&score(b)))?;
        // Twice, because the size of the dots depends on their darkness and the reverse.
        for _ in 0..2 {
            let filter = lattice.measured_filter();
            lattice = Self::of_dots(filter.find(brightness), filter)?;
        }
        Some(lattice)
    }

    pub(crate) fn present(&self) -> impl Iterator<Item = &Dot> {
        self.dots.iter().flatten()
    }

    /// Pitch: the shorter one of both steps, px.
    pub(crate) fn pitch(&self) -> f32 {
        let length = |step: [f32; 2]| step[0].hypot(step[1]);
        length(self.steps[0]).min(length(self.steps[1]))
    }

    fn measured_filter(&self) -> DotFilter {
        let whole: Vec<&Dot> = self.present().filter(|dot| dot.visible >= 1.0).collect();
        let median = |value: fn(&Dot) -> f32| median(whole.iter().map(|dot| value(dot)).collect());
        let pitch = self.pitch();
        let area = median(|dot| dot.area).unwrap_or(1.0);
        let diameter = (4.0 * area / std::f32::consts::PI).sqrt();
        DotFilter {
            diameter: diameter.clamp(1.5, 0.75 * pitch),
            background: pitch,
            distance: 0.6 * pitch,
            depth: median(|dot| dot.depth).unwrap_or(UNKNOWN_DEPTH),
        }
    }

    /// Arranges dots on a lattice.
    fn of_dots(dots: Vec<Dot>, filter: DotFilter) -> Option<Self> {
        if !(MIN_DOTS..=MAX_DOTS).contains(&dots.len()) {
            return None;
        }
        let steps = common_steps(&dots)?;
        let indices = largest_component(&dots, steps);
        let range = |axis: usize| {
            let values = indices.values().map(|index| index[axis]);
            Some((values.clone().min()?, values.max()?))
        };
        let ((left, right), (top, bottom)) = (range(0)?, range(1)?);
        let columns = (right - left + 1) as usize;
        let rows = (bottom - top + 1) as usize;
        let occupied = indices.len() as f32 / (columns * rows) as f32;
        let on_lattice = indices.len() as f32 / dots.len() as f32;
        if indices.len() < MIN_DOTS
            || columns.min(rows) < 2
            || occupied < MIN_OCCUPIED
            || on_lattice < MIN_ON_LATTICE
        {
            return None;
        }
        let residuals = residuals(&dots, &indices)?;
        let pitch = step_length(steps);
        let squares = residuals.iter().map(|r| r * r).sum::<f32>();
        if (squares / residuals.len() as f32).sqrt() > MAX_RESIDUAL * pitch {
            return None;
        }
        let displaced = residuals.iter().filter(|r| **r > DISPLACED * pitch).count();
        let mut placed = vec![None; columns * rows];
        for (dot, [column, row]) in indices {
            let at = (row - top) as usize * columns + (column - left) as usize;
            placed[at] = Some(dots[dot]);
        }
        Some(Self {
            columns,
            rows,
            dots: placed,
            steps,
            filter,
            is_deformed: displaced as f32 > DEFORMED * residuals.len() as f32,
        })
    }
}

fn step_length(steps: [[f32; 2]; 2]) -> f32 {
    steps
        .map(|step| step[0].hypot(step[1]))
        .into_iter()
        .fold(f32::INFINITY, f32::min)
}

/// Median; `None` for no values.
pub(crate) fn median(mut values: Vec<f32>) -> Option<f32> {
    let middle = values.len().checked_sub(1)? / 2;
    Some(*values.select_nth_unstable_by(middle, f32::total_cmp).1)
}

/// Steps to the right and down that most dots have to their nearest neighbour there.
fn common_steps(dots: &[Dot]) -> Option<[[f32; 2]; 2]> {
    let nearest = |from: &Dot, axis: usize| {
        let steps = dots
            .iter()
            .map(|to| [0, 1].map(|a| to.position[a] - from.position[a]));
        let ahead =
            steps.filter(|step| step[axis] > 0.0 && step[1 - axis].abs() < MAX_TILT * step[axis]);
        ahead.min_by(|a, b| a[axis].total_cmp(&b[axis]))
    };
    let step = |axis: usize| {
        let steps: Vec<[f32; 2]> = dots.iter().filter_map(|dot| nearest(dot, axis)).collect();
        let component = |a: usize| median(steps.iter().map(|step| step[a]).collect());
        Some([component(0)?, component(1)?])
    };
    Some([step(0)?, step(1)?])
}

/// Column and row of the dots of the largest connected part, relative to any of them.
fn largest_component(dots: &[Dot], steps: [[f32; 2]; 2]) -> BTreeMap<usize, [i32; 2]> {
    let mut best = BTreeMap::new();
    let mut is_visited = vec![false; dots.len()];
    for seed in 0..dots.len() {
        if is_visited[seed] || dots.len() - seed <= best.len() {
            continue;
        }
        let component = component(dots, steps, seed);
        for dot in component.keys() {
            is_visited[*dot] = true;
        }
        if component.len() > best.len() {
            best = component;
        }
    }
    best
}

/// A dot that could be the neighbour of another one.
struct Neighbour {
    /// Distance from where it is expected, px.
    error: f32,
    dot: usize,
    index: [i32; 2],
    steps: [[f32; 2]; 2],
}

/// Grows a part of the lattice from a dot, the most regular neighbours first. Each dot expects its
/// neighbours at the steps that led to it, so that the lattice may be curved.
fn component(dots: &[Dot], steps: [[f32; 2]; 2], seed: usize) -> BTreeMap<usize, [i32; 2]> {
    let max_offset = MAX_OFFSET * step_length(steps);
    let mut placed = BTreeMap::new();
    let mut taken = BTreeSet::new();
    let mut open = vec![Neighbour {
        error: 0.0,
        dot: seed,
        index: [0, 0],
        steps,
    }];
    loop {
        open.retain(|n| !placed.contains_key(&n.dot) && !taken.contains(&n.index));
        let best = open
            .iter()
            .enumerate()
            .min_by(|a, b| a.1.error.total_cmp(&b.1.error));
        let Some((best, _)) = best else {
            return placed;
        };
        let Neighbour {
            dot, index, steps, ..
        } = open.swap_remove(best);
        placed.insert(dot, index);
        taken.insert(index);
        for (axis, sign) in [(0, 1), (0, -1), (1, 1), (1, -1)] {
            let mut index = index;
            index[axis] += sign;
            if taken.contains(&index) {
                continue;
            }
            let from = dots[dot].position;
            let step = steps[axis].map(|s| sign as f32 * s);
            let expected = [0, 1].map(|a| from[a] + step[a]);
            let errors = dots.iter().map(|dot| distance(dot.position, expected));
            let nearest = errors.enumerate().min_by(|a, b| a.1.total_cmp(&b.1));
            if let Some((dot, error)) = nearest
                && error <= max_offset
            {
                let mut steps = steps;
                let found = [0, 1].map(|a| sign as f32 * (dots[dot].position[a] - from[a]));
                steps[axis] = [0, 1].map(|a| 0.5 * (steps[axis][a] + found[a]));
                open.push(Neighbour {
                    error,
                    dot,
                    index,
                    steps,
                });
            }
        }
    }
}

/// Distances of the dots from a lattice with the distortion of a lens, px.
fn residuals(dots: &[Dot], indices: &BTreeMap<usize, [i32; 2]>) -> Option<Vec<f32>> {
    let terms = |[column, row]: [i32; 2]| {
        let [c, r] = [column, row].map(|i| f64::from(i) / 10.0);
        let square = c * c + r * r;
        [1.0, c, r, c * c, c * r, r * r, square * c, square * r]
    };
    let mut squares = vec![0.0; indices.len()];
    for axis in 0..2 {
        let mut system = NormalEquations::<8>::zero();
        for (i, row) in system.matrix.iter_mut().enumerate() {
            row[i] = 1e-9;
        }
        for (dot, index) in indices {
            let position = f64::from(dots[*dot].position[axis]);
            system.add(&terms(*index), position, 1.0);
        }
        let solution = system.solve()?;
        for (square, (dot, index)) in squares.iter_mut().zip(indices) {
            let terms = terms(*index);
            let fitted = terms.iter().zip(&solution).map(|(t, s)| t * s);
            *square += (f64::from(dots[*dot].position[axis]) - fitted.sum::<f64>()).powi(2);
        }
    }
    Some(
        squares
            .into_iter()
            .map(|square| square.sqrt() as f32)
            .collect(),
    )
}
