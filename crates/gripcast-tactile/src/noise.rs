//! Camera noise and drift of exposure and white balance, sampled from a seed.

use gripcast_base::random::scramble;
use serde::{Deserialize, Serialize};

/// Gain, offset and noise of one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameNoise {
    /// Gain of red, green, blue.
    pub gain: [f32; 3],
    /// Offset of red, green, blue after the gain, grey levels.
    pub offset: [f32; 3],
    /// Seed of the pixel noise; `None` for no noise.
    pub noise_seed: Option<u64>,
}

impl Default for FrameNoise {
    /// No drift, no noise.
    fn default() -> Self {
        Self {
            gain: [1.0; 3],
            offset: [0.0; 3],
            noise_seed: None,
        }
    }
}

/// Distribution of gain and offset between frames: I = pivot + gain · (I₀ − pivot) + offset, per
/// channel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Drift {
    /// Standard deviation of the gain of red, green, blue around 1.
    pub gain_std: [f64; 3],
    /// Standard deviation of the offset of red, green, blue, grey levels.
    pub offset_std: [f64; 3],
    /// Grey level unchanged by the gain: the mean of the background, about which gain and offset
    /// vary independently.
    pub pivot: [f64; 3],
}

impl Drift {
    /// Samples gain, offset and noise of a frame from a seed.
    pub fn sample(&self, seed: u64) -> FrameNoise {
        let deviation = |stream: u64, std: f64| {
            let bits = scramble(seed ^ scramble(stream.wrapping_add(0x6472_6966)));
            std as f32 * deviates(bits)[0]
        };
        let gain: [f32; 3] = std::array::from_fn(|c| 1.0 + deviation(c as u64, self.gain_std[c]));
        FrameNoise {
            gain,
            offset: std::array::from_fn(|c| {
                deviation(3 + c as u64, self.offset_std[c]) + (1.0 - gain[c]) * self.pivot[c] as f32
            }),
            noise_seed: Some(scramble(seed ^ 0x6e6f_6973)),
        }
    }
}

/// Bits of a deviate; a word of 64 bits holds those of three channels.
const DEVIATE_BITS: u32 = 21;

/// Repeats a pattern of [`DEVIATE_BITS`] for the three channels.
const fn for_channels(pattern: u64) -> u64 {
    pattern | pattern << DEVIATE_BITS | pattern << (2 * DEVIATE_BITS)
}

/// Unit-variance noise of a pixel's channels.
#[inline]
pub(super) fn pixel_noise(seed: u64, pixel: usize) -> [f32; 3] {
    deviates(scramble(
        seed ^ (pixel as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15),
    ))
}

/// Approximately normal deviates of three times 21 bits: 16 coins and a 5-bit uniform variable that
/// fills the steps.
#[inline]
fn deviates(bits: u64) -> [f32; 3] {
    /// 1/√(16/4 + 1/12) per 1/64 of a coin.
    const SCALE: f32 = 0.494_881_7 / 64.0;
    /// Mean of the sum, 1/64 of a coin: 8 coins and 15.5 of 32 steps.
    const MEAN: i32 = 8 * 64 + 31;
    // Counts the coins of the three channels together.
    let coins = bits & for_channels(0xffff);
    let pairs = coins - ((coins >> 1) & for_channels(0x5555));
    let quads = (pairs & for_channels(0x3333)) + ((pairs >> 2) & for_channels(0x3333));
    let bytes = (quads + (quads >> 4)) & for_channels(0x0f0f);
    let counts = (bytes + (bytes >> 8)) & for_channels(0x1f);
    let sums = (counts << 6) + ((bits >> 15) & for_channels(0x3e));
    let deviate =
        |channel: u32| (((sums >> (channel * DEVIATE_BITS)) & 0x7ff) as i32 - MEAN) as f32 * SCALE;
    [deviate(0), deviate(1), deviate(2)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deviate_counts_coins_and_fills_the_steps() {
        for item in 0..2000 {
            let bits = scramble(item);
            for (channel, found) in deviates(bits).into_iter().enumerate() {
                let bits = bits >> (21 * channel);
                let coins = f64::from((bits & 0xffff).count_ones()) - 8.0;
                let fill = (((bits >> 16) & 31) as f64 - 15.5) / 32.0;
                let expected = (coins + fill) / (4.0 + 1.0 / 12.0_f64).sqrt();
                assert!((f64::from(found) - expected).abs() < 1e-4);
            }
        }
    }

    #[test]
    fn noise_is_white_with_unit_variance() {
        let draws: Vec<[f32; 3]> = (0..40_000).map(|i| pixel_noise(7, i)).collect();
        for c in 0..3 {
            let mean: f32 = draws.iter().map(|d| d[c]).sum::<f32>() / 40_000.0;
            let square: f32 = draws.iter().map(|d| d[c] * d[c]).sum::<f32>() / 40_000.0;
            let fourth: f32 = draws.iter().map(|d| d[c].powi(4)).sum::<f32>() / 40_000.0;
            let lag: f32 = draws.windows(2).map(|w| w[0][c] * w[1][c]).sum::<f32>() / 40_000.0;
            let cross: f32 = draws.iter().map(|d| d[c] * d[(c + 1) % 3]).sum::<f32>() / 40_000.0;
            assert!(mean.abs() < 0.02 && (square - 1.0).abs() < 0.02);
            assert!((fourth - 2.9).abs() < 0.15, "{fourth}");
            assert!(lag.abs() < 0.02 && cross.abs() < 0.02);
        }
    }

    #[test]
    fn drift_depends_on_seed_and_matches_its_std() {
        let drift = Drift {
            gain_std: [0.05, 0.0, 0.02],
            offset_std: [3.0, 1.0, 0.0],
            pivot: [100.0; 3],
        };
        assert_eq!(drift.sample(3), drift.sample(3));
        assert_ne!(drift.sample(3), drift.sample(4));
        let frames: Vec<FrameNoise> = (0..4000).map(|seed| drift.sample(seed)).collect();
        let std = |value: &dyn Fn(&FrameNoise) -> f32| {
            (frames.iter().map(|l| value(l).powi(2)).sum::<f32>() / 4000.0).sqrt()
        };
        assert!((std(&|l| l.gain[0] - 1.0) - 0.05).abs() < 0.003);
        // The pivot moves by the offset alone.
        assert!((std(&|l| l.gain[0] * 100.0 + l.offset[0] - 100.0) - 3.0).abs() < 0.15);
        assert!(frames.iter().all(|l| l.gain[1] == 1.0));
    }
}
