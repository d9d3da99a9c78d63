//! The object of a command: a mesh file or a built-in shape.

use std::path::Path;

use serde::Serialize;

use super::flags::{above_zero, number, read_text};
use gripcast_base::error::Result;
use gripcast_base::number::NumberRange;
use gripcast_geometry::{LengthUnit, Pose, PreparedMesh, TriangleMesh, load_object_mesh};
use gripcast_sim::grasp::{GraspPose, resting_pose};

/// Options that choose a mesh.
#[derive(Clone, Debug, clap::Args)]
pub(super) struct MeshFlags {
    /// Mesh file (obj, stl, ply, glb, gltf) or builtin:NAME (box, sphere, cylinder, mug, wedge,
    /// bar, spike, ball, bottle, jack, star, dented, ring, saddle, lump)
    #[arg(long, value_name = "MESH|builtin:NAME")]
    pub(super) object: String,
    /// Unit of the mesh coordinates: mm, cm, m, in
    #[arg(long, default_value_t = LengthUnit::Metre)]
    unit: LengthUnit,
    /// Scale factor of the mesh
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = above_zero)]
    scale: f64,
}

impl MeshFlags {
    /// Reads, scales and checks the mesh.
    pub(super) fn load(&self) -> Result<PreparedMesh> {
        load_object_mesh(&self.object, self.unit, self.scale)
    }
}

/// Options that choose a simulated object.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Object")]
pub(super) struct ObjectFlags {
    #[command(flatten)]
    pub(super) mesh: MeshFlags,
    /// Mass of the object
    #[arg(long, value_name = "KG", default_value_t = 0.06, value_parser = above_zero)]
    pub(super) mass_kg: f64,
    /// Coulomb friction coefficient (gel–object and object–ground)
    #[arg(long, value_name = "MU", default_value_t = 0.4,
        value_parser = number(NumberRange::NOT_NEGATIVE))]
    pub(super) friction: f64,
}

/// The object in a result.
#[derive(Debug, Serialize)]
pub(super) struct ObjectRecord {
    source: String,
    unit: String,
    scale: f64,
    sha256: String,
    triangles: usize,
    size_m: [f64; 3],
    mass_kg: f64,
    friction: f64,
}

impl ObjectRecord {
    pub(super) fn new(flags: &ObjectFlags, mesh: &TriangleMesh) -> Self {
        Self {
            source: flags.mesh.object.clone(),
            unit: flags.mesh.unit.to_string(),
            scale: flags.mesh.scale,
            sha256: mesh.content_hash(),
            triangles: mesh.triangles.len(),
            size_m: mesh.bounds().extent().to_array(),
            mass_kg: flags.mass_kg,
            friction: flags.friction,
        }
    }
}

/// Reads a pose file with `t_object_gripper`.
pub(super) fn read_grasp_pose(path: &Path) -> Result<GraspPose> {
    GraspPose::from_json(&read_text(path, "pose")?).map_err(|e| e.at(path.display()))
}

/// Returns the default resting pose of a mesh, `t_world_object`.
pub(super) fn default_resting_pose(mesh: &TriangleMesh) -> Result<Pose> {
    Ok(resting_pose(mesh, None)?.1.t_world_object)
}
