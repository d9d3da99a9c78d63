//! The change of a gel between two images: contact or illumination.
//!
//! Lamps, exposure and white balance change an image smoothly: level' = gain · level + offset, where
//! gain and offset are quadratic functions of the position. This field is fitted robustly and
//! removed. What remains, relative to its surroundings, is local structure: the edges and slopes
//! of a contact. A large, smooth contact is part of the field, but tilts the colours in opposite
//! directions, which no change of light does. A field that differs strongly over the gel is fitted less well, so it raises the
//! level from which structure counts; so do camera noise and markers, whose edges move with every
//! relaxation of the gel.

use gripcast_base::linear::NormalEquations;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::cells::{CELLS, COLUMNS, GelCells, ROWS, local_mean, quantile};
use super::view::ViewProblem;

/// Minimum fraction of the cells with contact structure for a contact, 0 to 1. The smallest
/// available press, of a 4 mm ball on a GelSight Mini, has 0.05.
pub const MIN_CONTACT_FRACTION: f64 = 0.005;

/// Minimum level of contact structure, grey levels: above any camera noise in the mean of a cell.
const MIN_STRUCTURE_LEVELS: f32 = 3.0;
/// Minimum structure, standard deviations of a cell's noise.
const STRUCTURE_DEVIATIONS: f32 = 6.0;
/// Structure expected of an illumination field, fraction of its uneven part. Backgrounds of two
/// different sensors, with an uneven part of 4 to 18 levels, stay below it.
const UNEVEN_FRACTION: f32 = 1.0;
/// Minimum texture of a gel with markers, grey levels. Gels without have 0.5 to 0.9, with 14 to 21.
const MARKER_LEVELS: f32 = 4.0;
/// Structure expected of markers that are where they were, fraction of their texture.
const MARKER_FRACTION: f32 = 0.2;
/// Minimum gradients of the colours, from the middle to the edge of the gel and relative to their
/// mean, in the direction in which they are smaller, for a large contact, grey levels. Real
/// sensors differ by more only where the other direction has at least 2.7 times as much.
const MIN_TILT_LEVELS: f64 = 15.0;
/// Minimum ratio of the gradients of both directions for a large contact. Lamps that stand around
/// the gel tilt the colours about equally in all directions.
const MIN_TILT_RATIO: f64 = 0.6;
/// Minimum correlation of the texture of the same gel with markers. Of real grasps 1 % are below,
/// of pairs of two gels 9 in 10.
const MIN_TEXTURE_CORRELATION: f32 = 0.4;
/// Minimum illumination change that is reported, grey levels: above the smooth effects of a
/// relaxing gel.
const MIN_ILLUMINATION_LEVELS: f32 = 2.5;
/// Minimum change since the reference of its own gel for swapped sensors, grey levels. The
/// backgrounds of two real sensors differ by 7 to 97.
const MIN_SWAPPED_LEVELS: f64 = 5.0;
/// Maximum ratio of the changes since the other gel's reference and since its own.
const MAX_SWAPPED_RATIO: f64 = 0.5;
/// Radius of the surroundings that structure is relative to, cells.
const SURROUNDINGS: usize = 4;
/// Levels of cells that are compared: others are clipped somewhere.
const COMPARABLE: std::ops::RangeInclusive<f32> = 3.0..=250.0;
/// Minimum fraction of comparable cells.
const MIN_COMPARABLE: f32 = 0.25;
/// Iterations of the robust fit.
const ITERATIONS: usize = 6;
/// Minimum deviation assumed by the robust fit, grey levels.
const MIN_DEVIATION: f32 = 0.6;
/// Terms of the field: gain and offset, each 1, x, y, x², xy, y².
const TERMS: usize = 12;

/// The change of a gel since its initial image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GelChange {
    /// Fraction of the gel with contact structure, 0 to 1.
    pub contact_fraction: f64,
    /// Root mean square of the illumination change, grey levels.
    pub illumination_levels: f64,
    /// Whether the images show two different gels: the markers of one are not those of the other.
    pub is_other_gel: bool,
    /// Why the images are not as a GelSight Mini sends them, if so.
    pub view_problem: Option<ViewProblem>,
}

/// What changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ChangeKind {
    /// Nothing beyond noise.
    Unchanged,
    /// Something presses on the gel.
    Contact,
    /// The light, the exposure or the white balance changed, and nothing presses visibly.
    Illumination,
    /// The images show two different gels.
    OtherGel,
}

