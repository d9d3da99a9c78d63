//! What a tactile sensor meets: the object and the gel in the sensor's frame.
//!
//! # Frames
//! The gel's own frame is that of [`Finger`]: z from the back to the face, x along the gripper's
//! approach, y across; its origin lies in the middle of the back, which moves with the finger. The
//! sensor's frame is the gel's, turned about z by the [`MountingAngle`], so that x runs along the
//! columns and y along the rows of the image. Unturned, what lies further along the approach is
//! further right in both images; what lies further along the gripper's y is further up in the
//! left finger's and further down in the right one's.

use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};

use super::contact_gap::contact_gap;
use super::press_depth::SensorGeometry;
use super::rasteriser::Rasteriser;
use gripcast_base::error::{Error, Result};
use gripcast_geometry::{Pose, TriangleMesh};
use gripcast_sim::fem::{GelGrid, Side};
use gripcast_sim::grasp::{Finger, Snapshot, TraceStep};

/// How a sensor is turned on its finger, in quarter turns: its image's columns run along the
/// gel's x axis turned by this angle about the gel's z axis, towards its y axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "u16", into = "u16")]
pub struct MountingAngle {
    quarters: u8,
}

impl MountingAngle {
    /// A turn by 0, 90, 180 or 270 degrees.
    ///
    /// # Errors
    /// `Input` for another angle.
    pub fn from_degrees(degrees: u16) -> Result<Self> {
        match degrees {
            0 | 90 | 180 | 270 => Ok(Self {
                quarters: (degrees / 90) as u8,
            }),
            other => Err(Error::input(format!(
                "a sensor is mounted at 0, 90, 180 or 270 degrees, found {other}"
            ))),
        }
    }

    /// The turn, degrees.
    pub fn degrees(self) -> u16 {
        90 * u16::from(self.quarters)
    }

    fn rotation(self) -> DQuat {
        DQuat::from_rotation_z(f64::from(self.degrees()).to_radians())
    }
}

impl TryFrom<u16> for MountingAngle {
    type Error = String;

    fn try_from(degrees: u16) -> Result<Self, String> {
        Self::from_degrees(degrees).map_err(|e| e.what().to_owned())
    }
}

impl From<MountingAngle> for u16 {
    fn from(mounting: MountingAngle) -> Self {
        mounting.degrees()
    }
}

/// Which sensor of the gripper.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SensorMount {
    /// The finger that carries it.
    pub finger: Finger,
    /// How it is turned there.
    pub mounting: MountingAngle,
}

impl SensorMount {
    /// The sensor of a finger, unturned.
    pub fn on(finger: Finger) -> Self {
        Self {
            finger,
            mounting: MountingAngle::default(),
        }
    }

    /// Pose of the sensor's frame on a gripper whose undeformed faces are `opening_m` apart.
    pub fn t_gripper_sensor(self, opening_m: f64, gel_thickness_m: f64) -> Pose {
        let back = -(0.5 * opening_m + gel_thickness_m);
        let rotation = DQuat::from_mat3(&self.finger.rotation()) * self.mounting.rotation();
        Pose::new(rotation, self.finger.closing() * back)
    }
}

/// How far an object is taken away so that nothing touches, m.
const CLEARANCE_M: f64 = 10.0;

/// The gels of a simulated grasp.
#[derive(Clone, Debug)]
pub struct SimulatedGel {
    /// Mesh at rest.
    pub grid: GelGrid,
    /// CentreDistance at which contact begins, m.
    pub d_hat_m: f64,
}

/// What a sensor meets.
#[derive(Clone, Debug)]
pub struct TactileScene<'a> {
    /// Surface of the object in its own frame, m.
    pub object: &'a TriangleMesh,
    /// The object in the sensor's frame.
    pub t_sensor_object: Pose,
    /// z of the gel's face at rest in the sensor's frame, m.
    pub face_m: f64,
    /// How far the object stands off a face that it presses on, m: depths count from a plane
    /// this much beyond the face.
    pub gap_m: f64,
    /// The deformed face in the sensor's frame, where it is known.
    pub gel_face: Option<TriangleMesh>,
}

