//! What is grasped, where, and with which gripper.

use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

use crate::affine::{AffineBody, AffineState};
use crate::fem::{GelGrid, GelResolution};
use crate::solver::{Collider, Drive, Gel, GelMaterial, Object, SolverParameters, System};
use gripcast_base::error::{Error, Result};
use gripcast_geometry::{MassProperties, Pose, TriangleMesh};

/// A finger of the gripper. Its gel's own frame has z from the back to the face, x along the
/// gripper's approach axis (25 mm) and y across (20 mm).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Finger {
    /// At negative x of the gripper, closing along +x.
    Left,
    /// At positive x of the gripper, closing along -x.
    Right,
}

impl Finger {
    /// Both, in the order of the gels.
    pub const BOTH: [Self; 2] = [Self::Left, Self::Right];

    /// Closing direction in the gripper's frame.
    pub fn closing(self) -> DVec3 {
        match self {
            Self::Left => DVec3::X,
            Self::Right => DVec3::NEG_X,
        }
    }

    /// Rotation from the gel's own frame to the gripper's.
    pub fn rotation(self) -> DMat3 {
        let (x, z) = (DVec3::Z, self.closing());
        DMat3::from_cols(x, z.cross(x), z)
    }
}

/// Mesh and material of both gels.
#[derive(Clone, Debug)]
pub struct GelSpec {
    /// Mesh at rest.
    pub grid: GelGrid,
    /// Material.
    pub material: GelMaterial,
    /// What moves the back face.
    pub drive: Drive,
}

impl GelSpec {
    /// A standard pad of the paper's material.
    ///
    /// # Errors
    /// None for the built-in meshes.
    pub fn standard(resolution: GelResolution) -> Result<Self> {
        Ok(Self {
            grid: GelGrid::pad(resolution)?,
            material: GelMaterial::default(),
            drive: Drive::default(),
        })
    }
}

/// A grasp before the fingers close.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Closed surface of the object in its own frame, m.
    pub mesh: TriangleMesh,
    /// Mass, kg.
    pub mass_kg: f64,
    /// Coulomb friction coefficient between gels and object, and between object and ground.
    pub friction: f64,
    /// The object on the ground (z = 0).
    pub t_world_object: Pose,
    /// The gripper; the fingers close along its x axis.
    pub t_world_gripper: Pose,
    /// Distance between the gels' faces at the start, m.
    pub opening_m: f64,
    /// The gels.
    pub gel: GelSpec,
}

/// A scene ready to step, with what the protocol needs to know of it.
#[derive(Debug)]
pub struct Stage {
    pub(super) system: System,
    /// Closing direction of each gel in the world.
    pub(super) closing: [DVec3; 2],
    /// Gripper axes in the world.
    pub(super) gripper_axes: DMat3,
    /// From the object's file frame to the frame of its centre of mass.
    pub(super) center_of_mass: DVec3,
    /// How far scene was raised for the object to rest at its contact gap, m.
    pub(super) raised_m: f64,
    pub(super) starts_penetrating: Option<String>,
    /// Nodes of the left and the right face that lie opposite each other.
    facing: Vec<[u32; 2]>,
}

impl Stage {
    /// Whether the gels touch each other, which nothing would keep them from passing through.
    pub(super) fn gels_meet(&self) -> bool {
        let [left, right] = [0, 1].map(|i| self.system.gels()[i].positions());
        let d_hat = self.system.parameters().d_hat_m;
        self.facing.iter().any(|[l, r]| {
            let apart = right[*r as usize] - left[*l as usize];
            apart.dot(self.closing[0]) < d_hat
        })
    }
}

/// Opposite nodes of two equal pads: y points in opposite directions on them.
fn facing_nodes(grid: &GelGrid) -> Vec<[u32; 2]> {
    let [nx, ny, nz] = grid.nodes();
    (0..ny)
        .flat_map(|j| (0..nx).map(move |i| (i, j)))
        .map(|(i, j)| [j, ny - 1 - j].map(|j| grid.node(i, j, nz - 1) as u32))
        .collect()
}

