//! Fields of a gel's front face: displacement, traction, stick and slip, and their resultant.
//!
//! All vectors are in the gel frame: z from the back to the face, x along the approach direction, y
//! = z × x. The frame follows the mean of the back's nodes, as a sensor's camera does. Forces are
//! those that the solver's last iteration of a step balanced; nothing is modelled a second time.

mod columns;
mod sampling;

use glam::{DMat3, DVec3};

use crate::fem::{GelGrid, Side, Surface};
use crate::grasp::StageName;
use crate::solver::{Gel, NodeContact};

pub use sampling::FieldSampling;

/// Nodes of the front face of a gel at rest.
///
/// Node (i, j) at `x_m[i]`, `y_m[j]` has index i + nx j.
#[derive(Clone, Debug, PartialEq)]
pub struct FaceMesh {
    /// Positions along x, rising, m.
    pub x_m: Vec<f64>,
    /// Positions along y, rising, m.
    pub y_m: Vec<f64>,
    /// Height of the face above the back, m.
    pub thickness_m: f64,
    /// Area that each node stands for, m²: a third of each adjacent triangle.
    pub area_m2: Vec<f64>,
}

impl FaceMesh {
    /// The front face of a mesh.
    pub fn new(grid: &GelGrid) -> Self {
        let [x_m, y_m, _] = grid.axes().clone();
        let front = Surface::new(grid.triangles(Side::Front), grid.positions());
        Self {
            x_m,
            y_m,
            thickness_m: grid.thickness_m(),
            area_m2: front.vertex_areas().to_vec(),
        }
    }

    /// Number of nodes.
    pub fn nodes(&self) -> usize {
        self.x_m.len() * self.y_m.len()
    }

    /// Position of a node at rest, m.
    pub fn position(&self, node: usize) -> DVec3 {
        let columns = self.x_m.len();
        let (i, j) = (node % columns, node / columns);
        DVec3::new(self.x_m[i], self.y_m[j], self.thickness_m)
    }
}

/// Force and torque about the centre of the face at rest (x = y = 0, z = thickness) on a gel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wrench {
    /// Force, N.
    pub force_n: [f64; 3],
    /// Torque, N m.
    pub torque_n_m: [f64; 3],
}

impl Wrench {
    fn of(loads: impl Iterator<Item = (DVec3, DVec3)>) -> Self {
        let (mut force, mut torque) = (DVec3::ZERO, DVec3::ZERO);
        for (arm, load) in loads {
            force += load;
            torque += arm.cross(load);
        }
        Self {
            force_n: force.to_array(),
            torque_n_m: torque.to_array(),
        }
    }
}

/// Fields of one gel at the end of a time step, one value per node of its [`FaceMesh`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FaceField {
    /// Displacement from rest, m.
    pub displacement_m: Vec<[f32; 3]>,
    /// Contact force on the gel per area of the face at rest, Pa: tangential along x and y, normal
    /// along z, negative where the object presses.
    pub traction_pa: Vec<[f32; 3]>,
    /// Whether the node touches the object, and whether it slides.
    pub contact: Vec<NodeContact>,
    /// Sum of the tractions times areas.
    pub resultant: Wrench,
    /// Contact force on the gel's side walls, zero where only the face touches. With the resultant,
    /// the whole force on the gel.
    pub sides: Wrench,
}

impl FaceField {
    /// Reads the fields from a gel; `contact` is that of all its nodes, `rotation` maps the gel frame
    /// into the world.
    pub(crate) fn new(
        gel: &Gel,
        mesh: &FaceMesh,
        contact: &[NodeContact],
        rotation: &DMat3,
    ) -> Self {
        let (rest, x) = (gel.rest(), gel.positions());
        let mut is_driven = vec![false; x.len()];
        let (mut back, mut back_at_rest) = (DVec3::ZERO, DVec3::ZERO);
        for &node in gel.driven() {
            is_driven[node as usize] = true;
            back += x[node as usize];
            back_at_rest += rest[node as usize];
        }
        let count = gel.driven().len().max(1) as f64;
        let (back, back_at_rest) = (back / count, back_at_rest / count);
        let to_gel = rotation.transpose();
        let position = |node: usize| to_gel * (x[node] - back) + back_at_rest;
        let forces: Vec<DVec3> = gel.contact_forces().map(|force| to_gel * force).collect();
        let center = DVec3::Z * mesh.thickness_m;
        let load = |node: usize| (position(node) - center, forces[node]);
        // The front face is the last layer of nodes.
        let first = x.len() - mesh.nodes();
        let front = first..x.len();
        let displacement = |node: usize| (position(node) - rest[node]).as_vec3().to_array();
        let traction = |(node, area): (usize, &f64)| (forces[node] / *area).as_vec3().to_array();
        Self {
            displacement_m: front.clone().map(displacement).collect(),
            traction_pa: front.clone().zip(&mesh.area_m2).map(traction).collect(),
            contact: contact[first..].to_vec(),
            resultant: Wrench::of(front.map(load)),
            sides: Wrench::of((0..first).filter(|node| !is_driven[*node]).map(load)),
        }
    }

    /// Fraction of the normal force that sticking nodes carry; `None` without contact.
    pub fn stick_fraction(&self, mesh: &FaceMesh) -> Option<f64> {
        let (mut stick, mut total) = (0.0, 0.0);
        let nodes = self.traction_pa.iter().zip(&self.contact);
        for ((traction, contact), area) in nodes.zip(&mesh.area_m2) {
            let normal = f64::from(-traction[2]).max(0.0) * area;
            total += normal;
            if *contact == NodeContact::Stick {
                stick += normal;
            }
        }
        (total > 0.0).then(|| stick / total)
    }
}

/// Fields of all gels at the end of one time step.
#[derive(Clone, Debug, PartialEq)]
pub struct FieldStep {
    /// Index of the time step, from 0.
    pub step: u32,
    /// Stage of the grasp; `None` for a press.
    pub stage: Option<StageName>,
    /// Time since the start, s.
    pub t_s: f64,
    /// Fields of each gel: left and right, or the one of a press.
    pub gels: Vec<FaceField>,
}

/// Fields at chosen time steps.
#[derive(Clone, Debug, PartialEq)]
pub struct FieldSeries {
    /// Nodes of each gel's face.
    pub mesh: FaceMesh,
    /// Number of gels.
    pub gels: usize,
    /// Tangential speed from which a node slips, m/s.
    pub eps_v_m_s: f64,
    /// Steps in order.
    pub steps: Vec<FieldStep>,
}

impl FieldSeries {
    /// A series without steps.
    pub fn new(grid: &GelGrid, gels: usize, eps_v_m_s: f64) -> Self {
        Self {
            mesh: FaceMesh::new(grid),
            gels,
            eps_v_m_s,
            steps: Vec::new(),
        }
    }

    /// The last step of a stage that was recorded.
    pub fn last_of(&self, stage: StageName) -> Option<&FieldStep> {
        let mut steps = self.steps.iter().rev();
        steps.find(|step| step.stage == Some(stage))
    }
}