impl<'a> TactileScene<'a> {
    /// The end of a stage of a simulated grasp.
    ///
    /// The face at rest is the thickness above the mean of the back's nodes, which yield to the
    /// force by some µm. The gap is measured between the deformed face and the object
    /// ([`contact_gap`]).
    ///
    /// # Errors
    /// `Input` where the mesh is invalid, or the snapshot's gels have other nodes than `gel`.
    pub fn from_snapshot(
        object: &'a TriangleMesh,
        gel: &SimulatedGel,
        snapshot: &Snapshot,
        mount: SensorMount,
    ) -> Result<Self> {
        object.validate()?;
        let thickness = gel.grid.thickness_m();
        let t_gripper_sensor = mount.t_gripper_sensor(snapshot.opening_m, thickness);
        let t_sensor_world = (snapshot.t_world_gripper * t_gripper_sensor).inverse();
        let nodes = &snapshot.gels[mount.finger as usize];
        let (face, back_m) = deformed_face(&gel.grid, nodes, &t_sensor_world)?;
        let t_sensor_object = t_sensor_world * snapshot.t_world_object;
        let gap = contact_gap(object, &t_sensor_object, &face, gel.d_hat_m);
        Ok(Self {
            object,
            t_sensor_object,
            face_m: back_m + thickness,
            gap_m: gap.unwrap_or(gel.d_hat_m),
            gel_face: Some(face),
        })
    }

    /// Any step of a simulated grasp; the deformed face is not known.
    ///
    /// `t_world_gripper` is the gripper before the lift, as the first snapshot has it. The gap is
    /// halfway between the step's smallest one and `d_hat`, which is within 10 µm of the one
    /// that is measured where the face is known; `d_hat` where nothing touches.
    ///
    /// # Errors
    /// `Input` where the mesh is invalid.
    pub fn from_step(
        object: &'a TriangleMesh,
        gel: &SimulatedGel,
        t_world_gripper: &Pose,
        step: &TraceStep,
        mount: SensorMount,
    ) -> Result<Self> {
        object.validate()?;
        let thickness = gel.grid.thickness_m();
        let t_gripper_sensor = mount.t_gripper_sensor(step.opening_m, thickness);
        let lift = Pose::from_translation(DVec3::Z * step.lifted_m);
        let t_sensor_world = (lift * *t_world_gripper * t_gripper_sensor).inverse();
        let least = step.min_gap_m[mount.finger as usize].unwrap_or(gel.d_hat_m);
        Ok(Self {
            object,
            t_sensor_object: t_sensor_world * step.t_world_object,
            face_m: thickness,
            gap_m: 0.5 * (least + gel.d_hat_m),
            gel_face: None,
        })
    }

    /// A grasp before the fingers close, their undeformed faces `opening_m` apart.
    ///
    /// # Errors
    /// `Input` where the mesh is invalid.
    pub fn before_closing(
        object: &'a TriangleMesh,
        gel: &SimulatedGel,
        [t_world_object, t_world_gripper]: [&Pose; 2],
        opening_m: f64,
        mount: SensorMount,
    ) -> Result<Self> {
        object.validate()?;
        let thickness = gel.grid.thickness_m();
        let t_gripper_sensor = mount.t_gripper_sensor(opening_m, thickness);
        let t_sensor_world = (*t_world_gripper * t_gripper_sensor).inverse();
        let positions = gel.grid.positions();
        let rest: Vec<_> = positions.iter().map(|p| p.to_array()).collect();
        let unturned = Pose::from_rotation(mount.mounting.rotation().conjugate());
        Ok(Self {
            object,
            t_sensor_object: t_sensor_world * *t_world_object,
            face_m: thickness,
            gap_m: gel.d_hat_m,
            gel_face: Some(deformed_face(&gel.grid, &rest, &unturned)?.0),
        })
    }

