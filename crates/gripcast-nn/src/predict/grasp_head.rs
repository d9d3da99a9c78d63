//! Prediction before the lift by boosted trees, from what a network reads in the images: the contact
//! maps of both gels and the extents of the object.
//!
//! Its log-odds are combined with those of the network. On the same readings dense layers predict
//! worse than trees do.

use serde::{Deserialize, Serialize};

use super::BoostedTrees;
use super::contract::{CONTACT_CELLS, CONTACT_CHANNELS, GEOMETRY, Modality};
use super::part;
use gripcast_base::error::{Error, Result};

/// Metadata key of the grasp head.
pub const METADATA: &str = "gripcast.grasp";
/// Number of features of both gels.
pub const GEL_FEATURES: usize = 2 * OF_GEL;
/// Number of features of one gel.
const OF_GEL: usize = 8 + 3 * (CONTACT_CHANNELS - 1);
/// Fraction of the largest displacement from which a cell counts as pressed.
const PRESSED: f32 = 0.2;
/// Sum of displacements that keeps the moments of an untouched gel near 0.
const UNTOUCHED: f32 = 1e-3;
/// Channels whose sign changes if the image is flipped vertically: slope and displacement down.
const FLIPPED: [usize; 2] = [2, 4];
/// Largest log-odds of the network that count.
const MAX_LOGIT: f64 = 12.0;

/// Features of both gels: those of the smaller and of the larger side in turn. They stay as they are
/// if the fingers are swapped, and if the images are mirrored.
///
/// `maps`: contact maps of the left and the right gel, [`CONTACT_CHANNELS`] planes of
/// [`CONTACT_CELLS`] each, as in the outputs `contact_tactile_left` and `contact_tactile_right`.
pub fn gel_features(maps: [&[f32]; 2]) -> [f64; GEL_FEATURES] {
    let [left, right] = maps.map(of_gel);
    let mut all = [0.0; GEL_FEATURES];
    for (i, (left, right)) in left.into_iter().zip(right).enumerate() {
        all[2 * i] = f64::from(left.min(right));
        all[2 * i + 1] = f64::from(left.max(right));
    }
    all
}

/// Sum, largest value, cells, spread, centre and extent of the displacement into the gel; mean, mean
/// absolute value and mean square of the other channels.
fn of_gel(map: &[f32]) -> [f32; OF_GEL] {
    let [rows, columns] = CONTACT_CELLS;
    let cells = rows * columns;
    let mut features = [0.0; OF_GEL];
    let Some((depth, others)) = map.split_at_checked(cells) else {
        return features;
    };
    let count = cells as f32;
    let largest = depth.iter().copied().fold(f32::MIN, f32::max);
    let mean = depth.iter().sum::<f32>() / count;
    let spread = depth.iter().map(|x| (x - mean).powi(2)).sum::<f32>() / count;
    let pressed = depth.iter().filter(|x| **x > PRESSED * largest).count();
    let [mut sum, mut first, mut second] = [0.0, 0.0, 0.0].map(|x| [x; 2]);
    for (cell, depth) in depth.iter().enumerate() {
        let depth = depth.max(0.0);
        let at = [cell % columns, cell / columns];
        for (axis, side) in [columns, rows].into_iter().enumerate() {
            let from_centre = at[axis] as f32 - 0.5 * (side - 1) as f32;
            sum[axis] += depth;
            first[axis] += depth * from_centre;
            second[axis] += depth * from_centre * from_centre;
        }
    }
    let centre = [0, 1].map(|axis| first[axis] / (sum[axis] + UNTOUCHED));
    let extent = [0, 1].map(|axis| second[axis] / (sum[axis] + UNTOUCHED) - centre[axis].powi(2));
    features[..8].copy_from_slice(&[
        sum[0],
        largest,
        pressed as f32,
        spread.sqrt(),
        centre[0],
        centre[1].abs(),
        extent[0],
        extent[1],
    ]);
    let others = others.chunks_exact(cells).take(CONTACT_CHANNELS - 1);
    for (i, values) in others.enumerate() {
        let mean = values.iter().sum::<f32>() / count;
        let mean = match FLIPPED.contains(&(i + 1)) {
            true => mean.abs(),
            false => mean,
        };
        let absolute = values.iter().map(|x| x.abs()).sum::<f32>() / count;
        let squares = values.iter().map(|x| x * x).sum::<f32>() / count;
        features[8 + 3 * i..][..3].copy_from_slice(&[mean, absolute, squares]);
    }
    features
}

