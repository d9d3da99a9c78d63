//! Whether a tactile difference is like those that a model was trained on.
//!
//! A classifier answers anything with a probability: a gel of another maker, a lamp that went
//! out, an initial frame taken in contact. A model therefore carries the mean and the covariance
//! of sixteen plain features of its training differences; what lies further away than nearly all
//! of them (by Mahalanobis distance, as in Lee et al., *A simple unified framework for detecting
//! out-of-distribution samples*, 2018, there on layers of the network) is none of its business.

use serde::{Deserialize, Serialize};

use crate::predict::contract::{IMAGE_HEIGHT, IMAGE_WIDTH};
use gripcast_base::error::{Error, Result};
use gripcast_imaging::TactileDifference;

/// Key of the metadata.
pub const METADATA: &str = "gripcast.novelty";
/// Features of a difference.
pub const FEATURES: usize = 16;
/// Fraction of the training differences that lie nearer than the limit.
pub const QUANTILE: f64 = 0.999;

const WIDTH: usize = IMAGE_WIDTH as usize;
const HEIGHT: usize = IMAGE_HEIGHT as usize;
/// Side of the blocks over which the light is averaged, pixels.
const BLOCK: usize = 8;
const COLUMNS: usize = WIDTH / BLOCK;
const ROWS: usize = HEIGHT / BLOCK;
/// One grey level: smaller changes are noise.
const LEVEL: f64 = 1.0 / 255.0;
/// Change from which a block counts as touched, grey levels.
const TOUCHED_LEVELS: f64 = 10.0;
/// Fraction of a feature's variance that is added to it, so that the covariance has an inverse.
const SHRINKAGE: f64 = 1e-3;
/// Least limit, deviations: images that are all alike say nothing about how far is far.
const MIN_LIMIT: f64 = 1.0;
/// Least variance of a feature.
const MIN_VARIANCE: f64 = 1e-6;

/// What a difference looks like, in numbers.
pub type Features = [f64; FEATURES];

/// Features of a tactile difference of 320×240 pixels, `R, G, B` of each, (grasp − initial) / 255;
/// none for another number of values.
///
/// Mean of each colour; logarithms of the deviations of the colours between blocks, of the
/// difference between neighbouring pixels, between neighbouring blocks, and of the largest change;
/// the correlations of the colours; the fraction of touched blocks; mean over mean magnitude of each
/// colour.
pub fn features(values: &[f32]) -> Option<Features> {
    if values.len() != WIDTH * HEIGHT * 3 {
        return None;
    }
    let (blocks, roughness) = blocks(values);
    let count = blocks.len() as f64;
    let mean: [f64; 3] = sum(&blocks, |block| *block).map(|s| s / count);
    let size: [f64; 3] = sum(&blocks, |block| block.map(f64::abs)).map(|s| s / count);
    let off = |block: &[f64; 3], c: usize| block[c] - mean[c];
    let variance = sum(&blocks, |block| {
        std::array::from_fn(|c| off(block, c) * off(block, c))
    });
    let deviation = variance.map(|s| (s / count).sqrt());
    let covariance = sum(&blocks, |block| {
        [[0, 1], [1, 2], [0, 2]].map(|[a, b]| off(block, a) * off(block, b))
    });
    let correlation = |pair: usize, [a, b]: [usize; 2]| {
        covariance[pair] / count / (deviation[a] * deviation[b] + LEVEL * LEVEL)
    };
    let largest = |block: &[f64; 3]| block.iter().fold(0.0, |most: f64, v| most.max(v.abs()));
    let peak = blocks.iter().map(largest).fold(0.0, f64::max);
    let is_touched = |block: &&[f64; 3]| largest(block) > TOUCHED_LEVELS * LEVEL;
    let touched = blocks.iter().filter(is_touched).count() as f64 / count;
    let log = |x: f64| (LEVEL + x).ln();
    let lean: [f64; 3] = std::array::from_fn(|c| mean[c] / (size[c] + LEVEL));
    let [r, g, b] = deviation.map(log);
    Some([
        mean[0],
        mean[1],
        mean[2],
        r,
        g,
        b,
        log(roughness),
        log(steps(&blocks)),
        log(peak),
        correlation(0, [0, 1]),
        correlation(1, [1, 2]),
        correlation(2, [0, 2]),
        touched,
        lean[0],
        lean[1],
        lean[2],
    ])
}

