//! Stateless random numbers: the same seed and indices always give the same value.

use gripcast_base::random;

/// Hashes a seed and two indices to 64 bits (SplitMix64).
pub(super) fn mixed(seed: u64, stream: u64, index: u64) -> u64 {
    let seed = seed.wrapping_add(stream.wrapping_mul(0xD1B5_4A32_D192_ED03));
    random::numbered(seed, index)
}

/// Returns a uniform number in −1 ≤ x < 1.
pub(super) fn signed_unit(seed: u64, stream: u64, index: u64) -> f64 {
    2.0 * random::unit(mixed(seed, stream, index)) - 1.0
}

/// Precomputed sensor noise, read from another offset for every row of every frame.
#[derive(Debug)]
pub(super) struct NoiseTable(Vec<i8>);

impl NoiseTable {
    const LENGTH: usize = 1 << 19;

    /// Generates normal noise of standard deviation `std`, grey levels.
    pub(super) fn new(seed: u64, std: f64) -> Self {
        // The sum of the eight bytes of a random word is close to normal.
        const SUM_STD: f64 = 209.0;
        const SUM_MEAN: f64 = 1020.0;
        let values = (0..Self::LENGTH)
            .map(|index| {
                let bytes = mixed(seed, 0x6E6F, index as u64).to_le_bytes();
                let sum: u32 = bytes.iter().map(|byte| u32::from(*byte)).sum();
                ((f64::from(sum) - SUM_MEAN) / SUM_STD * std).round() as i8
            })
            .collect();
        Self(values)
    }

    /// Adds the noise of a frame to an RGB image.
    pub(super) fn add_to(&self, image: &mut [u8], row_bytes: usize, seed: u64, frame: u64) {
        for (row, line) in image.chunks_exact_mut(row_bytes).enumerate() {
            for (level, noise) in line.iter_mut().zip(self.row(seed, frame, row, row_bytes)) {
                *level = level.saturating_add_signed(*noise);
            }
        }
    }

    /// Returns `length` values for one row of a frame, at most the table's length.
    pub(super) fn row(&self, seed: u64, frame: u64, row: usize, length: usize) -> &[i8] {
        let length = length.min(self.0.len());
        let start = mixed(seed, frame, row as u64) as usize % (self.0.len() - length + 1);
        &self.0[start..start + length]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_has_the_requested_deviation_and_no_bias() {
        let table = NoiseTable::new(1, 1.5);
        let count = table.0.len() as f64;
        let mean = table.0.iter().map(|v| f64::from(*v)).sum::<f64>() / count;
        let power = table.0.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>() / count;
        assert!(mean.abs() < 0.01, "mean {mean}");
        assert!((power.sqrt() - 1.5).abs() < 0.1, "std {}", power.sqrt());
    }

    #[test]
    fn values_depend_on_each_index() {
        assert_ne!(mixed(1, 2, 3), mixed(1, 3, 2));
        assert_ne!(mixed(1, 2, 3), mixed(2, 2, 3));
        assert_eq!(signed_unit(7, 8, 9), signed_unit(7, 8, 9));
        let mean = (0..1000).map(|n| signed_unit(5, 1, n)).sum::<f64>() / 1000.0;
        assert!(mean.abs() < 0.1, "{mean}");
    }
}