impl GelChange {
    /// Compares an image with the initial one; `noise_levels` is the noise of a cell of the gel
    /// (see [`GelState::noise_levels`](super::GelState)), 0 if unknown.
    #[must_use]
    pub fn between(initial: &GelCells, now: &GelCells, noise_levels: f32) -> Self {
        let comparable: Vec<bool> = (0..CELLS).map(|i| is_comparable(initial, now, i)).collect();
        let count = comparable.iter().filter(|c| **c).count();
        if (count as f32) < MIN_COMPARABLE * CELLS as f32 {
            return Self::incomparable(initial, now);
        }
        let fields: [Field; 3] =
            std::array::from_fn(|c| Field::fit(&initial.levels[c], &now.levels[c], &comparable));
        let rms = |square: fn(&Field) -> f32| {
            let sum: f32 = fields.iter().map(square).sum();
            (sum / (3 * count) as f32).sqrt()
        };
        let uneven_levels = rms(|field| field.uneven_squares);
        let markers = initial.covering_texture();
        let marker_levels = match markers > MARKER_LEVELS {
            true => MARKER_FRACTION * markers,
            false => 0.0,
        };
        let noise = MIN_STRUCTURE_LEVELS.max(STRUCTURE_DEVIATIONS * noise_levels) + marker_levels;
        let (evidence, threshold) = match is_tilted(fields.each_ref().map(|f| f.gradient)) {
            true => (fields.each_ref().map(|field| field.changes.clone()), noise),
            false => (
                fields.each_ref().map(Field::structure),
                noise + UNEVEN_FRACTION * uneven_levels,
            ),
        };
        let in_contact = (0..CELLS)
            .filter(|i| evidence.iter().any(|channel| channel[*i].abs() > threshold))
            .count();
        Self {
            contact_fraction: in_contact as f64 / CELLS as f64,
            illumination_levels: f64::from(rms(|field| field.squares)),
            is_other_gel: markers.max(now.covering_texture()) > MARKER_LEVELS
                && initial.texture_correlation(now) < MIN_TEXTURE_CORRELATION,
            view_problem: ViewProblem::of(initial, now),
        }
    }

    /// What changed, where a contact covers at least `min_contact_fraction`, 0 to 1.
    #[must_use]
    pub fn kind(&self, min_contact_fraction: f64) -> ChangeKind {
        if self.is_other_gel {
            ChangeKind::OtherGel
        } else if self.contact_fraction >= min_contact_fraction {
            ChangeKind::Contact
        } else if self.contact_fraction < MIN_CONTACT_FRACTION
            && self.illumination_levels > f64::from(MIN_ILLUMINATION_LEVELS)
        {
            ChangeKind::Illumination
        } else {
            ChangeKind::Unchanged
        }
    }

    /// Whether an image is of the other gel, given its change since the reference of its own gel and
    /// since that of the other one.
    #[must_use]
    pub fn is_swapped(own: &Self, other: &Self) -> bool {
        let (own_levels, other_levels) = (own.illumination_levels, other.illumination_levels);
        match (own.is_other_gel, other.is_other_gel) {
            (true, false) => true,
            (false, true) => false,
            _ => own_levels > MIN_SWAPPED_LEVELS && other_levels < MAX_SWAPPED_RATIO * own_levels,
        }
    }

    /// The change of a gel that is black or white in one of the images: nothing can be told but the
    /// change of level.
    fn incomparable(initial: &GelCells, now: &GelCells) -> Self {
        let squares = initial.mean_levels().into_iter().zip(now.mean_levels());
        let squares = squares.map(|(a, b)| f64::from(b - a).powi(2));
        Self {
            contact_fraction: 0.0,
            illumination_levels: (squares.sum::<f64>() / 3.0).sqrt(),
            is_other_gel: false,
            view_problem: ViewProblem::of(initial, now),
        }
    }
}

fn is_comparable(initial: &GelCells, now: &GelCells, i: usize) -> bool {
    (0..3).all(|c| {
        COMPARABLE.contains(&initial.levels[c][i]) && COMPARABLE.contains(&now.levels[c][i])
    })
}

/// Returns whether the colours are tilted in opposite directions, as by the slopes of a large
/// contact; gradients of red, green and blue.
fn is_tilted(gradients: [[f64; 2]; 3]) -> bool {
    let mean = [0, 1].map(|axis| gradients.iter().map(|g| g[axis]).sum::<f64>() / 3.0);
    let sum = |a: usize, b: usize| -> f64 {
        let products = gradients
            .iter()
            .map(|g| (g[a] - mean[a]) * (g[b] - mean[b]));
        products.sum()
    };
    // Singular values of the gradients: the square roots of the eigenvalues of this matrix.
    let (xx, xy, yy) = (sum(0, 0), sum(0, 1), sum(1, 1));
    let root = (0.25 * (xx - yy).powi(2) + xy * xy).sqrt();
    let middle = 0.5 * (xx + yy);
    let [smaller, larger] = [middle - root, middle + root].map(|square| square.max(0.0).sqrt());
    smaller > MIN_TILT_LEVELS && smaller > MIN_TILT_RATIO * larger
}

