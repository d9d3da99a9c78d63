//! Where the gripper starts.

use pyo3::prelude::*;

use super::failure::Outcome;
use super::pose::{Pose, pose};
use gripcast_base::error::{Error, Result};
use gripcast_base::number::NumberRange;
use gripcast_geometry::TriangleMesh;
use gripcast_sim::fem::GelPad;
use gripcast_sim::grasp::{self, GRIPPER_OPENING_M, GraspStart};

/// Angles, degrees.
const DEGREES: NumberRange = NumberRange::between(-360.0, 360.0);

/// A grasp from above, relative to the object in a stable pose.
///
/// By default the gripper is centred on the object, its fingers close along the world's x axis (turned
/// by 90° where the object only fits then), and it opens to the object's width plus 2 mm.
#[pyclass(frozen, get_all, module = "gripcast")]
#[derive(Clone)]
pub(crate) struct Placement {
    /// Rotation about the vertical, degrees; None: 0, or 90 where the object only fits then.
    yaw_deg: Option<f64>,
    /// Rotation about the gripper's y axis, degrees: one finger higher than the other.
    roll_deg: f64,
    /// Rotation about the closing direction, degrees: approach off the vertical.
    pitch_deg: f64,
    /// Offset along and across the closing direction, m.
    offset_m: (f64, f64),
    /// Height of the gel centres above the ground, m; None: the object's centre.
    height_m: Option<f64>,
    /// Initial distance between the gels, m; None: the object's width plus 2 mm.
    opening_m: Option<f64>,
    /// Stable pose of the object by falling probability; None: the nearest within 5°, else 0.
    stable_pose: Option<usize>,
    /// Largest opening of the gripper, m.
    max_opening_m: f64,
}

#[pymethods]
impl Placement {
    #[new]
    #[pyo3(signature = (*, yaw_deg = None, roll_deg = 0.0, pitch_deg = 0.0, offset_m = (0.0, 0.0), height_m = None, opening_m = None, stable_pose = None, max_opening_m = GRIPPER_OPENING_M))]
    #[pyo3(
        text_signature = "(*, yaw_deg=None, roll_deg=0.0, pitch_deg=0.0, offset_m=(0.0, 0.0), height_m=None, opening_m=None, stable_pose=None, max_opening_m=0.09)"
    )]
    #[allow(clippy::too_many_arguments)]
    fn new(
        yaw_deg: Option<f64>,
        roll_deg: f64,
        pitch_deg: f64,
        offset_m: (f64, f64),
        height_m: Option<f64>,
        opening_m: Option<f64>,
        stable_pose: Option<usize>,
        max_opening_m: f64,
    ) -> Outcome<Self> {
        let positive = NumberRange::POSITIVE;
        check("yaw_deg", yaw_deg, DEGREES)?;
        check("roll_deg", Some(roll_deg), DEGREES)?;
        check("pitch_deg", Some(pitch_deg), DEGREES)?;
        check("offset_m", Some(offset_m.0), NumberRange::FINITE)?;
        check("offset_m", Some(offset_m.1), NumberRange::FINITE)?;
        check("height_m", height_m, NumberRange::FINITE)?;
        check("opening_m", opening_m, positive)?;
        check("max_opening_m", Some(max_opening_m), positive)?;
        Ok(Self {
            yaw_deg,
            roll_deg,
            pitch_deg,
            offset_m,
            height_m,
            opening_m,
            stable_pose,
            max_opening_m,
        })
    }

    fn __repr__(&self) -> String {
        let number = |value: Option<f64>| value.map_or("None".to_owned(), |v| v.to_string());
        format!(
            "Placement(yaw_deg={}, roll_deg={}, pitch_deg={}, offset_m={:?}, height_m={}, \
             opening_m={}, stable_pose={}, max_opening_m={})",
            number(self.yaw_deg),
            self.roll_deg,
            self.pitch_deg,
            self.offset_m,
            number(self.height_m),
            number(self.opening_m),
            self.stable_pose
                .map_or("None".to_owned(), |index| index.to_string()),
            self.max_opening_m
        )
    }
}

/// Refuses a number out of its range, with the argument's name.
pub(crate) fn check(name: &str, value: Option<f64>, range: NumberRange) -> Result<()> {
    let Some(value) = value else { return Ok(()) };
    match range.check(value) {
        Ok(_) => Ok(()),
        Err(e) => Err(Error::usage(format!("`{name}`: {}", e.what()))),
    }
}

