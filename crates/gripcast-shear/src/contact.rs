//! Where something touches the gel.
//!
//! The skin between the gel markers is reduced to cells. A contact changes them locally, by its edges and
//! slopes; lamps and exposure change them smoothly.

use image::RgbImage;

use crate::darkness::BoxSums;
use crate::marker::covered;

/// Columns and rows of the cells.
const GRID: [usize; 2] = [40, 30];
/// Side of the surroundings that a change is relative to, cells.
const SURROUNDINGS: usize = 11;
/// Minimum local change of a contact, grey levels: above the noise of a cell.
const MIN_CHANGE: f32 = 4.0;
/// Minimum local change of a contact, fraction of that of its steep cells (the 90th percentile): the
/// skin slopes beyond the contact, too, but less. Chosen on the simulated contacts of
/// docs/explanation/shear.md.
const SLOPE_FRACTION: f32 = 0.2;
/// Local change expected of an illumination that changes, fraction of its change.
const UNEVEN_FRACTION: f32 = 0.35;
/// Minimum fraction of the cells around a cell for their mean; with fewer, all cells count.
const MIN_SURROUNDINGS: f32 = 0.1;
/// Minimum fraction of cells without contact for the second pass.
const MIN_SKIN: f32 = 0.1;
/// Minimum fraction of the cells with a local change for a contact.
const MIN_CONTACT: f32 = 0.01;
/// Pixels around a gel marker that its colour reaches.
const HALO_PX: f32 = 2.5;
/// Minimum pixels of a cell that no gel marker covers, fraction.
const MIN_FREE: f32 = 0.3;

/// Mean colours of the skin.
#[derive(Clone, Debug)]
pub(crate) struct SkinCells {
    size: [u32; 2],
    /// Mean levels of each cell; `None` below gel markers.
    levels: Vec<Option<[f32; 3]>>,
}

impl SkinCells {
    /// Reduces an image without the discs of `diameter` around the gel markers.
    pub(crate) fn new(
        image: &RgbImage,
        markers: impl Iterator<Item = [f32; 2]>,
        diameter: f32,
    ) -> Self {
        let (width, height) = (image.width() as usize, image.height() as usize);
        let is_covered = covered([width, height], markers, 0.5 * diameter + HALO_PX);
        let cell_of: Vec<usize> = (0..width).map(|x| x * GRID[0] / width).collect();
        let mut sums = vec![[0_u32; 5]; GRID[0] * GRID[1]];
        let rows = image.as_raw().chunks_exact(3 * width.max(1));
        for (y, (row, covered)) in rows.zip(is_covered.chunks_exact(width.max(1))).enumerate() {
            let cells = &mut sums[y * GRID[1] / height * GRID[0]..][..GRID[0]];
            for ((pixel, covered), cell) in row.chunks_exact(3).zip(covered).zip(&cell_of) {
                let sums = &mut cells[*cell];
                let is_free = u32::from(!covered);
                for (sum, level) in sums.iter_mut().zip(pixel) {
                    *sum += is_free * u32::from(*level);
                }
                sums[3] += is_free;
                sums[4] += 1;
            }
        }
        let mean = |[red, green, blue, free, all]: &[u32; 5]| {
            let is_free = *free > 0 && *free as f32 >= MIN_FREE * *all as f32;
            is_free.then(|| [red, green, blue].map(|sum| *sum as f32 / *free as f32))
        };
        Self {
            size: [image.width(), image.height()],
            levels: sums.iter().map(mean).collect(),
        }
    }
}

/// The area in contact, by cells.
#[derive(Clone, Debug)]
pub(crate) struct ContactArea {
    /// Cells in contact, row-major.
    cells: Vec<bool>,
    size: [f32; 2],
}

impl ContactArea {
    /// The area that changed between two images of a size; `None` without contact.
    pub(crate) fn between(initial: &SkinCells, now: &SkinCells) -> Option<Self> {
        let changes: Vec<Option<[f32; 3]>> = initial
            .levels
            .iter()
            .zip(&now.levels)
            .map(|(before, now)| {
                let (before, now) = ((*before)?, (*now)?);
                Some([0, 1, 2].map(|c| now[c] - before[c]))
            })
            .collect();
        let changed = local_changes(&changes, &surroundings(&changes));
        // The contact changes the mean of what surrounds it: once more without the contact.
        let skin: Vec<Option<[f32; 3]>> = changes
            .iter()
            .zip(&changed)
            .map(|(change, is_changed)| change.filter(|_| !is_changed))
            .collect();
        let is_visible = skin.iter().flatten().count() as f32 >= MIN_SKIN * skin.len() as f32;
        let changed = if is_visible {
            local_changes(&changes, &surroundings(&skin))
        } else {
            changed
        };
        let count = changed.iter().filter(|cell| **cell).count();
        (count as f32 >= MIN_CONTACT * changed.len() as f32).then(|| Self {
            cells: filled(&changed),
            size: now.size.map(|side| side as f32),
        })
    }

