//! Low-discrepancy sampler for paths.
//!
//! Pairs of dimensions are the first two Sobol dimensions with independent Owen scrambling and
//! shuffling per pair; each pixel adds its own digital shift. A power-of-two number of samples of a
//! pixel is a (0, m, 2)-net in every pair, and pixels and pairs are mutually independent. Sources:
//! Owen, *Scrambled net variance for integrals of smooth functions* (1997); Kollig and Keller,
//! *Efficient multidimensional sampling* (2002); Burley, *Practical hash-based Owen scrambling*
//! (2020).

use gripcast_base::random::mix;

/// Low-discrepancy pairs; later ones are pseudorandom.
const PAIRS: usize = 24;
/// Maximum net length, samples; further samples start a new net with other shifts.
const MAX_NET: u32 = 4096;
const GOLDEN_RATIO: u64 = 0x9e37_79b9_7f4a_7c15;
/// 2^-24.
const UNIT: f32 = 1.0 / 16_777_216.0;

/// Sobol points of one net, shared by all pixels.
#[derive(Debug)]
pub(super) struct SobolSampler {
    /// Points of each sample.
    points: Vec<[[u32; 2]; PAIRS]>,
    seed: u64,
}

/// Random numbers of one sample of a pixel.
#[derive(Clone, Copy, Debug)]
pub(super) struct PixelSampler<'a> {
    points: &'a [[u32; 2]; PAIRS],
    key: u64,
    /// Distinguishes samples with the same key.
    index: u32,
}

impl SobolSampler {
    /// Prepares a net for a number of samples.
    pub(super) fn new(samples: u32, seed: u64) -> Self {
        let length = samples.next_power_of_two().min(MAX_NET);
        let point = |index: u32, pair: u64| {
            let shuffled = owen_scramble(index, mix(seed ^ mix(3 * pair)));
            let [x, y] = sobol(shuffled);
            [
                owen_scramble(x, mix(seed ^ mix(3 * pair + 1))),
                owen_scramble(y, mix(seed ^ mix(3 * pair + 2))),
            ]
        };
        let points = (0..length)
            .map(|index| std::array::from_fn(|pair| point(index, pair as u64)))
            .collect();
        Self { points, seed }
    }

    /// Returns the random numbers of a sample of a pixel.
    #[inline(always)]
    pub(super) fn sample(&self, pixel: u64, index: u32) -> PixelSampler<'_> {
        let length = self.points.len() as u32;
        let net = u64::from(index / length);
        PixelSampler {
            points: &self.points[(index % length) as usize],
            key: mix(self.seed ^ mix(pixel ^ (net << 40))),
            index,
        }
    }
}

impl PixelSampler<'_> {
    /// Returns the numbers in [0, 1) of a pair of dimensions.
    #[inline(always)]
    pub(super) fn get_2d(&self, pair: usize) -> [f32; 2] {
        let shift = mix(self
            .key
            .wrapping_add((pair as u64 + 1).wrapping_mul(GOLDEN_RATIO)));
        let [x, y] = match self.points.get(pair) {
            Some(&point) => point,
            None => {
                let random = mix(shift ^ mix(u64::from(self.index)));
                [random as u32, (random >> 32) as u32]
            }
        };
        [
            ((x ^ shift as u32) >> 8) as f32 * UNIT,
            ((y ^ (shift >> 32) as u32) >> 8) as f32 * UNIT,
        ]
    }
}

/// First two dimensions of the Sobol sequence, as fractions of 2³².
fn sobol(index: u32) -> [u32; 2] {
    let mut direction = 1u32 << 31;
    let mut second = 0;
    for bit in 0..32 {
        if index >> bit & 1 == 1 {
            second ^= direction;
        }
        direction ^= direction >> 1;
    }
    [index.reverse_bits(), second]
}

/// Nested uniform (Owen) scrambling: each bit is flipped depending on all higher bits.
fn owen_scramble(value: u32, seed: u64) -> u32 {
    let mut flips = 0;
    for bit in 0..32 {
        // A leading 1 distinguishes prefixes of different length.
        let prefix = (1u64 << bit) | (u64::from(value) >> (32 - bit));
        let flip = mix(seed ^ prefix.wrapping_mul(GOLDEN_RATIO)) >> 63;
        flips |= (flip as u32) << (31 - bit);
    }
    value ^ flips
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_pair_of_dimensions_is_a_net() {
        let net = SobolSampler::new(64, 5);
        for pair in [0, 1, 7, PAIRS - 1] {
            for pixel in [0, 9] {
                let points: Vec<_> = (0..64).map(|i| net.sample(pixel, i).get_2d(pair)).collect();
                // Each elementary box of area 1/64 holds exactly one point.
                for log_x in 0..=6 {
                    let (nx, ny) = (1usize << log_x, 64usize >> log_x);
                    let mut seen = [false; 64];
                    for [x, y] in &points {
                        let at = (x * nx as f32) as usize * ny + (y * ny as f32) as usize;
                        assert!(!seen[at], "pair {pair}, {nx}×{ny}");
                        seen[at] = true;
                    }
                }
            }
        }
    }

    #[test]
    fn pairs_and_pixels_are_uncorrelated() {
        let net = SobolSampler::new(64, 1);
        let centred = |pixel, pair: usize, index| net.sample(pixel, index).get_2d(pair)[0] - 0.5;
        // Pixels share nets under different shifts, so only the mean over pixels vanishes.
        for (step, pairs) in [(0, [0, 1]), (1, [0, 0]), (320, [2, 5]), (0, [30, 31])] {
            let mut sum = 0.0;
            for pixel in 0..1024 {
                for index in 0..64 {
                    let first = centred(pixel, pairs[0], index);
                    sum += first * centred(pixel + step, pairs[1], index);
                }
            }
            let correlation = 12.0 * sum / (64.0 * 1024.0);
            assert!(correlation.abs() < 0.1, "{step} {pairs:?}: {correlation}");
        }
    }

    #[test]
    fn nets_and_seeds_differ() {
        let net = SobolSampler::new(1 << 14, 0);
        assert_eq!(net.points.len(), MAX_NET as usize);
        assert_ne!(
            net.sample(0, 1).get_2d(0),
            net.sample(0, MAX_NET + 1).get_2d(0)
        );
        assert_ne!(
            net.sample(0, 1).get_2d(0),
            SobolSampler::new(1 << 14, 1).sample(0, 1).get_2d(0)
        );
    }
}
