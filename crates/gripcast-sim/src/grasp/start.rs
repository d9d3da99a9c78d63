//! Poses of object and gripper at the start of a grasp.

use serde::Serialize;

use super::placement::{GraspPose, GripperState, Placement, height_above_ground, resting_pose};
use gripcast_base::error::{Error, Result};
use gripcast_geometry::{Pose, TriangleMesh};

/// Smallest height above the ground at which an object's pose is a warning, m.
const IN_THE_AIR_M: f64 = 1e-3;

/// The stable pose that an object starts in.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ChosenStablePose {
    /// Index by falling probability.
    pub index: usize,
    /// Probability that the object, dropped at random, comes to rest in it.
    pub probability: f64,
    /// Smallest rotation that tips the object over, degrees.
    pub tip_angle_deg: f64,
}

/// Poses of object and gripper at the start of a grasp.
#[derive(Clone, Debug, PartialEq)]
pub struct GraspStart {
    /// Pose of the object in the world.
    pub t_world_object: Pose,
    /// The stable pose that `t_world_object` is, unless it was given.
    pub stable_pose: Option<ChosenStablePose>,
    /// Pose and opening of the gripper.
    pub gripper: GripperState,
    /// Reasons to look at the poses, for the user.
    pub warnings: Vec<String>,
}

impl GraspStart {
    /// A grasp from above of an object in a stable pose ([`resting_pose`]), with a gripper that opens
    /// up to `max_opening_m` and may be turned by 90° where the object only fits then
    /// ([`Placement::place_within`]).
    ///
    /// # Errors
    /// Those of [`resting_pose`] and [`Placement::place_within`].
    pub fn from_above(
        mesh: &TriangleMesh,
        stable_pose: Option<usize>,
        placement: &Placement,
        max_opening_m: f64,
        may_turn: bool,
    ) -> Result<Self> {
        let (t_world_object, stable_pose) = resting(mesh, stable_pose)?;
        let (gripper, warning) =
            placement.place_within(mesh, &t_world_object, max_opening_m, may_turn)?;
        Ok(Self {
            t_world_object,
            stable_pose: Some(stable_pose),
            gripper,
            warnings: warning.into_iter().collect(),
        })
    }

    /// A recorded grasp pose of an object, which is in a stable pose where the recording has no
    /// `t_world_object`.
    ///
    /// # Errors
    /// `Usage` for a stable pose of an object whose pose is recorded; those of [`resting_pose`] and
    /// [`GraspPose::place_within`].
    pub fn recorded(
        mesh: &TriangleMesh,
        stable_pose: Option<usize>,
        pose: &GraspPose,
        max_opening_m: f64,
    ) -> Result<Self> {
        let (t_world_object, stable_pose) = match (pose.t_world_object, stable_pose) {
            (Some(_), Some(_)) => {
                return Err(Error::usage(
                    "`--stable-pose` contradicts the `t_world_object` of the grasp pose",
                )
                .remedy("omit one of them"));
            }
            (Some(given), None) => (given, None),
            (None, index) => {
                let (pose, record) = resting(mesh, index)?;
                (pose, Some(record))
            }
        };
        let above = height_above_ground(mesh, &t_world_object);
        let warning = format!(
            "the pose holds the object {:.1} mm above the ground: object and gripper are set down \
             together by that much",
            1e3 * above
        );
        Ok(Self {
            gripper: pose.place_within(mesh, &t_world_object, max_opening_m)?,
            t_world_object,
            stable_pose,
            warnings: (above > IN_THE_AIR_M)
                .then_some(warning)
                .into_iter()
                .collect(),
        })
    }
}

fn resting(mesh: &TriangleMesh, index: Option<usize>) -> Result<(Pose, ChosenStablePose)> {
    let (index, pose) = resting_pose(mesh, index)?;
    let record = ChosenStablePose {
        index,
        probability: pose.probability,
        tip_angle_deg: pose.tip_angle_rad.to_degrees(),
    };
    Ok((pose.t_world_object, record))
}