/// The illumination field of one channel.
struct Field {
    /// Change of each cell, grey levels; 0 where cells cannot be compared.
    changes: Vec<f32>,
    /// Gradient of the field across and down, from the middle to the edge, grey levels.
    gradient: [f64; 2],
    /// Change that the field does not explain, by cell; 0 where cells cannot be compared.
    residuals: Vec<f32>,
    /// Sum of the squares of the field's change.
    squares: f32,
    /// Sum of the squares of what a gain and an offset of the whole gel do not explain of it.
    uneven_squares: f32,
}

impl Field {
    fn fit(initial: &[f32], now: &[f32], comparable: &[bool]) -> Self {
        let cells: Vec<usize> = (0..CELLS).filter(|i| comparable[*i]).collect();
        let rows: Vec<[f64; TERMS]> = cells.iter().map(|i| terms(*i, initial[*i])).collect();
        let changes: Vec<f32> = cells.iter().map(|i| now[*i] - initial[*i]).collect();
        let mut explained = vec![0.0_f32; cells.len()];
        let mut scale = f32::INFINITY;
        for _ in 0..ITERATIONS {
            let mut system = NormalEquations::<TERMS>::zero();
            // Gain and offset of an even gel are the same: the ridge keeps the system regular.
            for (i, row) in system.matrix.iter_mut().enumerate() {
                row[i] = 1e-4 * cells.len() as f64;
            }
            for ((row, change), field) in rows.iter().zip(&changes).zip(&explained) {
                let relative = (change - field) / (2.0 * scale);
                let weight = 1.0 / (1.0 + relative * relative);
                system.add(row, f64::from(*change), f64::from(weight));
            }
            let Some(solution) = system.solve() else {
                break;
            };
            let value = |row: &[f64; TERMS]| {
                row.iter().zip(&solution).map(|(a, b)| a * b).sum::<f64>() as f32
            };
            explained = rows.iter().map(value).collect();
            let residuals = changes.iter().zip(&explained).map(|(c, e)| (c - e).abs());
            let mut residuals: Vec<f32> = residuals.collect();
            let max = residuals.iter().copied().fold(0.0, f32::max);
            scale = (1.5 * quantile(&mut residuals, 0.5)).max(MIN_DEVIATION);
            if max < 2.0 * scale {
                break;
            }
        }
        let (mut residuals, mut all_changes) = (vec![0.0; CELLS], vec![0.0; CELLS]);
        let mut gradient = [0.0; 2];
        let mut squares = [f64::MIN_POSITIVE; 2];
        for ((i, change), field) in cells.iter().zip(&changes).zip(&explained) {
            residuals[*i] = change - field;
            all_changes[*i] = *change;
            for (axis, position) in position(*i).into_iter().enumerate() {
                gradient[axis] += f64::from(*field) * position;
                squares[axis] += position * position;
            }
        }
        Self {
            changes: all_changes,
            gradient: [gradient[0] / squares[0], gradient[1] / squares[1]],
            residuals,
            squares: explained.iter().map(|e| e * e).sum(),
            uneven_squares: uneven_squares(cells.iter().map(|i| initial[*i]), &explained),
        }
    }

    /// What the field does not explain, relative to its surroundings, grey levels.
    fn structure(&self) -> Vec<f32> {
        let around = local_mean(&self.residuals, [COLUMNS, ROWS], SURROUNDINGS);
        let pairs = self.residuals.iter().zip(around);
        pairs.map(|(residual, mean)| residual - mean).collect()
    }
}

/// Position of the middle of a cell, −1 to 1 from left to right and top to bottom.
fn position(cell: usize) -> [f64; 2] {
    let centred = |i: usize, count: usize| (i as f64 + 0.5) / count as f64 * 2.0 - 1.0;
    [
        centred(cell % COLUMNS, COLUMNS),
        centred(cell / COLUMNS, ROWS),
    ]
}

/// Row of the normal equations of a cell with this initial level.
fn terms(cell: usize, level: f32) -> [f64; TERMS] {
    let [x, y] = position(cell);
    let field = [1.0, x, y, x * x, x * y, y * y];
    let level = f64::from(level) / 128.0;
    std::array::from_fn(|i| match field.get(i) {
        Some(term) => *term,
        None => field[i - field.len()] * level,
    })
}

/// Sum of the squares of `changes` that no common gain and offset of `levels` explain.
fn uneven_squares(levels: impl Iterator<Item = f32> + Clone, changes: &[f32]) -> f32 {
    let mut system = NormalEquations::<2>::zero();
    system.matrix[0][0] = 1e-6;
    for (level, change) in levels.clone().zip(changes) {
        system.add(&[f64::from(level) / 128.0, 1.0], f64::from(*change), 1.0);
    }
    let [gain, offset] = system.solve().unwrap_or_default();
    let uneven = levels
        .zip(changes)
        .map(|(level, change)| change - (gain * f64::from(level) / 128.0 + offset) as f32);
    uneven.map(|u| u * u).sum()
}
