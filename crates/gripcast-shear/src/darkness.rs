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
/// Scale of the stored darkness.
const FULL: f32 = 255.0;

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

    /// Darkness of each pixel relative to the background in a square of `side` pixels around it.
    /// The background is the mean without the pixels that are dark themselves.
    pub(crate) fn darkness(&self, side: usize) -> Darkness {
        let size = [self.width, self.height];
        let all = BoxSums::new(size, self.values.iter().map(|v| u64::from(*v)));
        let bright = all.map(side, |at, sum, pixels| {
            let value = self.values[at];
            let is_bright = f32::from(value) * pixels > BACKGROUND_FRACTION * sum as f32;
            // Sum above, count below.
            u64::from(is_bright) * ((u64::from(value) << 32) | 1)
        });
        let bright = BoxSums::new(size, bright.into_iter());
        let levels = bright.map(side, |at, packed, _| {
            let (sum, count) = ((packed >> 32) as f32, (packed & 0xffff_ffff) as f32);
            if sum < MIN_BACKGROUND * count || count < 1.0 {
                return 0;
            }
            let darkness = 1.0 - f32::from(self.values[at]) * count / sum;
            (FULL * darkness.max(0.0)) as u8
        });
        Darkness { size, levels }
    }
}

/// Darkness of each pixel, fraction of the background.
#[derive(Clone, Debug)]
pub(crate) struct Darkness {
    pub(crate) size: [usize; 2],
    levels: Vec<u8>,
}

impl Darkness {
    /// Darkness of a pixel, 0 to 1.
    pub(crate) fn at(&self, x: usize, y: usize) -> f32 {
        f32::from(self.levels[y * self.size[0] + x]) / FULL
    }

    /// Mean in a square of `side` pixels around each pixel, 0 to 1.
    pub(crate) fn smoothed(&self, side: usize) -> Vec<f32> {
        let sums = BoxSums::new(self.size, self.levels.iter().map(|v| u64::from(*v)));
        sums.map(side, |_, sum, pixels| sum as f32 / (FULL * pixels))
    }
}

/// Sums of an image over any box (summed-area table, Crow 1984).
struct BoxSums {
    size: [usize; 2],
    sums: Vec<u64>,
}

impl BoxSums {
    fn new(size: [usize; 2], values: impl Iterator<Item = u64>) -> Self {
        let stride = size[0] + 1;
        let mut sums = vec![0_u64; stride * (size[1] + 1)];
        let (mut column, mut next, mut row_sum) = (0, stride + 1, 0_u64);
        for value in values {
            row_sum += value;
            sums[next] = sums[next - stride] + row_sum;
            (column, next) = (column + 1, next + 1);
            if column == size[0] {
                (column, next, row_sum) = (0, next + 1, 0);
            }
        }
        Self { size, sums }
    }

    /// Calls `value` with the index of each pixel, the sum of the square of `side` pixels around it
    /// as far as it is inside the image, and its number of pixels.
    fn map<T>(&self, side: usize, value: impl Fn(usize, u64, f32) -> T) -> Vec<T> {
        let ([width, height], stride) = (self.size, self.size[0] + 1);
        let half = side / 2;
        let mut values = Vec::with_capacity(width * height);
        for y in 0..height {
            let (top, bottom) = (y.saturating_sub(half), (y + half + 1).min(height));
            let upper = &self.sums[top * stride..][..stride];
            let lower = &self.sums[bottom * stride..][..stride];
            let rows = bottom - top;
            for x in 0..width {
                let (left, right) = (x.saturating_sub(half), (x + half + 1).min(width));
                let sum = (lower[right] + upper[left]) - (upper[right] + lower[left]);
                values.push(value(y * width + x, sum, (rows * (right - left)) as f32));
            }
        }
        values
    }
}