    /// The same sensor with the object taken away and its face flat.
    #[must_use]
    pub fn untouched(&self) -> Self {
        let away = Pose::from_translation(DVec3::Z * CLEARANCE_M);
        let flat = |face: &TriangleMesh| TriangleMesh {
            vertices: face
                .vertices
                .iter()
                .map(|v| v.with_z(self.face_m))
                .collect(),
            triangles: face.triangles.clone(),
        };
        Self {
            t_sensor_object: away * self.t_sensor_object,
            gel_face: self.gel_face.as_ref().map(flat),
            ..*self
        }
    }

    /// A gel with the object beside it, out of its image.
    pub fn without_contact(object: &'a TriangleMesh, grid: &SensorGeometry) -> Self {
        Self {
            object,
            t_sensor_object: Pose::from_translation(DVec3::Z * CLEARANCE_M),
            face_m: grid.gel_thickness_m,
            gap_m: 0.0,
            gel_face: None,
        }
    }

    /// An object pressed in along the sensor's z axis until the deepest pixel of the image is
    /// `depth_m` deep. `t_sensor_object` gives its turn and its place across; its z is not used.
    ///
    /// # Errors
    /// `Input` where the mesh is invalid, no pixel lies under it, or the depth is not above 0 and
    /// at most the gel's thickness.
    pub fn pressed(
        object: &'a TriangleMesh,
        t_sensor_object: &Pose,
        depth_m: f64,
        grid: &SensorGeometry,
    ) -> Result<Self> {
        object.validate()?;
        let thickness = grid.gel_thickness_m;
        if !(depth_m > 0.0 && depth_m <= thickness) {
            return Err(Error::input(format!(
                "the depth of a press must be above 0 and at most the gel's thickness of \
                     {thickness} m, found {depth_m}"
            )));
        }
        let everywhere = [f64::NEG_INFINITY, f64::INFINITY];
        let mut rasteriser = Rasteriser::new();
        let seen = rasteriser.nearest(object, t_sensor_object, grid, everywhere);
        let lowest = f64::from(seen.iter().copied().fold(f32::INFINITY, f32::min));
        if !lowest.is_finite() {
            return Err(
                Error::input("the object does not lie over the sensor's image")
                    .remedy("shift it: x = 0, y = 0 is the middle of the gel"),
            );
        }
        let press = Pose::from_translation(DVec3::Z * (thickness - depth_m - lowest));
        Ok(Self {
            object,
            t_sensor_object: press * *t_sensor_object,
            face_m: thickness,
            gap_m: 0.0,
            gel_face: None,
        })
    }
}

/// The face of a gel in the sensor's frame, and the mean z of its back's nodes there, m.
fn deformed_face(
    grid: &GelGrid,
    nodes: &[[f64; 3]],
    t_sensor_nodes: &Pose,
) -> Result<(TriangleMesh, f64)> {
    let expected = grid.positions().len();
    if nodes.len() != expected {
        return Err(Error::input(format!(
            "expected the {expected} nodes of the gel's mesh, found {}",
            nodes.len()
        ))
        .remedy("take the mesh from the trace that the snapshot comes from"));
    }
    let at = |node: usize| t_sensor_nodes.transform_point(DVec3::from_array(nodes[node]));
    // The face is the last layer of the grid.
    let [_, _, layers] = grid.nodes();
    let first = grid.node(0, 0, layers - 1);
    let face = TriangleMesh {
        vertices: (first..expected).map(at).collect(),
        triangles: grid
            .triangles(Side::Front)
            .iter()
            .map(|t| t.map(|v| v - first as u32))
            .collect(),
    };
    face.validate()
        .map_err(|e| Error::input("the trace's gel is damaged").because(e))?;
    let back = grid.driven();
    let sum: f64 = back.iter().map(|&node| at(node as usize).z).sum();
    Ok((face, sum / back.len().max(1) as f64))
}

#[cfg(test)]
#[path = "scene_test.rs"]
mod tests;
