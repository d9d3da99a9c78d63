//! Grasps of an object that the gripper can begin.

use std::collections::BTreeMap;

use super::{FaultRanges, GraspFault, GraspSampler, Obstacle, collides};
use gripcast_base::error::Result;
use gripcast_base::random::SeedStream;
use gripcast_geometry::{Pose, StablePose, TriangleMesh, likely_poses};
use gripcast_sim::grasp::{GraspPose, GripperState};

/// An object does not tip over when it is turned by this, rad.
const MIN_TIP_RAD: f64 = 0.05;
/// Poses that an object falls into less often are left out.
const MIN_PROBABILITY: f64 = 0.03;
/// Candidates for each grasp that is wanted.
const CANDIDATES: usize = 12;

/// Widest opening of the gripper at a grasp that was given, m.
const WIDEST_M: f64 = 0.085;

/// A grasp that can begin: nothing of the open gripper is in the object or in the ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChosenGrasp {
    /// How the object lies.
    pub t_world_object: Pose,
    /// Where the gripper is.
    pub placed: GripperState,
    /// How it departs from opposite places; none for one that was given.
    pub fault: Option<GraspFault>,
}

/// What was drawn for an object.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GraspChoice {
    /// The grasps, at most as many as were wanted.
    pub grasps: Vec<ChosenGrasp>,
    /// Candidates without two opposite places.
    pub without_places: usize,
    /// Candidates that would hit something, by the part of the gripper.
    pub collisions: BTreeMap<String, usize>,
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
    let poses = likely_poses(object, MIN_TIP_RAD, MIN_PROBABILITY)?;
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
                GraspSampler::new(name, object, t_world_object, FaultRanges::WIDE, seed),
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
                placed: candidate.placed,
                fault: Some(candidate.fault),
            }),
        }
    }
    Ok(choice)
}

/// Up to `wanted` of the grasps `given` of an object (m, its own frame; `t_object_gripper`), each in
/// the most likely stable pose in which it can begin.
///
/// # Errors
/// As [`choose_grasps`].
pub fn choose_given_grasps(
    name: &str,
    object: &TriangleMesh,
    given: &[Pose],
    wanted: usize,
    seed: u64,
) -> Result<GraspChoice> {
    let poses = likely_poses(object, MIN_TIP_RAD, MIN_PROBABILITY)?;
    let obstacles = poses
        .iter()
        .map(|pose| Obstacle::new(object, pose.t_world_object))
        .collect::<Result<Vec<_>>>()?;
    let mut order: Vec<usize> = (0..given.len()).collect();
    order.sort_by_key(|at| SeedStream::named(seed, &format!("given {name} {at}")).bits());
    let mut choice = GraspChoice::default();
    for at in order {
        if choice.grasps.len() == wanted {
            break;
        }
        let grasp = GraspPose {
            t_object_gripper: given[at],
            t_world_object: None,
            opening_m: None,
        };
        let mut hit = None;
        for (pose, obstacle) in poses.iter().zip(&obstacles) {
            let t_world_object = pose.t_world_object;
            let mut placed = grasp.place(object, &t_world_object);
            placed.opening_m = placed.opening_m.min(WIDEST_M);
            hit = collides(&placed, obstacle)?;
            if hit.is_none() {
                choice.grasps.push(ChosenGrasp {
                    t_world_object,
                    placed,
                    fault: None,
                });
                break;
            }
        }
        if let Some(part) = hit {
            *choice.collisions.entry(part).or_default() += 1;
        }
    }
    Ok(choice)
}

/// Index of a pose by where `fraction` of 0..1 falls among the probabilities.
fn pick(poses: &[StablePose], fraction: f64) -> usize {
    let total: f64 = poses.iter().map(|pose| pose.probability).sum();
    let mut left = fraction * total;
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
    use gripcast_geometry::builtin;

    #[test]
    fn grasps_can_begin_and_come_again() {
        let mesh = builtin("mug").unwrap();
        let choice = choose_grasps("mug", &mesh, 6, 3).unwrap();
        assert_eq!(choice.grasps.len(), 6, "{choice:?}");
        assert_eq!(choose_grasps("mug", &mesh, 6, 3).unwrap(), choice);
        assert_ne!(choose_grasps("mug", &mesh, 6, 4).unwrap(), choice);
        for grasp in &choice.grasps {
            let obstacle = Obstacle::new(&mesh, grasp.t_world_object).unwrap();
            assert_eq!(collides(&grasp.placed, &obstacle).unwrap(), None);
        }
        // A shorter list is the beginning of a longer one.
        let fewer = choose_grasps("mug", &mesh, 3, 3).unwrap();
        assert_eq!(fewer.grasps, choice.grasps[..3]);
    }

    #[test]
    fn given_grasps_get_a_pose_in_which_they_can_begin() {
        let mesh = builtin("box").unwrap();
        let down = Pose::from_rotation(glam::DQuat::from_rotation_x(std::f64::consts::PI));
        let up = Pose::IDENTITY;
        let inside_out = Pose::from_translation(glam::DVec3::X * 0.03);
        let given = [down, up, inside_out];
        let choice = choose_given_grasps("box", &mesh, &given, 5, 1).unwrap();
        // From below it can begin once the box lies upside down.
        assert_eq!(choice.grasps.len(), 2, "{choice:?}");
        assert!(choice.grasps.iter().all(|grasp| grasp.fault.is_none()));
        assert_eq!(choice.collisions.values().sum::<usize>(), 1);
    }

    #[test]
    fn an_object_too_wide_for_the_gripper_has_no_grasps() {
        let mesh = builtin("sphere").unwrap().scaled(4.0);
        let choice = choose_grasps("sphere", &mesh, 2, 1).unwrap();
        assert!(choice.grasps.is_empty());
        assert!(choice.without_places + choice.collisions.values().sum::<usize>() >= 24);
    }
}
