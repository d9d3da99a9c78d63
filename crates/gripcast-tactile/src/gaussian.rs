//! Gaussian filter of a plane of `f32`.

/// Kernel radius in standard deviations; beyond it the weight is below 0.0003 of the peak.
const REACH: f64 = 4.0;
/// Columns summed together; fills the vector registers.
const LANES: usize = 16;

/// Non-zero region of a plane: columns `x0..x1`, rows `y0..y1`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Region {
    pub(super) x0: usize,
    pub(super) x1: usize,
    pub(super) y0: usize,
    pub(super) y1: usize,
}

impl Region {
    /// Returns the smallest region that contains all non-zero values; `None` if all are 0.
    pub(super) fn nonzero(plane: &[f32], width: usize) -> Option<Self> {
        let mut found: Option<Self> = None;
        for (y, row) in plane.chunks_exact(width.max(1)).enumerate() {
            let Some(first) = row.iter().position(|v| *v != 0.0) else {
                continue;
            };
            let last = row.iter().rposition(|v| *v != 0.0).unwrap_or(first);
            let region = found.get_or_insert(Self {
                x0: first,
                x1: last + 1,
                y0: y,
                y1: y + 1,
            });
            region.x0 = region.x0.min(first);
            region.x1 = region.x1.max(last + 1);
            region.y1 = y + 1;
        }
        found
    }

    /// Returns the region grown by a margin, clipped to `width` × `height`.
    pub(super) fn grown(self, margin: usize, width: usize, height: usize) -> Self {
        Self {
            x0: self.x0.saturating_sub(margin),
            x1: (self.x1 + margin).min(width),
            y0: self.y0.saturating_sub(margin),
            y1: (self.y1 + margin).min(height),
        }
    }
}

/// Separable Gaussian filter with replicated border.
#[derive(Clone, Debug)]
pub(super) struct Gaussian {
    /// Weights from the centre outwards; the centre plus twice the others is 1.
    taps: Vec<f32>,
    /// Result of the horizontal pass.
    half: Vec<f32>,
    /// One row with its border replicated.
    padded: Vec<f32>,
}

impl Gaussian {
    /// Filter with a standard deviation in pixels; 0 is the identity.
    pub(super) fn new(sigma_px: f64) -> Self {
        let reach = (REACH * sigma_px.max(0.0)).ceil() as usize;
        let weight = |k: usize| (-0.5 * (k as f64 / sigma_px).powi(2)).exp();
        let sum = 1.0 + 2.0 * (1..=reach).map(weight).sum::<f64>();
        let taps = std::iter::once(1.0)
            .chain((1..=reach).map(weight))
            .map(|w| (w / sum) as f32)
            .collect();
        Self {
            taps,
            half: Vec::new(),
            padded: Vec::new(),
        }
    }

    /// Kernel radius, pixels.
    pub(super) fn reach(&self) -> usize {
        self.taps.len() - 1
    }

    /// Filters the plane, which is zero outside `region`; returns its new non-zero region.
    pub(super) fn apply(&mut self, plane: &mut [f32], width: usize, region: Region) -> Region {
        let height = plane.len() / width.max(1);
        let reach = self.reach();
        if reach == 0 {
            return region;
        }
        let wide = region.grown(reach, width, height);
        self.half.resize(plane.len(), 0.0);
        for y in region.y0..region.y1 {
            let row = &plane[y * width..(y + 1) * width];
            continue_border(row, reach, &mut self.padded);
            let out = &mut self.half[y * width + wide.x0..y * width + wide.x1];
            filter_row(&self.taps, &self.padded[wide.x0..], out);
        }
        for y in wide.y0..wide.y1 {
            let out = &mut plane[y * width + wide.x0..y * width + wide.x1];
            self.filter_column_block([width, height], y, region, wide, out);
        }
        wide
    }

