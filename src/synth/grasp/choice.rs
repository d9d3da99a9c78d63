//! Grasps of an object that the gripper can begin.

use std::collections::BTreeMap;

use super::{Candidate, GraspSampler, Obstacle, collides};
use crate::error::Result;
use crate::geometry::{Pose, StablePose, TriangleMesh, stable_poses};
use crate::render::visual::SeedStream;

/// An object does not tip over when it is turned by this, rad.
const LEAST_TIP_RAD: f64 = 0.05;
/// Poses that an object falls into less often are left out.
const LEAST_PROBABILITY: f64 = 0.03;
/// Candidates for each grasp that is wanted.
const CANDIDATES: usize = 12;

/// A grasp that can begin: nothing of the open gripper is in the object or in the ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChosenGrasp {
    /// How the object lies.
    pub t_world_object: Pose,
    /// Where the gripper is.
    pub candidate: Candidate,
}

/// What was drawn for an object.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GraspChoice {
    /// The grasps, at most as many as were wanted.
    pub grasps: Vec<ChosenGrasp>,
    /// Candidates without two opposite places.
    pub without_places: usize,
    /// Candidates that would hit something, by the part of the gripper.
    pub collisions: BTreeMap<&'static str, usize>,
}

/// Draws up to `wanted` grasps of an object (m, its own frame) in stable poses, as often as it
/// falls into them.
///
/// # Errors
/// `Input` for an object that encloses no volume or tips over in each pose.
pub fn choose_grasps(
    name: &str,
    object: &TriangleMesh,
    wanted: usize,
    seed: u64,
) -> Result<GraspChoice> {
    let poses = likely_poses(object)?;
    let mut draw = SeedStream::named(seed, &format!("poses {name}"));
    let mut stages = BTreeMap::new();
    let mut choice = GraspChoice::default();
    for number in 0..CANDIDATES * wanted {
        if choice.grasps.len() == wanted {
            break;
        }
        let at = pick(&poses, draw.uniform());
        let t_world_object = poses[at].t_world_object;
        let (sampler, obstacle) = match stages.entry(at) {
            std::collections::btree_map::Entry::Occupied(known) => known.into_mut(),
            std::collections::btree_map::Entry::Vacant(new) => new.insert((
                GraspSampler::new(name, object, t_world_object, seed),
                Obstacle::new(object, t_world_object)?,
            )),
        };
        let Some(candidate) = sampler.candidate(number)? else {
            choice.without_places += 1;
            continue;
        };
        match collides(&candidate.placed, obstacle)? {
            Some(part) => *choice.collisions.entry(part).or_default() += 1,
            None => choice.grasps.push(ChosenGrasp {
                t_world_object,
                candidate,
            }),
        }
    }
    Ok(choice)
}

/// What an object often falls into; round ones have no pose that survives a nudge.
fn likely_poses(object: &TriangleMesh) -> Result<Vec<StablePose>> {
    let mut poses = stable_poses(object, LEAST_TIP_RAD).or_else(|_| stable_poses(object, 0.0))?;
    let likely = poses.iter().take_while(|pose| pose.probability >= LEAST_PROBABILITY);
    let likely = likely.count().max(1);
    poses.truncate(likely);
    Ok(poses)
}

/// Index of a pose by where `share` of 0..1 falls among the probabilities.
fn pick(poses: &[StablePose], share: f64) -> usize {
    let total: f64 = poses.iter().map(|pose| pose.probability).sum();
    let mut left = share * total;
    poses
        .iter()
        .position(|pose| {
            left -= pose.probability;
            left < 0.0
        })
        .unwrap_or(poses.len() - 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::builtin;

    #[test]
    fn grasps_can_begin_and_come_again() {
        let mesh = builtin("mug").unwrap();
        let choice = choose_grasps("mug", &mesh, 6, 3).unwrap();
        assert_eq!(choice.grasps.len(), 6, "{choice:?}");
        assert_eq!(choose_grasps("mug", &mesh, 6, 3).unwrap(), choice);
        assert_ne!(choose_grasps("mug", &mesh, 6, 4).unwrap(), choice);
        for grasp in &choice.grasps {
            let obstacle = Obstacle::new(&mesh, grasp.t_world_object).unwrap();
            assert_eq!(collides(&grasp.candidate.placed, &obstacle).unwrap(), None);
        }
        // A shorter list is the beginning of a longer one.
        let fewer = choose_grasps("mug", &mesh, 3, 3).unwrap();
        assert_eq!(fewer.grasps, choice.grasps[..3]);
    }

    #[test]
    fn an_object_too_wide_for_the_gripper_has_no_grasps() {
        let mesh = builtin("sphere").unwrap().scaled(4.0);
        let choice = choose_grasps("sphere", &mesh, 2, 1).unwrap();
        assert!(choice.grasps.is_empty());
        assert!(choice.without_places + choice.collisions.values().sum::<usize>() >= 24);
    }
}