/// Prediction from some of the inputs, which include touch.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GraspEstimator {
    /// The inputs.
    #[serde(rename = "variant")]
    pub modality: Modality,
    /// Log-odds from [`gel_features`], then the extents of each camera image, [`GEOMETRY`] numbers in
    /// units of 0.03 m, in the order of the inputs.
    pub trees: BoostedTrees,
    /// Weight of the network's log-odds.
    pub network_weight: f64,
    /// Weight of the trees' log-odds.
    pub trees_weight: f64,
    /// Offset of the log-odds.
    pub offset: f64,
}

impl GraspEstimator {
    /// Number of features for some inputs.
    pub fn features_of(inputs: Modality) -> usize {
        let cameras = inputs.cameras().map_or(0, |c| c.inputs().len());
        GEL_FEATURES + GEOMETRY * cameras
    }

    fn is_usable(&self) -> bool {
        let weights = [self.network_weight, self.trees_weight, self.offset];
        self.modality.has_touch()
            && self.trees.is_usable(Self::features_of(self.modality))
            && weights.iter().all(|x| x.is_finite())
    }

    /// Log-odds that the grasp is stable, from those of the network and of the trees.
    pub fn combined(&self, network: f64, trees: f64) -> f64 {
        let network = network.clamp(-MAX_LOGIT, MAX_LOGIT);
        self.network_weight * network + self.trees_weight * trees + self.offset
    }

    /// Probability that the grasp is stable, from the network's and the features.
    ///
    /// # Errors
    /// `Input`: a feature is not finite.
    pub fn probability(&self, p_network: f64, features: &[f64]) -> Result<f64> {
        let expected = Self::features_of(self.modality);
        if features.len() != expected || features.iter().any(|x| !x.is_finite()) {
            let what = "the contact maps or extents that the model reads are not finite numbers";
            return Err(Error::input(what).remedy("train or export the model again"));
        }
        let network = (p_network / (1.0 - p_network)).ln();
        let logit = self.combined(network, self.trees.score(features));
        Ok(1.0 / (1.0 + (-logit).exp()))
    }
}

/// The grasp head of a model.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct GraspHead {
    /// Estimators by inputs.
    pub estimators: Vec<GraspEstimator>,
}

impl GraspHead {
    /// Reads a head from the metadata of a model.
    ///
    /// # Errors
    /// `Input`: it is damaged.
    pub fn from_metadata(text: &str) -> Result<Self> {
        part::read(METADATA, text, |head: &Self| {
            head.estimators.iter().all(GraspEstimator::is_usable)
        })
    }

    /// Serialises the head for the metadata of a model.
    pub fn to_metadata(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }

