//! A tactile image reduced to a grid of cells.

use image::RgbImage;

use gripcast_base::error::{Error, Result};

/// Columns of the grid.
pub(super) const COLUMNS: usize = 40;
/// Rows of the grid.
pub(super) const ROWS: usize = 30;
/// Cells of the grid.
pub(super) const CELLS: usize = COLUMNS * ROWS;

/// Columns and rows of the finer grid on which markers are visible.
const FINE: [usize; 2] = [2 * COLUMNS, 2 * ROWS];
/// Radius of the local mean that the texture is relative to, fine cells.
const TEXTURE_RADIUS: usize = 5;
/// Tiles of the gel, across and down; a texture of the whole gel is in most of them.
const TILES: [usize; 2] = [5, 4];

/// Minimum level of a clipped channel. JPEG rounds clipped areas by a few levels.
const CLIPPED_LEVEL: u8 = 250;
/// Change of a cell from which it counts for the contact level, grey levels: above what video codecs
/// change in a key frame.
const CONTACT_FLOOR_LEVELS: f32 = 3.0;

/// A tactile image reduced to 40×30 cells, with what is lost by the reduction: clipping, grain and
/// texture.
#[derive(Clone, Debug)]
pub struct GelCells {
    /// Mean level of each cell, by channel, row-major, 0 to 255.
    pub(super) levels: [Vec<f32>; 3],
    /// Brightness of the finer grid relative to its surroundings, grey levels.
    pub(super) texture: Vec<f32>,
    /// Fraction of the pixels with a clipped channel, 0 to 1.
    pub(super) clipped_fraction: f32,
    /// Mean absolute difference of horizontal neighbours, grey levels.
    pub(super) grain: f32,
}

impl GelCells {
    /// Reduces an image.
    ///
    /// # Errors
    /// `Input` for an image below 80×60 pixels.
    pub fn new(image: &RgbImage) -> Result<Self> {
        let (width, height) = (image.width() as usize, image.height() as usize);
        if width < FINE[0] || height < FINE[1] {
            let what = format!(
                "expected a tactile image of at least {}×{} pixels, found {width}×{height}",
                FINE[0], FINE[1]
            );
            return Err(Error::input(what));
        }
        let columns: Vec<usize> = (0..width).map(|x| x * FINE[0] / width).collect();
        let mut sums = vec![[0_u32; 4]; FINE[0] * FINE[1]];
        let (mut clipped, mut steps) = (0_u64, 0_u64);
        for (y, row) in image.as_raw().chunks_exact(width * 3).enumerate() {
            let first = (y * FINE[1] / height) * FINE[0];
            let cells = &mut sums[first..first + FINE[0]];
            let mut before = row[1];
            for (pixel, column) in row.chunks_exact(3).zip(&columns) {
                let [red, green, blue] = [pixel[0], pixel[1], pixel[2]];
                let cell = &mut cells[*column];
                cell[0] += u32::from(red);
                cell[1] += u32::from(green);
                cell[2] += u32::from(blue);
                cell[3] += 1;
                clipped += u64::from(red.max(green).max(blue) >= CLIPPED_LEVEL);
                steps += u64::from(green.abs_diff(before));
                before = green;
            }
        }
        let pixels = (width * height) as f32;
        let fine = |cell: &[u32; 4], channel: usize| cell[channel] as f32 / cell[3].max(1) as f32;
        let levels = std::array::from_fn(|channel| {
            let mean = |i: usize| {
                let (x, y) = (2 * (i % COLUMNS), 2 * (i / COLUMNS));
                let at = |dx: usize, dy: usize| fine(&sums[(y + dy) * FINE[0] + x + dx], channel);
                0.25 * (at(0, 0) + at(1, 0) + at(0, 1) + at(1, 1))
            };
            (0..CELLS).map(mean).collect()
        });
        let brightness: Vec<f32> = sums
            .iter()
            .map(|cell| (0..3).map(|channel| fine(cell, channel)).sum::<f32>() / 3.0)
            .collect();
        let around = local_mean(&brightness, FINE, TEXTURE_RADIUS);
        Ok(Self {
            levels,
            texture: brightness.iter().zip(&around).map(|(b, m)| b - m).collect(),
            clipped_fraction: clipped as f32 / pixels,
            grain: steps as f32 / pixels,
        })
    }

    /// Mean level of each channel, 0 to 255.
    #[must_use]
    pub fn mean_levels(&self) -> [f32; 3] {
        std::array::from_fn(|c| self.levels[c].iter().sum::<f32>() / CELLS as f32)
    }

    /// Mean absolute difference of the cells of two images, grey levels.
    #[must_use]
    pub fn mean_difference(&self, other: &Self) -> f32 {
        let pairs = self
            .levels
            .iter()
            .flatten()
            .zip(other.levels.iter().flatten());
        pairs.map(|(a, b)| (a - b).abs()).sum::<f32>() / (3 * CELLS) as f32
    }

