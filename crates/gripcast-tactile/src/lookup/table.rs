//! Taxim's photometric table: change of a pixel's colour by the slope of the face and the position
//! of the pixel.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Coefficients of a bin: x², y², x y, x, y, 1, with x the column and y the row of a pixel.
pub(super) type Coefficients = [f64; 6];

/// Ranges of the samples that a bin was fitted to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SampleRange {
    /// Minimum and maximum column and row.
    pub(super) position: [[f64; 2]; 2],
    /// Minimum and maximum change of red, green, blue, grey levels.
    pub(super) change: [[f64; 2]; 3],
}

impl SampleRange {
    /// Empty ranges.
    pub(super) const EMPTY: Self = Self {
        position: [[f64::INFINITY, f64::NEG_INFINITY]; 2],
        change: [[f64::INFINITY, f64::NEG_INFINITY]; 3],
    };

    /// Extends the ranges by a sample.
    pub(super) fn add(&mut self, position: [f64; 2], change: [f64; 3]) {
        let ranges = self.position.iter_mut().chain(&mut self.change);
        for ([low, high], value) in ranges.zip(position.into_iter().chain(change)) {
            (*low, *high) = (low.min(value), high.max(value));
        }
    }
}

/// Clamps a value to a range.
fn clamp([low, high]: [f64; 2], value: f64) -> f64 {
    value.max(low).min(high)
}

/// Polynomial table of Taxim (Si & Yuan 2022, §III-A): slopes are binned by angle, 0 to π/2, and
/// direction, −π to π; each bin has a polynomial of the pixel position per channel.
#[derive(Clone, Debug, PartialEq)]
pub struct TaximTable {
    bins: usize,
    image_size: [usize; 2],
    /// Red, green, blue; bin (angle, direction) at angle · bins + direction.
    channels: [Vec<Coefficients>; 3],
    /// Sample ranges of each bin; empty for a table that was not fitted.
    ranges: Vec<SampleRange>,
}

impl TaximTable {
    pub(super) fn new(
        bins: usize,
        image_size: [usize; 2],
        channels: [Vec<Coefficients>; 3],
        ranges: Vec<SampleRange>,
    ) -> Self {
        Self {
            bins,
            image_size,
            channels,
            ranges,
        }
    }

    /// Constant change everywhere.
    #[cfg(test)]
    pub(crate) fn constant(bins: usize, image_size: [usize; 2], change: [f64; 3]) -> Self {
        let same = |value| vec![[0.0, 0.0, 0.0, 0.0, 0.0, value]; bins * bins];
        Self::new(bins, image_size, change.map(same), Vec::new())
    }

    /// A change of each channel by one grey level a column.
    #[cfg(test)]
    pub(super) fn linear_in_column(bins: usize, image_size: [usize; 2]) -> Self {
        let coefficients = vec![[0.0, 0.0, 0.0, 1.0, 0.0, 0.0]; bins * bins];
        Self::new(
            bins,
            image_size,
            [0; 3].map(|_| coefficients.clone()),
            Vec::new(),
        )
    }

    /// Columns and rows of the images it is for.
    pub fn image_size(&self) -> [usize; 2] {
        self.image_size
    }

    /// Change of red, green and blue (grey levels) of a pixel at `place` (column, row of the
    /// table's image) where the height towards the camera rises by `slope` (pixels per pixel,
    /// along columns and rows).
    ///
    /// A fitted table keeps to its presses: a place outside of those that a bin has ranges counts
    /// as the nearest of them, and a change beyond those ranges there is cut to them. Polynomials
    /// grow without bound elsewhere.
    pub fn change(&self, slope: [f32; 2], position: [f64; 2]) -> [f64; 3] {
        let angle = f64::from(slope[0].hypot(slope[1])).atan();
        let direction = f64::from(slope[1]).atan2(f64::from(slope[0]));
        let bin = bin(self.bins, angle, direction);
        let ranges = self.ranges.get(bin);
        let position = ranges.map_or(position, |s| {
            [0, 1].map(|axis| clamp(s.position[axis], position[axis]))
        });
        let terms = terms(position);
        [0, 1, 2].map(|channel| {
            let coefficients = &self.channels[channel][bin];
            let change = coefficients.iter().zip(terms).map(|(c, t)| c * t).sum();
            ranges.map_or(change, |s| clamp(s.change[channel], change))
        })
    }
}

/// Bin of a slope angle, 0 to π/2, and a direction, −π to π.
pub(super) fn bin(bins: usize, angle: f64, direction: f64) -> usize {
    let last = bins - 1;
    let along = |fraction: f64| ((fraction * last as f64) as usize).min(last);
    along(angle / FRAC_PI_2) * bins + along((direction + PI) / TAU)
}

/// Terms of the polynomial at a place.
pub(super) fn terms([x, y]: [f64; 2]) -> Coefficients {
    [x * x, y * y, x * y, x, y, 1.0]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slope_gives_change_of_its_bin() {
        let bins = 5;
        let mut red = vec![[0.0; 6]; bins * bins];
        // 45 degrees, uphill towards larger rows: angle bin 2, direction bin 3.
        red[2 * bins + 3] = [1e-2, 0.0, 0.0, 0.5, -1.0, 3.0];
        let zero = vec![[0.0; 6]; bins * bins];
        let table = TaximTable::new(bins, [640, 480], [red, zero.clone(), zero], Vec::new());
        let change = table.change([0.0, 1.01], [10.0, 4.0]);
        assert!(
            (change[0] - 5.0).abs() < 1e-12 && change[1] == 0.0,
            "{change:?}"
        );
        assert_eq!(table.change([1.01, 0.0], [10.0, 4.0]), [0.0; 3]);
    }

    #[test]
    fn extreme_slopes_have_a_bin() {
        for slope in [[0.0, 0.0], [-1e30, 0.0], [-1.0, -0.0], [f32::MAX, f32::MAX]] {
            let angle = f64::from(slope[0].hypot(slope[1])).atan();
            let direction = f64::from(slope[1]).atan2(f64::from(slope[0]));
            assert!(bin(125, angle, direction) < 125 * 125);
        }
    }
}