/// Features of an image's change; none where it is not 320×240.
pub fn features_of(difference: &TactileDifference) -> Option<Features> {
    let values: Vec<f32> = difference
        .levels()
        .iter()
        .map(|level| f32::from(*level) / 255.0)
        .collect();
    let is_size = (difference.width(), difference.height()) == (IMAGE_WIDTH, IMAGE_HEIGHT);
    is_size.then(|| features(&values)).flatten()
}

fn sum(blocks: &[[f64; 3]], of: impl Fn(&[f64; 3]) -> [f64; 3]) -> [f64; 3] {
    blocks.iter().fold([0.0; 3], |sum, block| {
        let value = of(block);
        std::array::from_fn(|c| sum[c] + value[c])
    })
}

/// Mean colours of the blocks, row by row, and the mean difference of pixels side by side.
fn blocks(values: &[f32]) -> (Vec<[f64; 3]>, f64) {
    let mut sums = vec![[0.0_f32; 3]; COLUMNS * ROWS];
    let mut rough = 0.0;
    for (y, row) in values.chunks_exact(3 * WIDTH).enumerate() {
        let pixels = row.as_chunks::<3>().0;
        for (x, pixel) in pixels.iter().enumerate() {
            let sum = &mut sums[y / BLOCK * COLUMNS + x / BLOCK];
            for c in 0..3 {
                sum[c] += pixel[c];
            }
        }
        let of_row: f32 = row.iter().zip(&row[3..]).map(|(a, b)| (a - b).abs()).sum();
        rough += f64::from(of_row);
    }
    let area = (BLOCK * BLOCK) as f64;
    let means = sums.iter().map(|sum| sum.map(|s| f64::from(s) / area));
    let rough = rough / (3 * (WIDTH - 1) * HEIGHT) as f64;
    (means.collect(), rough)
}

/// Mean difference of blocks side by side.
fn steps(blocks: &[[f64; 3]]) -> f64 {
    let of_row = |row: &[[f64; 3]]| -> f64 {
        let pairs = row.iter().zip(&row[1..]);
        pairs
            .map(|(a, b)| (0..3).map(|c| (a[c] - b[c]).abs()).sum::<f64>())
            .sum()
    };
    blocks.chunks_exact(COLUMNS).map(of_row).sum::<f64>() / (3 * (COLUMNS - 1) * ROWS) as f64
}

/// What a model's training differences look like, and how far from them is too far.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Novelty {
    /// Mean of each feature.
    mean: Features,
    /// Lower triangle, row by row, of the matrix that makes features uncorrelated with variance 1.
    whitening: Vec<f64>,
    /// Largest distance of what counts as known.
    limit: f64,
}

impl Novelty {
    /// Fits to the features of training differences; none for fewer than twice the number of
    /// features, and for images that are all alike.
    pub fn fit(known: &[Features]) -> Option<Self> {
        if known.len() < 2 * FEATURES {
            return None;
        }
        let count = known.len() as f64;
        let mut mean = [0.0; FEATURES];
        for row in known {
            for (mean, value) in mean.iter_mut().zip(row) {
                *mean += value / count;
            }
        }
        let mut covariance = [[0.0; FEATURES]; FEATURES];
        for row in known {
            for i in 0..FEATURES {
                for j in 0..=i {
                    covariance[i][j] += (row[i] - mean[i]) * (row[j] - mean[j]) / count;
                }
            }
        }
        for (i, row) in covariance.iter_mut().enumerate() {
            row[i] += SHRINKAGE * row[i] + MIN_VARIANCE;
        }
        let mut fitted = Self {
            mean,
            whitening: inverse_of_factor(&covariance)?,
            limit: 0.0,
        };
        let mut distances: Vec<f64> = known.iter().map(|row| fitted.distance(row)).collect();
        distances.sort_unstable_by(f64::total_cmp);
        let at = (QUANTILE * (count - 1.0)).ceil() as usize;
        fitted.limit = *distances.get(at)?;
        (fitted.is_usable() && fitted.limit >= MIN_LIMIT).then_some(fitted)
    }