    /// Whether a pixel is in contact.
    pub(crate) fn contains(&self, position: [f32; 2]) -> bool {
        let [column, row] = [0, 1].map(|axis| {
            let at = (position[axis] + 0.5) / self.size[axis] * GRID[axis] as f32;
            (at.max(0.0) as usize).min(GRID[axis] - 1)
        });
        self.cells[row * GRID[0] + column]
    }

    /// Fraction of the image that is in contact.
    pub(crate) fn fraction(&self) -> f32 {
        self.cells.iter().filter(|cell| **cell).count() as f32 / self.cells.len() as f32
    }
}

/// Mean change of the cells around each cell; where there are none, of all.
fn surroundings(changes: &[Option<[f32; 3]>]) -> Vec<[f32; 3]> {
    let means = |value: &dyn Fn(&[f32; 3]) -> f32| {
        let values = changes
            .iter()
            .map(|change| change.as_ref().map_or(0.0, value));
        let mean = values.clone().sum::<f32>() / changes.len() as f32;
        (BoxSums::new(GRID, values).means(SURROUNDINGS), mean)
    };
    let (counts, count) = means(&|_| 1.0);
    let around = [0, 1, 2].map(|c| means(&|change| change[c]));
    let mean = |at: usize| {
        around
            .each_ref()
            .map(|(near, all)| match counts[at] > MIN_SURROUNDINGS {
                true => near[at] / counts[at],
                false => all / count.max(f32::MIN_POSITIVE),
            })
    };
    (0..changes.len()).map(mean).collect()
}

/// Which cells differ from their surroundings.
fn local_changes(changes: &[Option<[f32; 3]>], surroundings: &[[f32; 3]]) -> Vec<bool> {
    // Change beyond what the illumination explains, of the channel where it is largest.
    let excess = |(change, around): (&Option<[f32; 3]>, &[f32; 3])| {
        let channel = |change: &[f32; 3], c: usize| {
            (change[c] - around[c]).abs() - UNEVEN_FRACTION * around[c].abs()
        };
        change.as_ref().map_or(0.0, |change| {
            (0..3).map(|c| channel(change, c)).fold(0.0, f32::max)
        })
    };
    let excess: Vec<f32> = changes.iter().zip(surroundings).map(excess).collect();
    let mut strong: Vec<f32> = excess.iter().copied().filter(|e| *e > MIN_CHANGE).collect();
    strong.sort_by(f32::total_cmp);
    let steep = strong.get(strong.len() * 9 / 10).copied();
    let limit = MIN_CHANGE.max(SLOPE_FRACTION * steep.unwrap_or_default());
    excess.iter().map(|e| *e > limit).collect()
}

/// Changes are the rim and the slopes of a contact: a cell with changes on both sides in its row and
/// in its column is inside.
fn filled(cells: &[bool]) -> Vec<bool> {
    let [columns, rows] = GRID;
    let extent = |line: &mut dyn Iterator<Item = usize>| {
        let mut ends = None;
        for (i, at) in line.enumerate() {
            if cells[at] {
                ends = Some(ends.map_or((i, i), |(first, _)| (first, i)));
            }
        }
        ends
    };
    let across: Vec<_> = (0..rows)
        .map(|row| extent(&mut (0..columns).map(|column| row * columns + column)))
        .collect();
    let down: Vec<_> = (0..columns)
        .map(|column| extent(&mut (0..rows).map(|row| row * columns + column)))
        .collect();
    let is_between =
        |ends: Option<(usize, usize)>, i: usize| ends.is_some_and(|(a, b)| (a..=b).contains(&i));
    let is_inside = |i: usize| {
        let (row, column) = (i / columns, i % columns);
        is_between(across[row], column) && is_between(down[column], row)
    };
    (0..columns * rows)
        .map(|i| cells[i] || is_inside(i))
        .collect()
}
