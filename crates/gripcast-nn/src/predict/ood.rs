//! Detects out-of-distribution (OOD) tactile differences.
//!
//! A classifier returns a probability for any input: another gel, a failed light, an initial frame
//! in contact. A model therefore stores mean and covariance of 16 features of its training
//! differences; inputs with a larger Mahalanobis distance than nearly all of them are OOD (as in
//! Lee et al., *A simple unified framework for detecting out-of-distribution samples*, 2018, there
//! on layers of the network).

use std::array;

use serde::{Deserialize, Serialize};

use super::part;
use crate::predict::contract::{IMAGE_HEIGHT, IMAGE_WIDTH};
use gripcast_base::error::Result;
use gripcast_base::linear::Cholesky;
use gripcast_imaging::TactileDifference;

/// Key in the metadata of a model.
pub const METADATA: &str = "gripcast.novelty";
/// Number of features of a difference.
pub const FEATURES: usize = 16;
/// Fraction of the training differences within the limit.
pub const QUANTILE: f64 = 0.999;

const WIDTH: usize = IMAGE_WIDTH as usize;
const HEIGHT: usize = IMAGE_HEIGHT as usize;
/// Side of the blocks over which values are averaged, pixels.
const BLOCK: usize = 8;
const COLUMNS: usize = WIDTH / BLOCK;
const ROWS: usize = HEIGHT / BLOCK;
/// One grey level, the noise floor.
const LEVEL: f64 = 1.0 / 255.0;
/// Minimum change of a block in contact, grey levels.
const CONTACT_BLOCK_LEVELS: f64 = 10.0;
/// Relative regularisation of the variances, so that the covariance is invertible.
const SHRINKAGE: f64 = 1e-3;
/// Minimum limit, standard deviations; nearly equal images have no meaningful limit.
const MIN_LIMIT: f64 = 1.0;
/// Absolute regularisation of the variances.
const MIN_VARIANCE: f64 = 1e-6;

/// Features of a tactile difference.
pub type Features = [f64; FEATURES];

/// Computes the features of a tactile difference of 320×240 RGB pixels, (grasp − initial) / 255;
/// none for another number of values.
///
/// Mean of each channel; logarithms of the channels' standard deviations between blocks, of the
/// difference between neighbouring pixels, between neighbouring blocks, and of the maximum change;
/// correlations of the channels; fraction of blocks in contact; ratio of mean and mean magnitude of
/// each channel.
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
    let magnitude = |block: &[f64; 3]| block.iter().fold(0.0, |max: f64, v| max.max(v.abs()));
    let peak = blocks.iter().map(magnitude).fold(0.0, f64::max);
    let in_contact = |block: &&[f64; 3]| magnitude(block) > CONTACT_BLOCK_LEVELS * LEVEL;
    let contact = blocks.iter().filter(in_contact).count() as f64 / count;
    let log = |x: f64| (LEVEL + x).ln();
    let bias: [f64; 3] = std::array::from_fn(|c| mean[c] / (size[c] + LEVEL));
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
        contact,
        bias[0],
        bias[1],
        bias[2],
    ])
}

/// Computes the features of a difference; none if it is not 320×240.
pub fn difference_features(difference: &TactileDifference) -> Option<Features> {
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

/// Mean colours of the blocks, row-major, and the mean difference of horizontal neighbours.
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

/// Mean difference of horizontally neighbouring blocks.
fn steps(blocks: &[[f64; 3]]) -> f64 {
    let of_row = |row: &[[f64; 3]]| -> f64 {
        let pairs = row.iter().zip(&row[1..]);
        pairs
            .map(|(a, b)| (0..3).map(|c| (a[c] - b[c]).abs()).sum::<f64>())
            .sum()
    };
    blocks.chunks_exact(COLUMNS).map(of_row).sum::<f64>() / (3 * (COLUMNS - 1) * ROWS) as f64
}

/// Gaussian model of the training differences with a distance limit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OodDetector {
    /// Mean of each feature.
    mean: Features,
    /// Lower triangle, row-major, of the whitening matrix.
    whitening: Vec<f64>,
    /// Distance at which the OOD score is 1.
    limit: f64,
}