    /// Reads the metadata of a model.
    ///
    /// # Errors
    /// `Input` where the text is no description of training differences.
    pub fn of_metadata(text: &str) -> Result<Self> {
        let refused = |what: &str| {
            let what = format!("`{METADATA}` of the model {what}");
            Error::input(what).remedy("train or export the model again")
        };
        let found: Self = serde_json::from_str(text)
            .map_err(|e| refused("is no description of training images").because(e))?;
        match found.is_usable() {
            true => Ok(found),
            false => Err(refused(
                "has numbers that are not finite, or not as many as features",
            )),
        }
    }

    /// The text for the metadata of a model.
    pub fn to_metadata(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }

    /// Distance of a difference from the mean of what is known, in standard deviations; about
    /// √16 for what is usual.
    pub fn distance(&self, features: &Features) -> f64 {
        let mut square = 0.0;
        let mut rest = &self.whitening[..];
        for i in 0..FEATURES {
            let (row, after) = rest.split_at((i + 1).min(rest.len()));
            rest = after;
            let terms = row.iter().zip(features.iter().zip(&self.mean));
            let value: f64 = terms.map(|(w, (x, mean))| w * (x - mean)).sum();
            square += value * value;
        }
        square.sqrt()
    }

    /// Distance over the limit: above 1 for what the model knows nothing of.
    pub fn score(&self, difference: &TactileDifference) -> Option<f64> {
        Some(self.distance(&features_of(difference)?) / self.limit)
    }

    /// The highest [`score`](Self::score) of a grasp's tactile differences.
    pub fn of_touch<'a>(
        &self,
        differences: impl IntoIterator<Item = &'a TactileDifference>,
    ) -> Option<f64> {
        let scores = differences.into_iter().filter_map(|seen| self.score(seen));
        scores.reduce(f64::max)
    }

    fn is_usable(&self) -> bool {
        let numbers = self.mean.iter().chain(&self.whitening);
        numbers.chain([&self.limit]).all(|x| x.is_finite())
            && self.whitening.len() == FEATURES * (FEATURES + 1) / 2
            && self.limit > 0.0
    }
}

/// Inverse of the Cholesky factor of a covariance whose lower triangle is given.
fn inverse_of_factor(covariance: &[[f64; FEATURES]; FEATURES]) -> Option<Vec<f64>> {
    let mut factor = [[0.0; FEATURES]; FEATURES];
    for i in 0..FEATURES {
        for j in 0..=i {
            let done: f64 = (0..j).map(|k| factor[i][k] * factor[j][k]).sum();
            let rest = covariance[i][j] - done;
            factor[i][j] = match i == j {
                true if rest > 0.0 => rest.sqrt(),
                true => return None,
                false => rest / factor[j][j],
            };
        }
    }
    // Column by column by forward substitution.
    let column = |at: usize| {
        let mut values = [0.0; FEATURES];
        for (row, of_row) in factor.iter().enumerate().skip(at) {
            let before = of_row[at..row].iter().zip(&values[at..row]);
            let done: f64 = before.map(|(a, b)| a * b).sum();
            values[row] = (f64::from(u8::from(row == at)) - done) / of_row[row];
        }
        values
    };
    let columns: Vec<Features> = (0..FEATURES).map(column).collect();
    let row = |at: usize| columns[..=at].iter().map(move |column| column[at]);
    Some((0..FEATURES).flat_map(row).collect())
}

