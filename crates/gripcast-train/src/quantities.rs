//! What a simulation knows of a grasp beside its label. Training lets the network guess it as well,
//! so that few labels go further (Caruana, "Multitask learning", 1997); the model that comes out
//! does not.

use super::samples::Samples;
use gripcast_dataset::shard::ShardFacts;

/// Number of the quantities.
pub(super) const QUANTITIES: usize = 7;
/// Those that change their sign when the fingers swap, and when the gripper is turned.
const X: usize = 0;
const Y: usize = 1;

/// Quantities of a sample, NaN where they are not known.
pub(super) type Quantities = [f32; QUANTITIES];

/// Place of the object's origin in the gripper's frame (x, y, z, m), opening (m), logarithm of the
/// mass (kg), friction, logarithm of the mean normal force (N).
pub(super) fn quantities(facts: &ShardFacts) -> Quantities {
    let place = facts.t_object_gripper.as_ref();
    let place = place.map(|pose| pose.inverse().translation_m.to_array());
    let [x, y, z] = place.map_or([None; 3], |place| place.map(Some));
    let force_n = facts.force_left_n.zip(facts.force_right_n);
    let force_n = force_n.map(|(left, right)| 0.5 * (left + right));
    let ln = |value: Option<f64>| value.filter(|value| *value > 0.0).map(f64::ln);
    [
        x,
        y,
        z,
        facts.opening_m,
        ln(facts.mass_kg),
        facts.friction,
        ln(force_n),
    ]
    .map(|value| value.map_or(f32::NAN, |value| value as f32))
}

/// Means and deviations, by which all quantities get the same size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct QuantityScale {
    mean: Quantities,
    deviation: Quantities,
}

impl QuantityScale {
    /// Of the known quantities of a part.
    pub(super) fn of(samples: &Samples) -> Self {
        let mut scale = Self {
            mean: [0.0; QUANTITIES],
            deviation: [1.0; QUANTITIES],
        };
        for at in 0..QUANTITIES {
            let all = samples.facts().iter().map(|facts| facts.quantities[at]);
            let known: Vec<f64> = all.filter(|q| !q.is_nan()).map(f64::from).collect();
            if known.is_empty() {
                continue;
            }
            let count = known.len() as f64;
            // Those with a sign are as often on the one side as on the other.
            let mean = if at == X || at == Y {
                0.0
            } else {
                known.iter().sum::<f64>() / count
            };
            let square = known.iter().map(|q| (q - mean).powi(2)).sum::<f64>() / count;
            scale.mean[at] = mean as f32;
            // What is the same in all samples teaches nothing.
            if square > 0.0 {
                scale.deviation[at] = square.sqrt() as f32;
            }
        }
        scale
    }

    /// What the network is to guess where the pictures show fingers `swapped` or the gripper
    /// `turned` about its approach.
    pub(super) fn seen(&self, known: &Quantities, swapped: bool, turned: bool) -> Quantities {
        let mut seen = [0.0; QUANTITIES];
        for at in 0..QUANTITIES {
            let flips = (at == X && swapped) || (at == Y && turned);
            let sign = if flips { -1.0 } else { 1.0 };
            seen[at] = (sign * known[at] - self.mean[at]) / self.deviation[at];
        }
        seen
    }
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, DVec3};

    use super::*;
    use crate::sample_dataset::{row, write_part};
    use gripcast_geometry::Pose;

    #[test]
    fn quantities_are_those_of_the_grasp_and_turn_with_the_gripper() {
        let folder = tempfile::tempdir().unwrap();
        let rows = [-1.0, 1.0].map(|way| {
            let mut row = row("train", 1);
            row.facts.id = format!("{way}");
            // The gripper looks down; the object lies 10 mm along its x and 5 mm along its y.
            let down = DQuat::from_rotation_x(std::f64::consts::PI);
            let place = DVec3::new(0.01, 0.005, 0.02 + 0.01 * way);
            row.facts.t_object_gripper = Some(Pose::new(down, -(down * place)));
            row.facts.opening_m = Some(0.03 + 0.01 * way);
            row.facts.mass_kg = None;
            row
        });
        write_part(folder.path(), "train", rows);
        let samples = Samples::open(folder.path(), "train").unwrap();
        let known = samples.facts()[1].quantities;
        let expected = [0.01, 0.005, 0.03, 0.04, f32::NAN, 0.5, 5_f32.ln()];
        for (at, (found, expected)) in known.iter().zip(expected).enumerate() {
            let alike = (found - expected).abs() < 1e-6 || (found.is_nan() && expected.is_nan());
            assert!(alike, "{at}: {found} {expected}");
        }
        let scale = QuantityScale::of(&samples);
        for (swapped, turned) in [(false, false), (true, false), (true, true)] {
            let seen = scale.seen(&known, swapped, turned);
            let sign = |flips: bool| if flips { -1.0 } else { 1.0 };
            let expected = [sign(swapped), sign(turned), 1.0, 1.0, f32::NAN, 0.0, 0.0];
            for (at, (found, expected)) in seen.iter().zip(expected).enumerate() {
                let alike =
                    (found - expected).abs() < 1e-4 || (found.is_nan() && expected.is_nan());
                assert!(alike, "{at}: {found} {expected}");
            }
        }
    }
}