    /// The estimator for some inputs, if there is one.
    pub fn of(&self, inputs: Modality) -> Option<&GraspEstimator> {
        self.estimators.iter().find(|e| e.modality == inputs)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CELLS: usize = CONTACT_CELLS[0] * CONTACT_CELLS[1];

    /// A map with a dent at a cell, and slopes that differ by side.
    fn map(row: usize, column: usize, depth: f32, down: f32) -> Vec<f32> {
        let mut map = vec![0.0; CONTACT_CHANNELS * CELLS];
        map[row * CONTACT_CELLS[1] + column] = depth;
        for channel in 1..CONTACT_CHANNELS {
            let sign = if FLIPPED.contains(&channel) {
                down
            } else {
                0.3
            };
            map[channel * CELLS + row * CONTACT_CELLS[1] + column] = sign;
        }
        map
    }

    fn estimator(modality: Modality) -> GraspEstimator {
        GraspEstimator {
            modality,
            // Reads the smaller sum of the displacements.
            trees: BoostedTrees::stump(0, 1.0, -2.0, 2.0),
            network_weight: 0.5,
            trees_weight: 1.0,
            offset: 0.25,
        }
    }

    #[test]
    fn features_are_those_of_the_dents() {
        let features = gel_features([&map(1, 2, 3.0, 0.2), &map(1, 2, 5.0, 0.2)]);
        let near = |found: f64, expected: f64| (found - expected).abs() < 2e-3 * expected.abs();
        assert!(near(features[0], 3.0) && near(features[1], 5.0));
        // One cell is pressed, 2.5 cells left of the centre and above it.
        assert_eq!(features[4..6], [1.0, 1.0]);
        assert!(
            near(features[8], -2.5) && near(features[10], 2.5),
            "{features:?}"
        );
        let untouched = vec![0.0; CONTACT_CHANNELS * CELLS];
        let features = gel_features([&untouched, &untouched]);
        assert!(features.iter().all(|x| *x == 0.0), "{features:?}");
    }

    #[test]
    fn swapped_and_mirrored_gels_have_equal_features() {
        let (left, right) = (map(1, 2, 3.0, 0.2), map(4, 7, 5.0, -0.1));
        let expected = gel_features([&left, &right]);
        assert_eq!(gel_features([&right, &left]), expected);
        let rows = CONTACT_CELLS[0];
        let mirrored = [
            map(rows - 1 - 4, 7, 5.0, 0.1),
            map(rows - 1 - 1, 2, 3.0, -0.2),
        ];
        let found = gel_features([&mirrored[0], &mirrored[1]]);
        let same = found
            .iter()
            .zip(&expected)
            .all(|(a, b)| (a - b).abs() < 1e-5);
        assert!(same, "{found:?} {expected:?}");
    }

    #[test]
    fn probability_combines_network_and_trees() {
        let estimator = estimator(Modality::T);
        let light = [0.5; GEL_FEATURES];
        let firm = [2.0; GEL_FEATURES];
        let p = |p_network, features: &[f64]| estimator.probability(p_network, features).unwrap();
        let logit = |p: f64| (p / (1.0 - p)).ln();
        assert!((logit(p(0.5, &light)) + 1.75).abs() < 1e-12);
        assert!((logit(p(0.5, &firm)) - 2.25).abs() < 1e-12);
        assert!(p(0.9, &firm) > p(0.5, &firm));
        for certain in [0.0, 1.0] {
            assert!((0.0..=1.0).contains(&p(certain, &firm)));
        }
        let error = estimator.probability(0.5, &[f64::NAN; GEL_FEATURES]);
        assert!(error.unwrap_err().what().contains("not finite"));
        assert!(estimator.probability(0.5, &firm[1..]).is_err());
    }

    #[test]
    fn metadata_is_read_back_and_damage_refused() {
        let head = GraspHead {
            estimators: vec![estimator(Modality::Vtd), estimator(Modality::T)],
        };
        let text = head.to_metadata();
        let found = GraspHead::from_metadata(&text).unwrap();
        assert_eq!(found, head);
        assert_eq!(found.of(Modality::T), Some(&head.estimators[1]));
        assert_eq!(found.of(Modality::Td), None);
        for damaged in [
            text.replacen("-2.0", "null", 1),
            text.replacen("[0,1.0,", "[90,1.0,", 1),
            text.replacen("\"T\"", "\"V\"", 1),
            text.replacen("offset", "shift", 1),
            "{}".to_owned(),
        ] {
            assert!(GraspHead::from_metadata(&damaged).is_err(), "{damaged}");
        }
    }
}