impl OodDetector {
    /// Fits the features of training differences; none for fewer rows than twice the number of
    /// features, and for nearly equal images.
    pub fn fit(rows: &[Features]) -> Option<Self> {
        if rows.len() < 2 * FEATURES {
            return None;
        }
        let (mean, covariance) = moments(rows)?;
        let mut fitted = Self {
            mean,
            whitening: whitening(&covariance)?,
            limit: 0.0,
        };
        fitted.limit = fitted.quantile(rows)?;
        (fitted.is_usable() && fitted.limit >= MIN_LIMIT).then_some(fitted)
    }

    /// Adapts the detector to another, smaller set of training differences: `rows` are the features
    /// of `count` differences, augmented.
    ///
    /// The mean is theirs. A few differences do not determine a covariance: that of this detector is
    /// mixed in, as if it were that of twice as many differences as there are features. The limit
    /// is at least this detector's and includes the differences `held_out`, of other objects. None
    /// without rows.
    pub fn adapted(&self, rows: &[Features], count: usize, held_out: &[Features]) -> Option<Self> {
        let (mean, own) = moments(rows)?;
        let known = self.covariance();
        let fraction = count as f64 / (count + 2 * FEATURES) as f64;
        let covariance = array::from_fn(|i| {
            array::from_fn(|j| fraction * own[i][j] + (1.0 - fraction) * known[i][j])
        });
        let mut adapted = Self {
            mean,
            whitening: whitening(&covariance)?,
            limit: self.limit,
        };
        for rows in [rows, held_out] {
            let limit = adapted.quantile(rows).unwrap_or_default();
            adapted.limit = adapted.limit.max(limit);
        }
        adapted.is_usable().then_some(adapted)
    }

    /// OOD score of the mean of another detector's training differences.
    pub fn score_of_mean(&self, other: &Self) -> f64 {
        self.distance(&other.mean) / self.limit
    }

    /// Distance within which [`QUANTILE`] of the rows are; none without rows.
    fn quantile(&self, rows: &[Features]) -> Option<f64> {
        let mut distances: Vec<f64> = rows.iter().map(|row| self.distance(row)).collect();
        distances.sort_unstable_by(f64::total_cmp);
        let index = (QUANTILE * (rows.len() as f64 - 1.0)).ceil() as usize;
        distances.get(index).copied()
    }

    /// Covariance that belongs to the whitening matrix W: (WᵀW)⁻¹ = W⁻¹W⁻ᵀ.
    fn covariance(&self) -> [[f64; FEATURES]; FEATURES] {
        let row = |i: usize| &self.whitening[i * (i + 1) / 2..][..=i];
        let factor: [Features; FEATURES] = array::from_fn(|i| {
            let mut values = [0.0; FEATURES];
            values[..=i].copy_from_slice(row(i));
            values
        });
        let columns = inverse_columns(&factor);
        array::from_fn(|i| {
            array::from_fn(|j| columns.iter().map(|column| column[i] * column[j]).sum())
        })
    }

    /// Parses the metadata of a model.
    ///
    /// # Errors
    /// `Input` for invalid metadata.
    pub fn from_metadata(text: &str) -> Result<Self> {
        part::read(METADATA, text, Self::is_usable)
    }

    /// Serialises the detector for the metadata of a model.
    pub fn to_metadata(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }

    /// Mahalanobis distance of features from the training mean; about √16 for training data.
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

    /// OOD score of a difference: distance divided by the limit.
    pub fn score(&self, difference: &TactileDifference) -> Option<f64> {
        Some(self.distance(&difference_features(difference)?) / self.limit)
    }

    /// Maximum [`score`](Self::score) of a grasp's tactile differences.
    pub fn max_score<'a>(
        &self,
        differences: impl IntoIterator<Item = &'a TactileDifference>,
    ) -> Option<f64> {
        let scores = differences
            .into_iter()
            .filter_map(|difference| self.score(difference));
        scores.reduce(f64::max)
    }

    fn is_usable(&self) -> bool {
        let numbers = self.mean.iter().chain(&self.whitening);
        numbers.chain([&self.limit]).all(|x| x.is_finite())
            && self.whitening.len() == FEATURES * (FEATURES + 1) / 2
            && self.limit > 0.0
    }
}