/// A recorded gripper pose.
#[pyclass(frozen, module = "gripcast")]
#[derive(Clone)]
pub(crate) struct GraspPose {
    pose: grasp::GraspPose,
    /// Stable pose of the object where `t_world_object` is None.
    #[pyo3(get)]
    stable_pose: Option<usize>,
    /// Largest opening of the gripper, m.
    #[pyo3(get)]
    max_opening_m: f64,
}

#[pymethods]
impl GraspPose {
    #[new]
    #[pyo3(signature = (t_object_gripper, t_world_object = None, *, opening_m = None, stable_pose = None, max_opening_m = GRIPPER_OPENING_M))]
    #[pyo3(
        text_signature = "(t_object_gripper, t_world_object=None, *, opening_m=None, stable_pose=None, max_opening_m=0.09)"
    )]
    fn new(
        t_object_gripper: &Bound<'_, PyAny>,
        t_world_object: Option<&Bound<'_, PyAny>>,
        opening_m: Option<f64>,
        stable_pose: Option<usize>,
        max_opening_m: f64,
    ) -> Outcome<Self> {
        check("opening_m", opening_m, NumberRange::POSITIVE)?;
        check("max_opening_m", Some(max_opening_m), NumberRange::POSITIVE)?;
        let t_world_object = t_world_object.map(|value| pose(value, "t_world_object"));
        Ok(Self {
            pose: grasp::GraspPose {
                t_object_gripper: pose(t_object_gripper, "t_object_gripper")?,
                t_world_object: t_world_object.transpose()?,
                opening_m,
            },
            stable_pose,
            max_opening_m,
        })
    }

    /// Pose of the gripper in the frame of the object's mesh.
    #[getter]
    fn t_object_gripper(&self) -> Pose {
        Pose(self.pose.t_object_gripper)
    }

    /// Pose of the object on the ground; None: a stable pose.
    #[getter]
    fn t_world_object(&self) -> Option<Pose> {
        self.pose.t_world_object.map(Pose)
    }

    /// Initial distance between the gels, m; None: the object's width plus 2 mm.
    #[getter]
    fn opening_m(&self) -> Option<f64> {
        self.pose.opening_m
    }

    fn __repr__(&self) -> String {
        let world = self
            .t_world_object()
            .map_or("None".to_owned(), |p| repr(&p));
        let opening = self
            .pose
            .opening_m
            .map_or("None".to_owned(), |o| o.to_string());
        format!(
            "GraspPose({}, {world}, opening_m={opening})",
            repr(&self.t_object_gripper())
        )
    }
}

fn repr(pose: &Pose) -> String {
    format!("{:?}", pose.0)
}

/// Where the gripper starts.
#[derive(Clone)]
pub(crate) enum Start {
    Above(Placement),
    Recorded(GraspPose),
}

impl Start {
    /// A `Placement` or a `GraspPose`; None is the default placement.
    pub(crate) fn new(value: Option<&Bound<'_, PyAny>>) -> Outcome<Self> {
        let Some(value) = value else {
            return Ok(Self::Above(Placement {
                yaw_deg: None,
                roll_deg: 0.0,
                pitch_deg: 0.0,
                offset_m: (0.0, 0.0),
                height_m: None,
                opening_m: None,
                stable_pose: None,
                max_opening_m: GRIPPER_OPENING_M,
            }));
        };
        if let Ok(placement) = value.cast::<Placement>() {
            return Ok(Self::Above(placement.get().clone()));
        }
        if let Ok(pose) = value.cast::<GraspPose>() {
            return Ok(Self::Recorded(pose.get().clone()));
        }
        let found = value.get_type().name()?;
        Err(Error::usage(format!(
            "`placement` must be a Placement or a GraspPose, found {found}"
        ))
        .remedy("for a pose: `GraspPose(t_object_gripper)`")
        .into())
    }

    /// Poses of object and gripper.
    pub(crate) fn place(&self, mesh: &TriangleMesh, pad: GelPad) -> Result<GraspStart> {
        match self {
            Self::Above(placement) => {
                let from_above = grasp::Placement {
                    yaw_rad: placement.yaw_deg.unwrap_or(0.0).to_radians(),
                    roll_rad: placement.roll_deg.to_radians(),
                    pitch_rad: placement.pitch_deg.to_radians(),
                    offset_m: placement.offset_m.into(),
                    height_m: placement.height_m,
                    opening_m: placement.opening_m,
                    pad,
                };
                GraspStart::from_above(
                    mesh,
                    placement.stable_pose,
                    &from_above,
                    placement.max_opening_m,
                    placement.yaw_deg.is_none(),
                )
            }
            Self::Recorded(pose) => {
                GraspStart::recorded(mesh, pose.stable_pose, &pose.pose, pose.max_opening_m)
            }
        }
    }
}