    /// Contact level: how strongly something presses on the gel, relative to the initial image, grey
    /// levels. The mean over the cells of the change of the channel that changed most, less the
    /// change that half of the cells have (light) and less three grey levels (noise). Unlike a
    /// [`GelChange`](super::GelChange), it rises with the depth and the area of a contact, but so
    /// does it with an uneven change of the light.
    #[must_use]
    pub fn contact_level(&self, initial: &Self) -> f32 {
        let mut excess = vec![0.0_f32; CELLS];
        for (now, before) in self.levels.iter().zip(&initial.levels) {
            let changes: Vec<f32> = now.iter().zip(before).map(|(a, b)| a - b).collect();
            let light = quantile(&mut changes.clone(), 0.5);
            for (excess, change) in excess.iter_mut().zip(changes) {
                *excess = excess.max((change - light).abs() - CONTACT_FLOOR_LEVELS);
            }
        }
        excess.iter().sum::<f32>() / CELLS as f32
    }

    /// Returns the level that a fraction of the cells of each channel is below, 0 to 255.
    pub(super) fn quantiles(&self, fraction: f32) -> [f32; 3] {
        std::array::from_fn(|c| quantile(&mut self.levels[c].clone(), fraction))
    }

    /// Strength of a texture that covers the whole gel, such as markers, grey levels: of the tiles,
    /// three quarters have at least this standard deviation.
    pub(super) fn covering_texture(&self) -> f32 {
        let mut deviations = self.tile_products(self).map(f32::sqrt);
        quantile(&mut deviations, 0.25)
    }

    /// Correlation of the texture of two images, −1 to 1: of the tiles, two fifths have at least
    /// this. A contact hides the texture of some tiles only.
    pub(super) fn texture_correlation(&self, other: &Self) -> f32 {
        let products = self.tile_products(other);
        let norms = self
            .tile_products(self)
            .into_iter()
            .zip(other.tile_products(other));
        let pairs = products.into_iter().zip(norms);
        let mut correlations: Vec<f32> = pairs
            .map(|(product, (a, b))| product / (a * b).sqrt().max(f32::MIN_POSITIVE))
            .collect();
        quantile(&mut correlations, 0.6)
    }

    /// Mean product of the textures of two images in each tile, square grey levels.
    fn tile_products(&self, other: &Self) -> [f32; TILES[0] * TILES[1]] {
        let mut sums = [0.0; TILES[0] * TILES[1]];
        for (i, (a, b)) in self.texture.iter().zip(&other.texture).enumerate() {
            let (x, y) = (
                i % FINE[0] * TILES[0] / FINE[0],
                i / FINE[0] * TILES[1] / FINE[1],
            );
            sums[y * TILES[0] + x] += a * b;
        }
        sums.map(|sum| sum / (FINE[0] * FINE[1] / (TILES[0] * TILES[1])) as f32)
    }
}

/// Returns the value that `fraction` of the values is below; reorders them. 0 for none.
pub(super) fn quantile(values: &mut [f32], fraction: f32) -> f32 {
    if values.is_empty() {
        return 0.0;
    }
    let index = (fraction.clamp(0.0, 1.0) * (values.len() - 1) as f32) as usize;
    *values.select_nth_unstable_by(index, f32::total_cmp).1
}

/// Mean of the square of side 2·radius + 1 around each value; the grid is continued by its edges.
pub(super) fn local_mean(values: &[f32], [width, height]: [usize; 2], radius: usize) -> Vec<f32> {
    let mut rows = vec![0.0; values.len()];
    for y in 0..height {
        let row = &values[y * width..(y + 1) * width];
        window_means(row.iter().copied(), width, radius, |x, mean| {
            rows[y * width + x] = mean;
        });
    }
    let mut means = vec![0.0; values.len()];
    for x in 0..width {
        let column = (0..height).map(|y| rows[y * width + x]);
        window_means(column, height, radius, |y, mean| {
            means[y * width + x] = mean
        });
    }
    means
}

/// Calls `set` with the mean of each window of 2·radius + 1 values, continued by the ends.
fn window_means(
    values: impl Iterator<Item = f32> + Clone,
    count: usize,
    radius: usize,
    mut set: impl FnMut(usize, f32),
) {
    let values: Vec<f32> = values.collect();
    let at = |i: usize| values[i.clamp(radius, count + radius - 1) - radius];
    let size = 2 * radius + 1;
    let mut sum: f32 = (0..size).map(at).sum();
    for i in 0..count {
        set(i, sum / size as f32);
        sum += at(i + size) - at(i);
    }
}
