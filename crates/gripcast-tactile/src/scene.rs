//! Tactile scene: the object and the gel in the sensor frame.
//!
//! # Frames
//! Gel frame ([`Finger`]): z from the back to the face, x along the gripper's approach direction, y
//! across; the origin is the centre of the back and moves with the finger. The sensor frame is the
//! gel frame rotated about z by the [`MountingAngle`], so that x runs along the columns and y along
//! the rows of the image. At 0°, points further along the approach direction are further right in
//! both images; points further along the gripper's y are further up in the left finger's image and
//! further down in the right one's.

use glam::{DQuat, DVec3};

use super::contact_gap::contact_gap;
use super::markers::{ContactLoad, NodeMotion};
use super::moment::Moment;
use super::press_depth::{SensorGeometry, folded};
use super::rasteriser::Rasteriser;
use super::trace_header::TraceStart;
use gripcast_base::error::{Error, Result};
use gripcast_geometry::{Pose, TriangleMesh};
use gripcast_sim::fem::{GelGrid, Side};
use gripcast_sim::grasp::{Finger, GelForce, Snapshot, Trace, TraceStep};

/// Rotation of a sensor on its finger in quarter turns: the image columns run along the gel's x
/// axis rotated by this angle about the gel's z axis, towards y.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MountingAngle {
    quarters: u8,
}

impl MountingAngle {
    /// Angle of 0, 90, 180 or 270 degrees.
    ///
    /// # Errors
    /// `Input` for another angle.
    pub fn from_degrees(degrees: u16) -> Result<Self> {
        match degrees {
            0 | 90 | 180 | 270 => Ok(Self {
                quarters: (degrees / 90) as u8,
            }),
            other => Err(Error::input(format!(
                "the mounting angle must be 0, 90, 180 or 270 degrees, found {other}"
            ))),
        }
    }

    /// Angle, degrees.
    pub fn degrees(self) -> u16 {
        90 * u16::from(self.quarters)
    }

    fn rotation(self) -> DQuat {
        DQuat::from_rotation_z(f64::from(self.degrees()).to_radians())
    }

    /// Vector of the sensor's face plane in the gel frame.
    pub(super) fn to_gel(self, [x, y]: [f64; 2]) -> [f64; 2] {
        match self.quarters {
            0 => [x, y],
            1 => [-y, x],
            2 => [-x, -y],
            _ => [y, -x],
        }
    }

    /// Vector of the gel's face plane in the sensor frame.
    pub(super) fn to_sensor(self, [x, y]: [f64; 2]) -> [f64; 2] {
        match self.quarters {
            0 => [x, y],
            1 => [y, -x],
            2 => [-x, -y],
            _ => [-y, x],
        }
    }
}

/// Mounting of one of the gripper's sensors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SensorMount {
    /// Finger that carries the sensor.
    pub finger: Finger,
    /// Rotation on the finger.
    pub mounting: MountingAngle,
}

impl SensorMount {
    /// Sensor of a finger mounted at 0°.
    pub fn on(finger: Finger) -> Self {
        Self {
            finger,
            mounting: MountingAngle::default(),
        }
    }

    /// Pose of the sensor frame on a gripper whose undeformed faces are `opening_m` apart.
    pub fn t_gripper_sensor(self, opening_m: f64, gel_thickness_m: f64) -> Pose {
        let back = -(0.5 * opening_m + gel_thickness_m);
        let rotation = DQuat::from_mat3(&self.finger.rotation()) * self.mounting.rotation();
        Pose::new(rotation, self.finger.closing() * back)
    }

    /// Tangential load on the gel, whose force is in the gripper frame, in the sensor frame.
    fn load(self, force: &GelForce) -> ContactLoad {
        let [y, z] = force.shear_n;
        let in_gel = self.finger.rotation().transpose() * DVec3::new(0.0, y, z);
        ContactLoad {
            force_n: self.mounting.to_sensor([in_gel.x, in_gel.y]),
            torque_n_m: force.torque_n_m,
        }
    }
}

/// What is known of the motion of a gel's skin.
#[derive(Clone, Debug, PartialEq)]
pub enum Skin {
    /// The displacement of the nodes of its face.
    Nodes(NodeMotion),
    /// The tangential load of the contact, besides the depth.
    Layer(ContactLoad),
}

impl Default for Skin {
    /// Nothing but the depth.
    fn default() -> Self {
        Self::Layer(ContactLoad::default())
    }
}

/// Displacement of an object out of contact, m.
const CLEARANCE_M: f64 = 10.0;

/// Gel of a simulated grasp.
#[derive(Clone, Debug)]
pub struct SimulatedGel {
    /// Mesh at rest.
    pub grid: GelGrid,
    /// Distance at which the contact barrier starts, m.
    pub d_hat_m: f64,
}

/// Object and gel in the sensor frame.
#[derive(Clone, Debug)]
pub struct TactileScene<'a> {
    /// Surface of the object in its own frame, m.
    pub object: &'a TriangleMesh,
    /// Pose of the object in the sensor frame.
    pub t_sensor_object: Pose,
    /// z of the face at rest in the sensor frame, m.
    pub face_m: f64,
    /// Contact gap, m: depths are measured from a plane this far beyond the face.
    pub gap_m: f64,
    /// Deformed face in the sensor frame, if known.
    pub gel_face: Option<TriangleMesh>,
    /// Motion of the gel's skin, which carries the gel markers.
    pub skin: Skin,
}

