//! Scene of a grasp: object, gripper pose and gels.

use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

use crate::affine::{AffineBody, AffineState};
use crate::fem::{GelGrid, GelPad, GelResolution};
use crate::solver::{Collider, Drive, Gel, GelMaterial, Object, SolverParameters, System};
use gripcast_base::error::{Error, Result};
use gripcast_geometry::{MassProperties, Pose, TriangleMesh, check_mass};

/// Largest opening of the gripper, m.
pub(crate) const MAX_OPENING_M: f64 = 0.2;

/// A finger of the gripper. The frame of its gel has z from the back to the face, x along the
/// gripper's approach axis and y across.
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

    /// Name in files and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Left => "left",
            Self::Right => "right",
        }
    }

    /// Closing direction in the gripper's frame.
    pub fn closing(self) -> DVec3 {
        match self {
            Self::Left => DVec3::X,
            Self::Right => DVec3::NEG_X,
        }
    }

    /// Rotation from the gel frame to the gripper frame.
    pub fn rotation(self) -> DMat3 {
        let (x, z) = (DVec3::Z, self.closing());
        DMat3::from_cols(x, z.cross(x), z)
    }
}

/// Mesh and material of both gels.
#[derive(Clone, Debug)]
pub struct GelSpec {
    /// Mesh at rest, in the gel frame.
    pub grid: GelGrid,
    /// Elastic material.
    pub material: GelMaterial,
    /// Boundary drive of the back face.
    pub drive: Drive,
}

impl GelSpec {
    /// The default pad with the paper's material.
    ///
    /// # Errors
    /// None: the default pad is valid.
    pub fn standard(resolution: GelResolution) -> Result<Self> {
        Ok(Self {
            grid: GelPad::default().grid(resolution)?,
            material: GelMaterial::default(),
            drive: Drive::default(),
        })
    }
}

/// Initial state of a grasp.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Closed surface of the object in its own frame, m.
    pub mesh: TriangleMesh,
    /// Mass of the object, kg.
    pub mass_kg: f64,
    /// Coulomb friction coefficient between gels and object, and between object and ground.
    pub friction: f64,
    /// Pose of the object on the ground (z = 0).
    pub t_world_object: Pose,
    /// Pose of the gripper; the fingers close along its x axis.
    pub t_world_gripper: Pose,
    /// Distance between the gel faces at the start, m.
    pub opening_m: f64,
    /// Mesh, material and drive of both gels.
    pub gel: GelSpec,
}

/// A scene ready to simulate.
#[derive(Debug)]
pub(super) struct BuiltScene {
    pub(super) system: System,
    /// Closing direction of each gel in the world.
    pub(super) closing: [DVec3; 2],
    /// Gripper axes in the world.
    pub(super) gripper_axes: DMat3,
    /// Centre of mass in the frame of the object's mesh, m.
    pub(super) center_of_mass: DVec3,
    /// Height by which object and gripper were raised to the contact gap of the ground, m.
    pub(super) raised_m: f64,
    /// Description of an initial penetration.
    pub(super) penetration: Option<String>,
    /// Pairs of opposite nodes on the left and the right face.
    facing: Vec<[u32; 2]>,
}

impl BuiltScene {
    /// Whether the gels touch each other; there is no contact between them.
    pub(super) fn gels_meet(&self) -> bool {
        let [left, right] = [0, 1].map(|i| self.system.gels()[i].positions());
        let d_hat = self.system.parameters().d_hat_m;
        self.facing.iter().any(|[l, r]| {
            let offset = right[*r as usize] - left[*l as usize];
            offset.dot(self.closing[0]) < d_hat
        })
    }
}

/// Pairs of opposite nodes of two equal pads, whose y axes point in opposite directions.
fn facing_nodes(grid: &GelGrid) -> Vec<[u32; 2]> {
    let [nx, ny, nz] = grid.nodes();
    (0..ny)
        .flat_map(|j| (0..nx).map(move |i| (i, j)))
        .map(|(i, j)| [j, ny - 1 - j].map(|j| grid.node(i, j, nz - 1) as u32))
        .collect()
}

impl Scene {
    /// Builds the gels and the object.
    ///
    /// Object and gripper are raised together (by less than `d_hat`) until the ground's barrier
    /// carries the object's weight, which preserves their relative pose.
    ///
    /// # Errors
    /// `Input` for an invalid mass, friction, opening, pose or mesh.
    pub(super) fn build(&self, parameters: &SolverParameters) -> Result<BuiltScene> {
        self.validate()?;
        let properties = MassProperties::from_mesh(&self.mesh)?;
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
        let mut object = Object::new(body, state, &collider).with_ground(self.friction);
        let lowest = object.lowest(&collider);
        if lowest < -1e-3 {
            return Err(Error::input(format!(
                "the object's pose puts it {:.1} mm into the ground (z = 0)",
                -1e3 * lowest
            ))
            .remedy("use a pose whose lowest point is at z = 0, or omit it for a stable pose"));
        }
        let barrier = parameters.barrier();
        let weight = self.mass_kg * parameters.gravity_m_s2.abs();
        let raised_m = object.resting_height(&collider, &barrier, weight) - lowest;
        object.raise(raised_m);
        let t_world_gripper = Pose::from_translation(DVec3::Z * raised_m) * self.t_world_gripper;
        let mut gels = Vec::with_capacity(2);
        for finger in Finger::BOTH {
            let t_world_gel = self.gel_pose(finger, &t_world_gripper);
            let GelSpec {
                grid,
                material,
                drive,
            } = &self.gel;
            gels.push(Gel::new(grid, material, *drive, parameters, |p| {
                t_world_gel.transform_point(p)
            })?);
        }
        let gripper_axes = t_world_gripper.rotation_matrix();
        Ok(BuiltScene {
            closing: Finger::BOTH.map(|finger| gripper_axes * finger.closing()),
            gripper_axes,
            center_of_mass: center,
            raised_m,
            penetration: super::start_check::penetration(&gels, &object, &mesh),
            facing: facing_nodes(&self.gel.grid),
            system: System::new(gels, object, collider, self.friction, *parameters)?,
        })
    }

    /// Pose of the gel frame (back face at z = 0) in the world at the start.
    fn gel_pose(&self, finger: Finger, t_world_gripper: &Pose) -> Pose {
        let back = -(0.5 * self.opening_m + self.gel.grid.thickness_m());
        let rotation = glam::DQuat::from_mat3(&finger.rotation());
        *t_world_gripper * Pose::new(rotation, finger.closing() * back)
    }

    fn validate(&self) -> Result<()> {
        check_mass(self.mass_kg, &self.mesh.bounds())?;
        let (friction, opening) = (self.friction, self.opening_m);
        let (what, remedy) = if !(friction.is_finite() && friction >= 0.0) {
            let what = format!("the friction coefficient must be 0 or more, found {friction}");
            (what, "pass --friction between 0 and about 1.5")
        } else if !(opening > 0.0 && opening <= MAX_OPENING_M) {
            let what = format!(
                "the opening must be above 0 and at most {MAX_OPENING_M} m, found {opening}"
            );
            (what, "pass --width in metres, for instance 0.08")
        } else {
            return Ok(());
        };
        Err(Error::input(what).remedy(remedy))
    }
}
