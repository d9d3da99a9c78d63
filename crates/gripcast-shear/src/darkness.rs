//! Darkness of a tactile image relative to its surroundings, and sums over boxes.

use image::RgbImage;

/// Brightness of an image: red + green + blue of each pixel.
#[derive(Clone, Debug)]
pub(crate) struct Brightness {
    pub(crate) width: usize,
    pub(crate) height: usize,
    values: Vec<u16>,
}

/// Background below which nothing can be told, red + green + blue.
const MIN_BACKGROUND: f32 = 24.0;
/// Pixels below this fraction of the mean around them are no background.
const BACKGROUND_FRACTION: f32 = 0.8;

impl Brightness {
    pub(crate) fn new(image: &RgbImage) -> Self {
        let values = image.as_raw().chunks_exact(3);
        Self {
            width: image.width() as usize,
            height: image.height() as usize,
            values: values
                .map(|p| u16::from(p[0]) + u16::from(p[1]) + u16::from(p[2]))
                .collect(),
        }
    }

    /// Means of blocks of `factor` × `factor` pixels; the last ones may be smaller.
    fn reduced(&self, factor: usize) -> (Vec<f32>, [usize; 2]) {
        let size = [self.width.div_ceil(factor), self.height.div_ceil(factor)];
        let mut means = Vec::with_capacity(size[0] * size[1]);
        let mut sums = vec![0_u32; size[0]];
        for top in (0..self.height).step_by(factor) {
            sums.fill(0);
            let rows = factor.min(self.height - top);
            for row in self.values[top * self.width..]
                .chunks_exact(self.width)
                .take(rows)
            {
                for (sum, block) in sums.iter_mut().zip(row.chunks(factor)) {
                    *sum += block.iter().map(|v| u32::from(*v)).sum::<u32>();
                }
            }
            means.extend(sums.iter().enumerate().map(|(column, sum)| {
                let columns = factor.min(self.width - column * factor);
                *sum as f32 / (rows * columns) as f32
            }));
        }
        (means, size)
    }

    /// Darkness relative to the background in a square of `side` pixels around each pixel. The
    /// background is the mean without the pixels that are dark themselves, on a grid that is coarser
    /// by `factor`.
    pub(crate) fn darkness(&self, side: f32, factor: usize) -> Darkness<'_> {
        let (means, size) = self.reduced(factor);
        let side = (side / factor as f32).round() as usize | 1;
        let around = BoxSums::new(size, means.iter().copied()).means(side);
        let is_bright = |(value, mean): (&f32, &f32)| *value > BACKGROUND_FRACTION * mean;
        let bright: Vec<bool> = means.iter().zip(&around).map(is_bright).collect();
        let kept = |value: fn(f32) -> f32| {
            let kept = means.iter().zip(&bright);
            let kept = kept.map(move |(mean, is_kept)| if *is_kept { value(*mean) } else { 0.0 });
            BoxSums::new(size, kept).means(side)
        };
        let (sums, counts) = (kept(|mean| mean), kept(|_| 1.0));
        let inverse = |(sum, count): (f32, f32)| {
            let is_lit = count > 0.0 && sum >= MIN_BACKGROUND * count;
            if is_lit { count / sum } else { 0.0 }
        };
        let inverse_background: Vec<f32> = sums.into_iter().zip(counts).map(inverse).collect();
        Darkness {
            brightness: self,
            means,
            inverse_background,
            factor,
            size,
        }
    }
}

/// Darkness of an image, fraction of the background.
#[derive(Debug)]
pub(crate) struct Darkness<'a> {
    brightness: &'a Brightness,
    /// Brightness on the coarser grid.
    means: Vec<f32>,
    /// Reciprocal of the background on the coarser grid; 0 where it is too dark to tell.
    inverse_background: Vec<f32>,
    /// Pixels of a cell of the coarser grid.
    pub(crate) factor: usize,
    /// Size of the coarser grid.
    pub(crate) size: [usize; 2],
}

impl Darkness<'_> {
    /// Width and height of the image, px.
    pub(crate) fn image_size(&self) -> [usize; 2] {
        [self.brightness.width, self.brightness.height]
    }

    /// Calls `visit` with x and darkness, 0 to 1, of the pixels `from` to `to` of row `y`.
    pub(crate) fn row(&self, y: usize, [from, to]: [usize; 2], mut visit: impl FnMut(usize, f32)) {
        let values = &self.brightness.values[y * self.brightness.width..];
        let inverse = &self.inverse_background[y / self.factor * self.size[0]..];
        for (x, value) in (from..).zip(&values[from..=to]) {
            let inverse = inverse[x / self.factor];
            let is_lit = f32::from(u8::from(inverse > 0.0));
            visit(x, (is_lit - f32::from(*value) * inverse).max(0.0));
        }
    }

    /// Mean darkness in a square of `side` pixels around each cell of the coarser grid, 0 to 1.
    pub(crate) fn smoothed(&self, side: f32) -> Vec<f32> {
        let cells = self.means.iter().zip(&self.inverse_background);
        let darkness = cells.map(|(mean, inverse)| match *inverse > 0.0 {
            true => (1.0 - mean * inverse).max(0.0),
            false => 0.0,
        });
        let side = (side / self.factor as f32).round() as usize | 1;
        BoxSums::new(self.size, darkness).means(side)
    }
}

/// Sums of an image over any box (summed-area table, Crow 1984).
pub(crate) struct BoxSums {
    size: [usize; 2],
    sums: Vec<f64>,
}

impl BoxSums {
    pub(crate) fn new(size: [usize; 2], values: impl Iterator<Item = f32>) -> Self {
        let stride = size[0] + 1;
        let mut sums = vec![0.0; stride * (size[1] + 1)];
        let (mut column, mut next, mut row_sum) = (0, stride + 1, 0.0);
        for value in values {
            row_sum += f64::from(value);
            sums[next] = sums[next - stride] + row_sum;
            (column, next) = (column + 1, next + 1);
            if column == size[0] {
                (column, next, row_sum) = (0, next + 1, 0.0);
            }
        }
        Self { size, sums }
    }

    /// Mean of the square of `side` cells around each cell, as far as it is inside the image.
    pub(crate) fn means(&self, side: usize) -> Vec<f32> {
        let ([width, height], stride) = (self.size, self.size[0] + 1);
        let half = side / 2;
        let mut means = Vec::with_capacity(width * height);
        for y in 0..height {
            let (top, bottom) = (y.saturating_sub(half), (y + half + 1).min(height));
            let upper = &self.sums[top * stride..][..stride];
            let lower = &self.sums[bottom * stride..][..stride];
            let rows = bottom - top;
            for x in 0..width {
                let (left, right) = (x.saturating_sub(half), (x + half + 1).min(width));
                let sum = (lower[right] + upper[left]) - (upper[right] + lower[left]);
                means.push((sum / (rows * (right - left)) as f64) as f32);
            }
        }
        means
    }
}