/// Lower triangle of the inverse Cholesky factor of a covariance, of which the lower triangle is
/// read.
fn whitening(covariance: &[[f64; FEATURES]; FEATURES]) -> Option<Vec<f64>> {
    let cholesky = Cholesky::new(covariance)?;
    let columns = inverse_columns(cholesky.lower());
    let row = |at: usize| columns[..=at].iter().map(move |column| column[at]);
    Some((0..FEATURES).flat_map(row).collect())
}

/// Columns of the inverse of a lower triangular matrix, by forward substitution.
fn inverse_columns(factor: &[Features; FEATURES]) -> [Features; FEATURES] {
    array::from_fn(|at| {
        let mut values = [0.0; FEATURES];
        for (row, of_row) in factor.iter().enumerate().skip(at) {
            let before = of_row[at..row].iter().zip(&values[at..row]);
            let done: f64 = before.map(|(a, b)| a * b).sum();
            values[row] = (f64::from(u8::from(row == at)) - done) / of_row[row];
        }
        values
    })
}

/// Mean and lower triangle of the regularised covariance of some rows; none without rows.
fn moments(rows: &[Features]) -> Option<(Features, [Features; FEATURES])> {
    let count = rows.len() as f64;
    if rows.is_empty() {
        return None;
    }
    let mut mean = [0.0; FEATURES];
    for row in rows {
        for (mean, value) in mean.iter_mut().zip(row) {
            *mean += value / count;
        }
    }
    let mut covariance = [[0.0; FEATURES]; FEATURES];
    for row in rows {
        for i in 0..FEATURES {
            for j in 0..=i {
                covariance[i][j] += (row[i] - mean[i]) * (row[j] - mean[j]) / count;
            }
        }
    }
    for (i, row) in covariance.iter_mut().enumerate() {
        row[i] += SHRINKAGE * row[i] + MIN_VARIANCE;
    }
    Some((mean, covariance))
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

    fn detector() -> OodDetector {
        let contacts = (0..80).map(|seed| difference(seed, 0.01 * seed as f32));
        let rows: Vec<Features> = contacts.map(|d| difference_features(&d).unwrap()).collect();
        OodDetector::fit(&rows).unwrap()
    }

    #[test]
    fn training_images_are_in_distribution_and_others_are_not() {
        let ood = detector();
        for (seed, contact) in [(200, 0.1), (201, 0.4), (202, 0.7)] {
            let score = ood.score(&difference(seed, contact)).unwrap();
            assert!(score < 1.2, "{contact}: {score}");
        }
        let stripes = RgbImage::from_fn(IMAGE_WIDTH, IMAGE_HEIGHT, |x, _| {
            Rgb([if x / 4 % 2 == 0 { 20 } else { 220 }; 3])
        });
        let dark = RgbImage::new(IMAGE_WIDTH, IMAGE_HEIGHT);
        let gel = synthetic_gel(IMAGE_WIDTH, IMAGE_HEIGHT, 1, 0.0);
        let usual = difference(203, 0.3);
        for other in [&stripes, &dark] {
            let outlier = TactileDifference::between(&gel, other).unwrap();
            assert!(ood.score(&outlier).unwrap() > 2.0);
            // One OOD sensor is enough.
            for pair in [[&outlier, &usual], [&usual, &outlier]] {
                assert_eq!(ood.max_score(pair), ood.score(&outlier));
            }
        }
        assert_eq!(ood.max_score([]), None);
    }

    #[test]
    fn distance_is_mahalanobis() {
        // Independent uniform numbers: the distance is the norm in standard deviations.
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
        let ood = OodDetector::fit(&rows).unwrap();
        let mut far = [0.0; FEATURES];
        far[5] = 6.0;
        // 6 in a feature of ±6 is √3 standard deviations, up to sampling error.
        let distance = ood.distance(&far);
        assert!((distance / 3_f64.sqrt() - 1.0).abs() < 0.06, "{distance}");
        let beyond = rows.iter().filter(|row| ood.distance(row) > ood.limit);
        assert!(beyond.count() <= 4);
    }

    #[test]
    fn adapted_detector_knows_own_gels_and_no_longer_the_old_ones() {
        let ood = detector();
        // Gels of another tint: every change is in the green channel, and stronger.
        let tinted = |seed: u64, contact: f32| {
            let gel = |contact: f32| {
                let mut image = synthetic_gel(IMAGE_WIDTH, IMAGE_HEIGHT, seed, contact);
                image.pixels_mut().for_each(|pixel| {
                    let [r, g, _] = pixel.0;
                    pixel.0 = [r / 4, g, g / 2];
                });
                image
            };
            let difference = TactileDifference::between(&gel(0.0), &gel(contact)).unwrap();
            difference_features(&difference).unwrap()
        };
        let own: Vec<Features> = (0..6).map(|n| tinted(n, 0.1 + 0.12 * n as f32)).collect();
        let held_out: Vec<Features> = (0..4)
            .map(|n| tinted(50 + n, 0.15 + 0.15 * n as f32))
            .collect();
        let is_ood = |ood: &OodDetector, row: &Features| ood.distance(row) > ood.limit;
        assert!(own.iter().all(|row| is_ood(&ood, row)));
        let adapted = ood.adapted(&own, own.len(), &held_out).unwrap();
        for row in own.iter().chain(&held_out) {
            assert!(!is_ood(&adapted, row));
        }
        // New grasps of the same gels are known too.
        assert!((0..5).all(|n| !is_ood(&adapted, &tinted(80 + n, 0.12 + 0.12 * n as f32))));
        // The more own grasps, the less of the old covariance: the old gels become unknown.
        let many: Vec<Features> = (0..60).map(|n| tinted(n, 0.1 + 0.01 * n as f32)).collect();
        let sure = ood.adapted(&many, many.len(), &held_out).unwrap();
        let scores = [&adapted, &sure].map(|adapted| adapted.score_of_mean(&ood));
        assert!(scores[0] < scores[1] && scores[1] > 1.0, "{scores:?}");
        assert_eq!(ood.adapted(&[], 0, &held_out), None);
    }

    #[test]
    fn detector_adapted_to_its_own_data_stays_as_it_is() {
        let contacts = (0..80).map(|seed| difference(seed, 0.01 * seed as f32));
        let rows: Vec<Features> = contacts.map(|d| difference_features(&d).unwrap()).collect();
        let ood = OodDetector::fit(&rows).unwrap();
        let adapted = ood.adapted(&rows, rows.len(), &[]).unwrap();
        assert!(ood.score_of_mean(&adapted) < 1e-9);
        for row in &rows {
            let [before, after] = [&ood, &adapted].map(|ood| ood.distance(row));
            assert!(
                (before - after).abs() < 0.01 * (1.0 + before),
                "{before} {after}"
            );
        }
    }

    #[test]
    fn metadata_round_trips_and_damage_is_refused() {
        let ood = detector();
        let text = ood.to_metadata();
        assert_eq!(OodDetector::from_metadata(&text).unwrap(), ood);
        let short = text.replacen("\"whitening\":[", "\"whitening\":[0.5,", 1);
        for bad in [
            "",
            "{}",
            "7",
            &short,
            &text.replace("\"limit\":", "\"limit\":-"),
        ] {
            let error = OodDetector::from_metadata(bad).unwrap_err().to_string();
            assert!(error.contains(METADATA), "{error}");
        }
    }

    #[test]
    fn too_few_or_equal_images_do_not_fit() {
        assert_eq!(OodDetector::fit(&[[0.0; FEATURES]; 5]), None);
        assert_eq!(features(&[0.0; 7]), None);
        // Equal rows have no meaningful limit.
        assert_eq!(OodDetector::fit(&[[1.0; FEATURES]; 50]), None);
    }
}
