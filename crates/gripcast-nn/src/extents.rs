//! Predictions from the extents of the object, as the encoders of camera images estimate them.
//!
//! A head that reads camera images has no hidden layer of its own: its log-odds are a weighted sum
//! of the touch head's and of positive and negative parts of a few sums of the extents. How far the
//! object's centre is from the grasp, to whichever side, is such a part; a hidden layer would need
//! many more grasps to find it. The network keeps them as ordinary dense layers.

use super::architecture::{GEOMETRY, HeadParams, Param};
use super::network::Network;
use crate::predict::contract::Modality;

/// Sums of the extents, in the order of
/// [`GraspGeometry::to_array`](gripcast_geometry::GraspGeometry::to_array): bounds along x, y and
/// z, bounds along y at the gels, centre along y and z.
const SUMS: [[f32; GEOMETRY]; EXTENT_UNITS / 2] = [
    // Centre of volume, of the bounds and of the bounds at the gels, along y.
    [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0],
    [0.0, 0.0, 0.5, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.5, 0.0, 0.0],
    // Sizes along y, there at the gels, z and x.
    [0.0, 0.0, -1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 1.0, 0.0, 0.0],
    [0.0, 0.0, 0.0, 0.0, -1.0, 1.0, 0.0, 0.0, 0.0, 0.0],
    [-1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    // Centre of the bounds along x, and of volume along z.
    [0.5, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
    // Ends along z.
    [0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    [0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0],
];

/// Hidden units of a head for the extents of one camera image: positive and negative parts.
pub const EXTENT_UNITS: usize = 22;

/// Weights of the hidden units: the sums, then their negatives.
fn unit_weights() -> impl Iterator<Item = [f32; GEOMETRY]> {
    let negative = SUMS.into_iter().map(|sum| sum.map(|x| -x));
    SUMS.into_iter().chain(negative)
}

/// Values of the hidden units for the extents that an encoder estimates.
///
/// `extents`: at least [`GEOMETRY`] numbers in units of 0.03 m.
pub fn extent_units(extents: &[f32]) -> [f64; EXTENT_UNITS] {
    let mut units = [0.0; EXTENT_UNITS];
    for (unit, weights) in units.iter_mut().zip(unit_weights()) {
        let terms = weights.iter().zip(extents).map(|(w, x)| f64::from(w * x));
        *unit = terms.sum::<f64>().max(0.0);
    }
    units
}

/// Weights of a head that reads camera images.
#[derive(Clone, Debug, PartialEq)]
pub struct ExtentHead {
    /// Weight of the touch head's log-odds; not used by a head without touch.
    pub touch: f64,
    /// Weight of each hidden unit, [`EXTENT_UNITS`] for each camera image in the order of the inputs.
    pub units: Vec<f64>,
    /// Added to the log-odds.
    pub bias: f64,
}

impl Network {
    /// Sets of inputs whose heads are [set](Network::set_extent_head), not trained.
    pub fn extent_heads(&self) -> Vec<Modality> {
        let heads = self.layout().heads.iter();
        let heads = heads.filter(|head| head.reads_extents);
        heads.map(|head| head.modality).collect()
    }

    /// Sets the head of some inputs that reads the extents of the object; does nothing for another.
    pub fn set_extent_head(&mut self, inputs: Modality, set: &ExtentHead) {
        let find = |modality: Modality| {
            let mut heads = self.layout().heads.iter();
            heads.find(|head| head.modality == modality).cloned()
        };
        let Some(head) = find(inputs).filter(|head| head.reads_extents) else {
            return;
        };
        let touch = find(Modality::T).filter(|_| inputs.has_touch());
        let HeadParams { hidden, logit, .. } = &head;
        for param in hidden.iter().chain(logit) {
            self.parameters[param.range()].fill(0.0);
        }
        let mut bias = set.bias;
        let (mut row, mut column) = (0, 0);
        if let Some(touch) = touch {
            let [rows, columns] = touch.hidden[0].shape;
            for i in 0..rows {
                let values = self.values(&touch.hidden[0])[i * columns..][..columns].to_vec();
                self.write(&hidden[0], [i, 0], &values);
            }
            let values = self.values(&touch.hidden[1]).to_vec();
            self.write(&hidden[1], [0, 0], &values);
            let weights = self.values(&touch.logit[0]).iter();
            let weights: Vec<f32> = weights
                .map(|w| (f64::from(*w) * set.touch) as f32)
                .collect();
            for (i, weight) in weights.into_iter().enumerate() {
                self.write(&logit[0], [i, 0], &[weight]);
            }
            bias += set.touch * f64::from(self.values(&touch.logit[1])[0]);
            (row, column) = (rows, columns);
        }
        for weights in set.units.chunks_exact(EXTENT_UNITS) {
            for (unit, (of_unit, weight)) in unit_weights().zip(weights).enumerate() {
                for (i, value) in of_unit.into_iter().enumerate() {
                    self.write(&hidden[0], [row + i, column + unit], &[value]);
                }
                self.write(&logit[0], [column + unit, 0], &[*weight as f32]);
            }
            row += self.architecture().camera_embedding;
            column += EXTENT_UNITS;
        }
        self.write(&logit[1], [0, 0], &[bias as f32]);
    }

    /// Writes values of a tensor from a row and column on.
    fn write(&mut self, param: &Param, [row, column]: [usize; 2], values: &[f32]) {
        let first = param.first + row * param.shape[1] + column;
        self.parameters[first..first + values.len()].copy_from_slice(values);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::tests::{batch, tiny, uniform};

    #[test]
    fn head_is_the_weighted_sum_of_touch_and_extents() {
        let mut draw = uniform(3);
        let mut network = Network::new(&tiny(), Modality::Vtd, &mut draw);
        let heads = network.extent_heads();
        assert_eq!(heads.len(), 6, "all but touch alone: {heads:?}");
        let batch = batch(Modality::Vtd, 3, &mut draw);
        let before = network.outputs(&batch);
        let of = |outputs: &crate::Outputs, network: &Network, inputs: Modality| {
            let at = network.heads().position(|head| head == inputs).unwrap();
            outputs.logits[at].clone()
        };
        let touch = of(&before, &network, Modality::T);
        for inputs in heads {
            let cameras = inputs.cameras().unwrap().inputs();
            let units = (0..cameras.len() * EXTENT_UNITS).map(|_| draw() - 0.5);
            let head = ExtentHead {
                touch: 0.8,
                units: units.collect(),
                bias: 0.3,
            };
            network.set_extent_head(inputs, &head);
            let outputs = network.outputs(&batch);
            for (sample, found) in of(&outputs, &network, inputs).into_iter().enumerate() {
                let mut expected = head.bias;
                if inputs.has_touch() {
                    expected += head.touch * f64::from(touch[sample]);
                }
                for (camera, weights) in cameras.iter().zip(head.units.chunks(EXTENT_UNITS)) {
                    let (_, extents) = outputs.geometry.iter().find(|(c, _)| c == camera).unwrap();
                    let units = extent_units(&extents[sample * GEOMETRY..]);
                    let terms = units
                        .iter()
                        .zip(weights)
                        .map(|(unit, weight)| unit * weight);
                    expected += terms.sum::<f64>();
                }
                let error = (f64::from(found) - expected).abs();
                assert!(
                    error < 1e-4 * (1.0 + expected.abs()),
                    "{inputs:?} {found} {expected}"
                );
            }
            assert_eq!(of(&outputs, &network, Modality::T), touch);
        }
    }

    #[test]
    fn units_are_both_parts_of_each_sum() {
        let extents = [-1.0, 1.5, -2.0, 3.0, -0.5, 2.0, -1.0, 2.0, -0.25, 0.75];
        let units = extent_units(&extents);
        let half = EXTENT_UNITS / 2;
        assert_eq!((units[0], units[half]), (0.0, 0.25));
        assert_eq!((units[1], units[half + 1]), (0.5, 0.0));
        assert_eq!(
            (units[3], units[4], units[5], units[6]),
            (5.0, 3.0, 2.5, 2.5)
        );
        assert_eq!((units[9], units[half + 9]), (0.0, 0.5));
    }
}
