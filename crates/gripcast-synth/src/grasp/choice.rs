//! Selects grasps of an object whose open gripper is free of collisions.

use std::collections::BTreeMap;

use super::sampler::MAX_OPENING_M;
use super::{FaultRanges, GraspFault, GraspSampler, Obstacle, find_collision};
use crate::acronym::AcronymGrasp;
use gripcast_base::error::Result;
use gripcast_base::random::SeedStream;
use gripcast_geometry::{Pose, StablePose, TriangleMesh, likely_poses};
use gripcast_sim::fem::GelPad;
use gripcast_sim::grasp::{GraspPose, GripperState};

/// Rotation that an object in a stable pose withstands without tipping over, rad.
const MIN_TIP_RAD: f64 = 0.05;
/// Stable poses with a lower probability are left out.
const MIN_PROBABILITY: f64 = 0.03;
/// Maximum candidates per requested grasp.
const CANDIDATES: usize = 12;

/// A grasp whose open gripper touches neither the object nor the ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChosenGrasp {
    /// Pose of the object on the ground.
    pub t_world_object: Pose,
    /// Pose and opening of the gripper.
    pub placed: GripperState,
    /// Deviation from an antipodal grasp; none for a given grasp.
    pub fault: Option<GraspFault>,
    /// The given grasp; none for a sampled one.
    pub given: Option<AcronymGrasp>,
}

/// Selected grasps of an object, with counts of the rejected candidates.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GraspSelection {
    /// Selected grasps, at most as many as requested.
    pub grasps: Vec<ChosenGrasp>,
    /// Candidates without antipodal contacts.
    pub without_antipodal_pair: usize,
    /// Candidates in collision, by the part of the gripper.
    pub collisions: BTreeMap<String, usize>,
}

/// Samples up to `count` grasps of an object (m, its own frame) for gels of a size. Stable poses are
/// drawn by their probability.
///
/// # Errors
/// `Input` for an object that encloses no volume or has no stable pose.
pub fn sample_grasps(
    name: &str,
    object: &TriangleMesh,
    pad: GelPad,
    count: usize,
    seed: u64,
) -> Result<GraspSelection> {
    let poses = likely_poses(object, MIN_TIP_RAD, MIN_PROBABILITY)?;
    let mut draw = SeedStream::named(seed, &format!("poses {name}"));
    let mut stages = BTreeMap::new();
    let mut selection = GraspSelection::default();
    for number in 0..CANDIDATES * count {
        if selection.grasps.len() == count {
            break;
        }
        let index = pick(&poses, draw.uniform());
        let t_world_object = poses[index].t_world_object;
        let (sampler, obstacle) = match stages.entry(index) {
            std::collections::btree_map::Entry::Occupied(entry) => entry.into_mut(),
            std::collections::btree_map::Entry::Vacant(entry) => entry.insert((
                GraspSampler::new(name, object, t_world_object, FaultRanges::WIDE, seed)
                    .with_pad(pad),
                Obstacle::new(object, t_world_object)?,
            )),
        };
        let Some(candidate) = sampler.candidate(number)? else {
            selection.without_antipodal_pair += 1;
            continue;
        };
        match find_collision(&candidate.placed, obstacle)? {
            Some(part) => *selection.collisions.entry(part).or_default() += 1,
            None => selection.grasps.push(ChosenGrasp {
                t_world_object,
                placed: candidate.placed,
                fault: Some(candidate.fault),
                given: None,
            }),
        }
    }
    Ok(selection)
}

/// Selects up to `count` of the `given` grasps of an object (m, its own frame), each in the most likely stable pose without collisions.
///
/// # Errors
/// As [`sample_grasps`].
pub fn select_given_grasps(
    name: &str,
    object: &TriangleMesh,
    given: &[AcronymGrasp],
    count: usize,
    seed: u64,
) -> Result<GraspSelection> {
    let poses = likely_poses(object, MIN_TIP_RAD, MIN_PROBABILITY)?;
    let obstacles = poses
        .iter()
        .map(|pose| Obstacle::new(object, pose.t_world_object))
        .collect::<Result<Vec<_>>>()?;
    let mut order: Vec<usize> = (0..given.len()).collect();
    order.sort_by_key(|index| SeedStream::named(seed, &format!("given {name} {index}")).bits());
    let mut selection = GraspSelection::default();
    for index in order {
        if selection.grasps.len() == count {
            break;
        }
        let grasp = GraspPose {
            t_object_gripper: given[index].t_object_gripper,
            t_world_object: None,
            opening_m: None,
        };
        let mut collision = None;
        for (pose, obstacle) in poses.iter().zip(&obstacles) {
            let t_world_object = pose.t_world_object;
            let mut placed = grasp.place(object, &t_world_object);
            placed.opening_m = placed.opening_m.min(MAX_OPENING_M);
            collision = find_collision(&placed, obstacle)?;
            if collision.is_none() {
                selection.grasps.push(ChosenGrasp {
                    t_world_object,
                    placed,
                    fault: None,
                    given: Some(given[index]),
                });
                break;
            }
        }
        if let Some(part) = collision {
            *selection.collisions.entry(part).or_default() += 1;
        }
    }
    Ok(selection)
}

/// Index of the pose at `fraction` (0 to 1) of the cumulative probability.
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
    fn sampled_grasps_are_collision_free_and_reproducible() {
        let mesh = builtin("mug").unwrap();
        let pad = GelPad::default();
        let selection = sample_grasps("mug", &mesh, pad, 6, 3).unwrap();
        assert_eq!(selection.grasps.len(), 6, "{selection:?}");
        assert_eq!(sample_grasps("mug", &mesh, pad, 6, 3).unwrap(), selection);
        assert_ne!(sample_grasps("mug", &mesh, pad, 6, 4).unwrap(), selection);
        for grasp in &selection.grasps {
            let obstacle = Obstacle::new(&mesh, grasp.t_world_object).unwrap();
            assert_eq!(find_collision(&grasp.placed, &obstacle).unwrap(), None);
        }
        // A shorter list is a prefix of a longer one.
        let fewer = sample_grasps("mug", &mesh, pad, 3, 3).unwrap();
        assert_eq!(fewer.grasps, selection.grasps[..3]);
    }

    #[test]
    fn given_grasps_get_a_collision_free_pose() {
        let mesh = builtin("box").unwrap();
        let down = Pose::from_rotation(glam::DQuat::from_rotation_x(std::f64::consts::PI));
        let up = Pose::IDENTITY;
        let inside_out = Pose::from_translation(glam::DVec3::X * 0.03);
        let given = [down, up, inside_out].map(|t_object_gripper| AcronymGrasp {
            number: 7,
            t_object_gripper,
            stable: true,
        });
        let selection = select_given_grasps("box", &mesh, &given, 5, 1).unwrap();
        // The grasp from below is free once the box lies upside down.
        assert_eq!(selection.grasps.len(), 2, "{selection:?}");
        for grasp in &selection.grasps {
            let given = grasp.given.unwrap();
            assert_eq!((grasp.fault, given.number, given.stable), (None, 7, true));
        }
        assert_eq!(selection.collisions.values().sum::<usize>(), 1);
    }

    #[test]
    fn object_wider_than_the_gripper_has_no_grasps() {
        let mesh = builtin("sphere").unwrap().scaled(4.0);
        let selection = sample_grasps("sphere", &mesh, GelPad::default(), 2, 1).unwrap();
        assert!(selection.grasps.is_empty());
        assert!(
            selection.without_antipodal_pair + selection.collisions.values().sum::<usize>() >= 24
        );
    }
}
