//! Reproducible random numbers from a seed and a name.

use std::f64::consts::TAU;

/// Step of SplitMix64: 2⁶⁴ divided by the golden ratio.
const STEP: u64 = 0x9e37_79b9_7f4a_7c15;

/// A sequence of random numbers: a named sub-stream of a seed.
///
/// SplitMix64 (Steele et al., *Fast splittable pseudorandom number generators*, 2014) started at
/// a hash of both.
#[derive(Clone, Debug)]
pub struct SeedStream(u64);

impl SeedStream {
    /// The sub-stream `name` of `seed`.
    pub fn named(seed: u64, name: &str) -> Self {
        // FNV-1a of the name.
        let hash = name.bytes().fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
            (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
        });
        Self(mix(seed ^ mix(hash)))
    }

    /// Draws 64 bits.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(STEP);
        mix(self.0)
    }

    /// Draws uniformly from 0..1.
    pub fn uniform(&mut self) -> f64 {
        unit(self.bits())
    }

    /// Draws uniformly from `low..high`.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// Draws log-uniformly from `low..high`, both positive.
    pub fn between_log(&mut self, low: f64, high: f64) -> f64 {
        (self.between(low.ln(), high.ln())).exp()
    }

    /// Draws an index below `count`; 0 if `count` is 0.
    pub fn index(&mut self, count: usize) -> usize {
        ((self.uniform() * count as f64) as usize).min(count.saturating_sub(1))
    }

    /// Draws one of the items.
    pub fn pick<T: Copy, const N: usize>(&mut self, items: [T; N]) -> T {
        const { assert!(N > 0) };
        items[self.index(N)]
    }
}

/// Two standard normal numbers for an item of a seed.
pub fn gaussians(seed: u64, item: u64) -> [f32; 2] {
    let bits = mix(seed ^ scramble(item));
    // Above 0, for the logarithm.
    let a = ((bits >> 40) as f64 + 1.0) / f64::from(1 << 24);
    let b = f64::from((bits & 0xff_ffff) as u32) / f64::from(1 << 24);
    let (radius, angle) = ((-2.0 * a.ln()).sqrt(), TAU * b);
    [(radius * angle.cos()) as f32, (radius * angle.sin()) as f32]
}

/// Hash of three lattice coordinates, in 0..1.
pub fn lattice(seed: u64, x: i64, y: i64, z: i64) -> f32 {
    let hash = mix(seed ^ (x as u64).wrapping_mul(STEP));
    let hash = mix(hash ^ (y as u64).wrapping_mul(0xc2b2_ae3d_27d4_eb4f));
    unit(mix(hash ^ (z as u64).wrapping_mul(0x1656_67b1_9e37_79f9))) as f32
}

/// Maps bits to a number uniform in 0..1.
pub fn unit(bits: u64) -> f64 {
    (bits >> 11) as f64 / (1_u64 << 53) as f64
}

/// Number `counter` of the SplitMix64 sequence of a seed.
pub fn numbered(seed: u64, counter: u64) -> u64 {
    mix(seed.wrapping_add(counter.wrapping_add(1).wrapping_mul(STEP)))
}

/// A bijective mix of 64 bits: one step of SplitMix64 from `value`.
pub fn scramble(value: u64) -> u64 {
    mix(value.wrapping_add(STEP))
}

/// The finaliser of SplitMix64.
#[inline(always)]
pub fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stream_depends_on_seed_and_name() {
        let first = |seed, name| SeedStream::named(seed, name).bits();
        assert_eq!(first(1, "sky"), first(1, "sky"));
        assert_ne!(first(1, "sky"), first(2, "sky"));
        assert_ne!(first(1, "sky"), first(1, "ground"));
    }

    #[test]
    fn generator_is_splitmix64() {
        // First numbers of the seed 1234567 by Vigna's splitmix64.c.
        let first = [
            6_457_827_717_110_365_317,
            3_203_168_211_198_807_973,
            9_817_491_932_198_370_423,
        ];
        assert_eq!([0, 1, 2].map(|counter| numbered(1_234_567, counter)), first);
        assert_eq!(scramble(1_234_567), first[0]);
    }

    #[test]
    fn distributions_have_their_moments() {
        let mut stream = SeedStream::named(7, "test");
        let mean = (0..10_000).map(|_| stream.uniform()).sum::<f64>() / 1e4;
        assert!((mean - 0.5).abs() < 0.02, "{mean}");
        let count = 20_000;
        let all: Vec<f64> = (0..count)
            .flat_map(|i| gaussians(3, i))
            .map(f64::from)
            .collect();
        let n = all.len() as f64;
        let mean = all.iter().sum::<f64>() / n;
        let variance = all.iter().map(|v| v * v).sum::<f64>() / n;
        assert!(
            mean.abs() < 0.03 && (variance - 1.0).abs() < 0.03,
            "{mean} {variance}"
        );
        assert!(all.iter().all(|v| v.is_finite()));
    }
}