impl<'a> TactileScene<'a> {
    /// Scene at the end of a stage of a simulated grasp.
    ///
    /// The face at rest lies one thickness above the mean of the back's nodes, which yield to the
    /// force by some µm. The gap between the deformed face and the object is measured
    /// ([`contact_gap`]).
    ///
    /// # Errors
    /// `Input` if the mesh is invalid or the number of gel nodes differs from that of `gel`.
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
        let skin = Skin::Nodes(node_motion(&gel.grid, &face, mount.mounting)?);
        Ok(Self {
            skin,
            object,
            t_sensor_object,
            face_m: back_m + thickness,
            gap_m: gap.unwrap_or(gel.d_hat_m),
            gel_face: Some(face),
        })
    }

    /// Scene at a moment of a simulated grasp.
    ///
    /// # Errors
    /// `Input` if the grasp ended before, and as [`Self::from_snapshot`].
    pub fn at_moment(
        object: &'a TriangleMesh,
        gel: &SimulatedGel,
        start: &TraceStart,
        trace: &Trace,
        moment: Moment,
        mount: SensorMount,
    ) -> Result<Self> {
        match moment.snapshot(trace)? {
            Some(snapshot) => Self::from_snapshot(object, gel, snapshot, mount),
            None => {
                let poses = [&start.t_world_object, &start.t_world_gripper()];
                Self::before_closing(object, gel, poses, start.opening_m, mount)
            }
        }
    }

    /// Scene at any step of a simulated grasp, without the deformed face.
    ///
    /// `t_world_gripper` is the gripper pose before the lift. The gap is taken halfway between the
    /// minimum gap of the step and `d_hat`, within 10 µm of the measured one; `d_hat` without
    /// contact.
    ///
    /// # Errors
    /// `Input` if the mesh is invalid.
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
        let min_gap = step.min_gap_m[mount.finger as usize].unwrap_or(gel.d_hat_m);
        Ok(Self {
            object,
            t_sensor_object: t_sensor_world * step.t_world_object,
            face_m: thickness,
            gap_m: 0.5 * (min_gap + gel.d_hat_m),
            gel_face: None,
            skin: Skin::Layer(mount.load(&step.force[mount.finger as usize])),
        })
    }

    /// Scene before the fingers close, with undeformed faces `opening_m` apart.
    ///
    /// # Errors
    /// `Input` if the mesh is invalid.
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
        let t_sensor_gel = Pose::from_rotation(mount.mounting.rotation().conjugate());
        Ok(Self {
            object,
            t_sensor_object: t_sensor_world * *t_world_object,
            face_m: thickness,
            gap_m: gel.d_hat_m,
            gel_face: Some(deformed_face(&gel.grid, &rest, &t_sensor_gel)?.0),
            skin: Skin::default(),
        })
    }

    /// Returns the scene without contact and with a flat face.
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
            skin: Skin::default(),
            ..*self
        }
    }

    /// Scene of a gel with the object out of its image.
    pub fn without_contact(object: &'a TriangleMesh, grid: &SensorGeometry) -> Self {
        Self {
            object,
            t_sensor_object: Pose::from_translation(DVec3::Z * CLEARANCE_M),
            face_m: grid.gel_thickness_m,
            gap_m: 0.0,
            gel_face: None,
            skin: Skin::default(),
        }
    }

    /// Scene of an object pressed along the sensor's z axis to the maximum depth `depth_m`. The z
    /// of `t_sensor_object` is ignored.
    ///
    /// # Errors
    /// `Input` if the mesh is invalid, not over the image, or the depth is not above 0 and at most
    /// the gel thickness.
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
                "the depth of a press must be above 0 and at most the gel thickness of \
                     {thickness} m, found {depth_m}"
            )));
        }
        let everywhere = [f64::NEG_INFINITY, f64::INFINITY];
        let mut rasteriser = Rasteriser::new();
        let nearest = rasteriser.nearest(object, t_sensor_object, grid, everywhere);
        let lowest = f64::from(folded(nearest, f32::INFINITY, f32::min));
        if !lowest.is_finite() {
            return Err(Error::input("the object is not over the sensor's image")
                .remedy("shift it: x = 0, y = 0 is the centre of the gel"));
        }
        let press = Pose::from_translation(DVec3::Z * (thickness - depth_m - lowest));
        Ok(Self {
            object,
            t_sensor_object: press * *t_sensor_object,
            face_m: thickness,
            gap_m: 0.0,
            gel_face: None,
            skin: Skin::default(),
        })
    }
}

/// Returns the displacement of the nodes of a face in the sensor frame.
fn node_motion(grid: &GelGrid, face: &TriangleMesh, mounting: MountingAngle) -> Result<NodeMotion> {
    let [_, _, layers] = grid.nodes();
    let rest = &grid.positions()[grid.node(0, 0, layers - 1)..];
    let displacement = face.vertices.iter().zip(rest).map(|(moved, rest)| {
        let [x, y] = mounting.to_gel([moved.x, moved.y]);
        [x - rest.x, y - rest.y]
    });
    NodeMotion::new(grid, displacement.collect(), mounting)
}

/// Returns the face of a gel and the mean z of its back's nodes in the sensor frame, m.
fn deformed_face(
    grid: &GelGrid,
    nodes: &[[f64; 3]],
    t_sensor_nodes: &Pose,
) -> Result<(TriangleMesh, f64)> {
    let expected = grid.positions().len();
    if nodes.len() != expected {
        return Err(Error::input(format!(
            "expected {expected} nodes of the gel mesh, found {}",
            nodes.len()
        ))
        .remedy("use the gel mesh of the snapshot's trace"));
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
        .map_err(|e| Error::input("invalid gel mesh in the trace").because(e))?;
    let back = grid.driven();
    let sum: f64 = back.iter().map(|&node| at(node as usize).z).sum();
    Ok((face, sum / back.len().max(1) as f64))
}

#[cfg(test)]
#[path = "scene_test.rs"]
mod tests;