    /// Computes one output row from the rows above and below.
    fn filter_column_block(
        &self,
        [width, height]: [usize; 2],
        y: usize,
        region: Region,
        wide: Region,
        out: &mut [f32],
    ) {
        out.fill(0.0);
        let reach = self.reach() as isize;
        for k in -reach..=reach {
            let source = (y as isize + k).clamp(0, height as isize - 1) as usize;
            if source < region.y0 || source >= region.y1 {
                continue;
            }
            let tap = self.taps[k.unsigned_abs()];
            let row = &self.half[source * width + wide.x0..source * width + wide.x1];
            for (sum, value) in out.iter_mut().zip(row) {
                *sum += tap * value;
            }
        }
    }
}

/// Writes the row padded by `reach` copies of its end values.
fn continue_border(row: &[f32], reach: usize, padded: &mut Vec<f32>) {
    let (first, last) = (row[0], row[row.len() - 1]);
    padded.clear();
    padded.resize(reach, first);
    padded.extend_from_slice(row);
    // Padding for the last block of lanes.
    padded.resize(2 * reach + row.len() + LANES, last);
}

/// Writes `out[i]` as the sum over the kernel centred at `padded[i + reach]`.
fn filter_row(taps: &[f32], padded: &[f32], out: &mut [f32]) {
    let reach = taps.len() - 1;
    for (block, out) in out.chunks_mut(LANES).enumerate() {
        let start = block * LANES;
        let mut sum = [0.0f32; LANES];
        for (k, tap) in taps.iter().enumerate() {
            let left = &padded[start + reach - k..][..LANES];
            let right = &padded[start + reach + k..][..LANES];
            // The centre is counted once.
            let tap = if k == 0 { 0.5 * tap } else { *tap };
            for lane in 0..LANES {
                sum[lane] += tap * (left[lane] + right[lane]);
            }
        }
        out.copy_from_slice(&sum[..out.len()]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn filtered(plane: &[f32], width: usize, sigma: f64) -> Vec<f32> {
        let mut out = plane.to_vec();
        if let Some(region) = Region::nonzero(plane, width) {
            Gaussian::new(sigma).apply(&mut out, width, region);
        }
        out
    }

    #[test]
    fn impulse_becomes_sampled_gaussian() {
        let (width, height) = (61, 51);
        let mut plane = vec![0.0; width * height];
        plane[25 * width + 30] = 1.0;
        let out = filtered(&plane, width, 3.0);
        assert!((out.iter().sum::<f32>() - 1.0).abs() < 1e-5);
        let variance: f32 = (0..plane.len())
            .map(|i| out[i] * ((i % width) as f32 - 30.0).powi(2))
            .sum();
        assert!((variance - 9.0).abs() < 0.05, "{variance}");
        for (dx, dy) in [(3, 0), (0, 3), (2, 5)] {
            let expected = out[25 * width + 30] * (-((dx * dx + dy * dy) as f32) / 18.0).exp();
            let found = out[(25 + dy) * width + 30 + dx];
            assert!((found - expected).abs() < 1e-6);
            assert_eq!(found, out[(25 - dy) * width + 30 - dx]);
        }
    }

    #[test]
    fn constant_plane_is_unchanged() {
        let plane = vec![2.0; 40 * 7];
        for value in filtered(&plane, 40, 4.0) {
            assert!((value - 2.0).abs() < 1e-5);
        }
        let mut tiny = vec![3.0];
        Gaussian::new(5.0).apply(
            &mut tiny,
            1,
            Region {
                x0: 0,
                x1: 1,
                y0: 0,
                y1: 1,
            },
        );
        assert!((tiny[0] - 3.0).abs() < 1e-5);
    }

    #[test]
    fn filtering_a_region_equals_filtering_the_plane() {
        let (width, height) = (90, 70);
        let mut plane = vec![0.0; width * height];
        plane[3 * width + 80] = 5.0;
        plane[20 * width + 85] = -1.0;
        let part = filtered(&plane, width, 2.5);
        // A tiny value in the corners makes the whole plane the region.
        plane[0] = 1e-30;
        plane[width * height - 1] = 1e-30;
        let whole = filtered(&plane, width, 2.5);
        for (a, b) in part.iter().zip(whole) {
            assert!((a - b).abs() < 1e-6);
        }
    }

    #[test]
    fn zero_plane_has_no_region() {
        assert_eq!(Region::nonzero(&[0.0; 12], 4), None);
    }
}