fn input(what: String, remedy: &str) -> Error {
    Error::input(what).remedy(remedy)
}

impl Scene {
    /// Builds the gels and the object.
    ///
    /// The object and the gripper are raised together until the ground's barrier carries the
    /// object's weight (less than `d_hat`), so their relative pose is exactly the given one.
    ///
    /// # Errors
    /// Where mass, friction, opening, pose or mesh cannot be simulated.
    pub fn build(&self, parameters: &SolverParameters) -> Result<Stage> {
        self.validate()?;
        let properties = MassProperties::of(&self.mesh)?;
        let center = properties.center_of_mass_m;
        let mut mesh = self.mesh.clone();
        for vertex in &mut mesh.vertices {
            *vertex -= center;
        }
        let body = AffineBody::new(
            self.mass_kg,
            properties.volume_m3,
            properties.second_moment_m5,
            parameters.affine_stiffness_pa,
        )?;
        let collider = Collider::new(&mesh);
        let state = AffineState::rigid(
            self.t_world_object.transform_point(center),
            self.t_world_object.rotation_matrix(),
        );
        let mut object = Object::new(body, state, &collider).on_ground(self.friction);
        let lowest = object.lowest(&collider);
        if lowest < -1e-3 {
            return Err(input(
                format!(
                    "the object's pose puts it {:.1} mm into the ground (z = 0)",
                    -1e3 * lowest
                ),
                "give a pose whose lowest point is at z = 0, or leave it out for a stable one",
            ));
        }
        let barrier = parameters.barrier();
        let weight = self.mass_kg * parameters.gravity_m_s2.abs();
        let raised_m = object.resting_height(&collider, &barrier, weight) - lowest;
        object.raise(raised_m);
        let t_world_gripper = Pose::from_translation(DVec3::Z * raised_m) * self.t_world_gripper;
        let mut gels = Vec::with_capacity(2);
        for finger in Finger::BOTH {
            let place = self.gel_pose(finger, &t_world_gripper);
            let gel = Gel::new(
                &self.gel.grid,
                &self.gel.material,
                self.gel.drive,
                parameters,
                |p| place.transform_point(p),
            )?;
            gels.push(gel);
        }
        let starts_penetrating = super::start_check::penetration(&gels, &object, &mesh);
        let axes = t_world_gripper.rotation_matrix();
        Ok(Stage {
            closing: Finger::BOTH.map(|finger| axes * finger.closing()),
            gripper_axes: axes,
            center_of_mass: center,
            raised_m,
            starts_penetrating,
            facing: facing_nodes(&self.gel.grid),
            system: System::new(gels, object, collider, self.friction, *parameters)?,
        })
    }

    /// Pose of a gel's own frame (back face at z = 0) in the world at the start.
    fn gel_pose(&self, finger: Finger, t_world_gripper: &Pose) -> Pose {
        let back = -(0.5 * self.opening_m + self.gel.grid.thickness_m());
        let rotation = glam::DQuat::from_mat3(&finger.rotation());
        *t_world_gripper * Pose::new(rotation, finger.closing() * back)
    }

    fn validate(&self) -> Result<()> {
        if !(self.mass_kg.is_finite() && self.mass_kg > 0.0) {
            return Err(input(
                format!("the mass must be above 0 kg, found {}", self.mass_kg),
                "weigh the object and pass --mass-kg",
            ));
        }
        if !(self.friction.is_finite() && self.friction >= 0.0) {
            return Err(input(
                format!(
                    "the friction coefficient must be 0 or more, found {}",
                    self.friction
                ),
                "pass --friction between 0 and about 1.5",
            ));
        }
        if !(self.opening_m.is_finite() && self.opening_m > 0.0 && self.opening_m <= 0.2) {
            return Err(input(
                format!(
                    "the opening must be above 0 and at most 0.2 m, found {}",
                    self.opening_m
                ),
                "pass --width in metres, for instance 0.08",
            ));
        }
        Ok(())
    }
}
