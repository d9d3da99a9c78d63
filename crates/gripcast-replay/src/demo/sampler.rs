//! The grasps of the demo data: drawn places and a person's squeeze.

use super::object::DemoObject;
use gripcast_base::error::Result;
use gripcast_sim::grasp::GripperState;
use gripcast_synth::grasp::{FaultRanges, GraspSampler};

/// A person's squeeze, N.
const FORCE_N: [f64; 2] = [25.0, 50.0];

/// A grasp to try.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Candidate {
    /// Its number among those of its object.
    pub number: usize,
    /// Where the gripper is and how far it is open.
    pub(super) placed: GripperState,
    /// The person's squeeze, N.
    pub(super) stop_force_n: f64,
}

/// Draws the candidates of an object.
pub(super) struct Sampler<'a>(GraspSampler<'a>);

impl<'a> Sampler<'a> {
    pub(super) fn new(object: &'a DemoObject, seed: u64) -> Self {
        let pose = object.t_world_object;
        let ranges = FaultRanges::COLLECTED;
        Self(GraspSampler::new(
            &object.name,
            &object.mesh,
            pose,
            ranges,
            seed,
        ))
    }

    /// The candidate of a number; the same on every call. None where no pair of places was found.
    ///
    /// # Errors
    /// None for the objects of a plan.
    pub(super) fn candidate(&self, number: usize) -> Result<Option<Candidate>> {
        let drawn = self.0.candidate(number)?;
        Ok(drawn.map(|drawn| Candidate {
            number,
            placed: drawn.placed,
            stop_force_n: FORCE_N[0] + (FORCE_N[1] - FORCE_N[0]) * drawn.squeeze,
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::demo::object::objects;
    use crate::demo::plan::DemoSettings;

    #[test]
    fn a_person_squeezes_with_25_to_50_n() {
        let settings = DemoSettings {
            seed: 4,
            quick: true,
            shared: None,
            jobs: 1,
        };
        for object in objects(&settings).unwrap() {
            let candidate = Sampler::new(&object, 4).candidate(1).unwrap().unwrap();
            assert!((25.0..=50.0).contains(&candidate.stop_force_n));
        }
    }
}