#[cfg(test)]
mod tests {
    use image::{Rgb, RgbImage};

    use super::*;
    use gripcast_imaging::synthetic_gel;

    fn difference(seed: u64, contact: f32) -> TactileDifference {
        let gel = |contact| synthetic_gel(IMAGE_WIDTH, IMAGE_HEIGHT, seed, contact);
        TactileDifference::between(&gel(0.0), &gel(contact)).unwrap()
    }

    fn known() -> Novelty {
        let contacts = (0..80).map(|seed| difference(seed, 0.01 * seed as f32));
        let rows: Vec<Features> = contacts.map(|d| features_of(&d).unwrap()).collect();
        Novelty::fit(&rows).unwrap()
    }

    #[test]
    fn what_was_trained_on_is_known_and_other_things_are_not() {
        let novelty = known();
        for (seed, contact) in [(200, 0.1), (201, 0.4), (202, 0.7)] {
            let score = novelty.score(&difference(seed, contact)).unwrap();
            assert!(score < 1.2, "{contact}: {score}");
        }
        let stripes = RgbImage::from_fn(IMAGE_WIDTH, IMAGE_HEIGHT, |x, _| {
            Rgb([if x / 4 % 2 == 0 { 20 } else { 220 }; 3])
        });
        let dark = RgbImage::new(IMAGE_WIDTH, IMAGE_HEIGHT);
        let gel = synthetic_gel(IMAGE_WIDTH, IMAGE_HEIGHT, 1, 0.0);
        let usual = difference(203, 0.3);
        for other in [&stripes, &dark] {
            let odd = TactileDifference::between(&gel, other).unwrap();
            assert!(novelty.score(&odd).unwrap() > 2.0);
            // One odd sensor is enough.
            for pair in [[&odd, &usual], [&usual, &odd]] {
                assert_eq!(novelty.of_touch(pair), novelty.score(&odd));
            }
        }
        assert_eq!(novelty.of_touch([]), None);
    }

    #[test]
    fn distances_are_those_of_the_covariance() {
        // Independent uniform numbers: their distance is the length in deviations.
        let mut state = 1_u64;
        let mut uniform = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        let rows: Vec<Features> = (0..4000)
            .map(|_| std::array::from_fn(|i| (2.0 * uniform() - 1.0) * (1.0 + i as f64)))
            .collect();
        let novelty = Novelty::fit(&rows).unwrap();
        let mut far = [0.0; FEATURES];
        far[5] = 6.0;
        // 6 in a feature of ±6 is √3 deviations, but for the few rows.
        let distance = novelty.distance(&far);
        assert!((distance / 3_f64.sqrt() - 1.0).abs() < 0.06, "{distance}");
        let beyond = rows
            .iter()
            .filter(|row| novelty.distance(row) > novelty.limit);
        assert!(beyond.count() <= 4);
    }

    #[test]
    fn the_metadata_comes_back_and_damage_is_explained() {
        let novelty = known();
        let text = novelty.to_metadata();
        assert_eq!(Novelty::of_metadata(&text).unwrap(), novelty);
        let short = text.replacen("\"whitening\":[", "\"whitening\":[0.5,", 1);
        for bad in [
            "",
            "{}",
            "7",
            &short,
            &text.replace("\"limit\":", "\"limit\":-"),
        ] {
            let error = Novelty::of_metadata(bad).unwrap_err().to_string();
            assert!(error.contains(METADATA), "{error}");
        }
    }

    #[test]
    fn too_few_and_equal_images_are_no_fit_of_zeros() {
        assert_eq!(Novelty::fit(&[[0.0; FEATURES]; 5]), None);
        assert_eq!(features(&[0.0; 7]), None);
        // All alike: nothing says how far is far.
        assert_eq!(Novelty::fit(&[[1.0; FEATURES]; 50]), None);
    }
}
