//! Seeded numbers without state: the same question always gets the same answer.

/// A well mixed 64-bit number of a seed and two indices (splitmix64 finaliser).
pub(super) fn mixed(seed: u64, stream: u64, index: u64) -> u64 {
    let mut z = seed
        .wrapping_add(stream.wrapping_mul(0xD1B5_4A32_D192_ED03))
        .wrapping_add(index.wrapping_mul(0x9E37_79B9_7F4A_7C15))
        .wrapping_add(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

/// Uniform in 0 ≤ x < 1.
pub(super) fn unit(seed: u64, stream: u64, index: u64) -> f64 {
    (mixed(seed, stream, index) >> 11) as f64 / (1_u64 << 53) as f64
}

/// Uniform in −1 ≤ x < 1.
pub(super) fn signed_unit(seed: u64, stream: u64, index: u64) -> f64 {
    2.0 * unit(seed, stream, index) - 1.0
}

/// Smooth noise in −1..1 over the plane, cells of side 1.
pub(super) fn plane_noise(seed: u64, x: f64, y: f64) -> f64 {
    let (x0, y0) = (x.floor(), y.floor());
    let ease = |t: f64| t * t * (3.0 - 2.0 * t);
    let (tx, ty) = (ease(x - x0), ease(y - y0));
    let corner =
        |dx: f64, dy: f64| signed_unit(seed, (x0 + dx) as i64 as u64, (y0 + dy) as i64 as u64);
    let top = corner(0.0, 0.0) * (1.0 - tx) + corner(1.0, 0.0) * tx;
    let bottom = corner(0.0, 1.0) * (1.0 - tx) + corner(1.0, 1.0) * tx;
    top * (1.0 - ty) + bottom * ty
}

/// Sensor noise, made once and read from another place for every row of every frame.
#[derive(Debug)]
pub(in crate::rig::camera) struct NoiseTable(Vec<i8>);

impl NoiseTable {
    const LENGTH: usize = 1 << 19;

    /// Normal noise of standard deviation `std` grey levels.
    pub(in crate::rig::camera) fn new(seed: u64, std: f64) -> Self {
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

    /// `length` values for one row of one frame; at most the table's length.
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
    fn noise_has_the_asked_deviation_and_no_bias() {
        let table = NoiseTable::new(1, 1.5);
        let count = table.0.len() as f64;
        let mean = table.0.iter().map(|v| f64::from(*v)).sum::<f64>() / count;
        let power = table.0.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>() / count;
        assert!(mean.abs() < 0.01, "mean {mean}");
        assert!((power.sqrt() - 1.5).abs() < 0.1, "std {}", power.sqrt());
    }

    #[test]
    fn numbers_depend_on_each_index() {
        assert_ne!(mixed(1, 2, 3), mixed(1, 3, 2));
        assert_ne!(mixed(1, 2, 3), mixed(2, 2, 3));
        assert_eq!(unit(7, 8, 9), unit(7, 8, 9));
        let noise = plane_noise(5, -3.25, 8.5);
        assert!((-1.0..=1.0).contains(&noise));
        assert!((noise - plane_noise(5, -3.2501, 8.5)).abs() < 0.01);
    }
}
